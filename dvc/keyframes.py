"""Key pictures: H.264 pictures, the references of all other frames (libx264 and FFmpeg's decoder).

They are intra pictures, or chains: an IDR picture, then pictures that are predicted from those before in a
closed loop. A record leaves out the start codes, the parameter sets (stored once, in the header of the
stream), the version message of x264, and the NAL unit header, which follows from the type of the picture.
"""

import struct
from fractions import Fraction
from functools import lru_cache
from typing import TYPE_CHECKING, Final, Literal, NamedTuple, cast

import numpy as np

from dvc.bits import BitReader
from dvc.config.sections import MAX_QP
from dvc.errors import BitstreamError
from dvc.video.frames import Frame, check_size
from dvc.video.pixels import frame_from_picture, picture_from_frame
from dvc.video.writers import pad_frame

if TYPE_CHECKING:
    import av

MACROBLOCK_PX: Final = 16

# NAL unit headers: nal_ref_idc and nal_unit_type ([H264] table 7-1).
_SPS_HEADER = 0x67
_PPS_HEADER = 0x68
_IDR_HEADER = 0x65
_PREDICTED_HEADER = 0x41
_SEI_TYPE = 6
_P_SLICES, _I_SLICES = (0, 5), (2, 7)

_START_CODE = b"\x00\x00\x01"
_MAX_SPS_BYTES = 255
_PROFILES = (100, 244)
"""High, and High 4:4:4 Predictive, which lossless pictures need."""

MAX_REFERENCES: Final = 4
"""Largest number of pictures that a decoder keeps to predict the next one."""
INTRA_QP_OFFSET: Final = -3
"""QP of IDR pictures minus that of predicted ones, which depend on them. On the nine clips of the results -2
costs the same within .6 % (`benchmarks.searches.settings dvc.keyframes.INTRA_QP_OFFSET=-2 --qp 28 36`)."""
_X264_PARAMETERS = {
    "psy": 0,
    "ipratio": 1,
    "qpmin": 0,
    "scenecut": 0,
    "slices": 1,
    "sliced-threads": 0,
    "threads": 1,
    # A constant rate factor equals a QP, and a region of interest deviates from it: x264 has no other way to
    # change the QP of an open encoder.
    "qcomp": 1,
    "mbtree": 0,
    "aq-mode": 1,
    "aq-strength": 1e-4,
}
_INTRA: dict[str, object] = {"keyint": 1}
_PREDICTED: dict[str, object] = {
    "keyint": "infinite",
    "bframes": 0,
    "rc-lookahead": 0,
    "ref": 1,
    "weightp": 1,
    "subme": 6,
    "dct-decimate": 0,
}
"""Settings on the front of rate and time that `benchmarks.searches.key_pictures` finds on box, cube, desk,
river, stone and tree: the next slower ones save 2 % of these pictures for a third more time."""
_RATE_FACTOR = 30
CHROMA_QP_OFFSET = -2
"""QP of chroma minus that of luma: chroma of all frames between depends on it, unlike luma. With 0 each of
the nine clips of the results except cube, which is grey, takes 1.3 to 8.4 % more at equal PSNR in colour
(`benchmarks.searches.settings dvc.keyframes.CHROMA_QP_OFFSET=0 --colour --qp 28 36 --frames 33`)."""
# Nothing may be concealed: any syntax error ends the decoding of the picture.
_DECODER_OPTIONS = {"err_detect": "crccheck+bitstream+buffer+explode", "ec": "0"}

_TIME_BASE = Fraction(1, 25)

Qp = int | Literal["lossless"]


class KeyPicture(NamedTuple):
    """One coded key picture."""

    data: bytes  # slice without the header of the NAL unit
    predicted: bool  # from earlier pictures; otherwise an IDR picture


class KeyFrameEncoder:
    """Codes key pictures, one in and one out, at the usual quality or at one per picture."""

    def __init__(
        self,
        width: int,
        height: int,
        qp: Qp,
        *,
        luma_only: bool = False,
        predicted: bool = False,
        chroma_qp_offset: int | None = None,
    ) -> None:
        import av
        from av.codec.context import Flags

        if qp != "lossless" and not (isinstance(qp, int) and 1 <= qp <= MAX_QP):
            raise ValueError(f"`qp` must be 1 to {MAX_QP} or 'lossless', got {qp!r}")
        check_size(width, height, "key frames")
        self._size, self._qp = (width, height), qp
        self._luma_only, self._predicted = luma_only, predicted
        size = _coded_size(width, height)
        parameters = {**_X264_PARAMETERS, **(_PREDICTED if predicted else _INTRA)}
        if not (luma_only or qp == "lossless"):
            offset = CHROMA_QP_OFFSET if chroma_qp_offset is None else chroma_qp_offset
            parameters["chroma-qp-offset"] = offset
        self._context = context = av.CodecContext.create("libx264", "w")
        context.width, context.height = size
        context.pix_fmt = "gray" if luma_only else "yuv420p"
        context.framerate, context.time_base = 1 / _TIME_BASE, _TIME_BASE
        context.thread_count = 1
        context.flags |= Flags.global_header  # parameter sets apart from the pictures
        context.options = {
            "preset": "medium",
            "tune": "zerolatency",
            **({"qp": "0"} if qp == "lossless" else {"crf": str(_RATE_FACTOR)}),
            "forced-idr": "1",
            "x264-params": ":".join(f"{name}={value}" for name, value in parameters.items()),
        }
        if qp != "lossless":
            context.profile = "High"
        context.open()
        self._count = 0
        units = _nal_units(self._context.extradata or b"")
        sps, pps = (next(u for u in units if u[0] == header) for header in (_SPS_HEADER, _PPS_HEADER))
        sps = _without_vui(sps, size)
        # both without headers, after the length of the first one; `KeyFrameDecoder` needs them once
        self.parameter_sets = bytes([len(sps) - 1]) + sps[1:] + pps[1:]

    def encode(self, frame: Frame, qp: int | None = None, *, begins_chain: bool = True) -> KeyPicture:
        """Code one picture, an IDR picture if it begins a chain, at the usual QP or another."""
        from av.video.frame import PictureType

        if (frame.width, frame.height) != self._size:
            raise ValueError(f"`frame` must be {self._size} pixels, got {(frame.width, frame.height)}")
        pixel_format = "gray" if self._luma_only else "yuv420p"
        source = frame.without_chroma() if self._luma_only else frame
        picture = picture_from_frame(pad_frame(source, MACROBLOCK_PX), pixel_format)
        picture.pts = self._count
        self._count += 1
        if begins_chain:
            picture.pict_type = PictureType.I
        usual = self._qp if qp is None else qp
        if usual != "lossless":
            offset = INTRA_QP_OFFSET if begins_chain and self._predicted else 0
            qp = min(max(usual + offset, 1), MAX_QP)
            graph = _qp_filter(picture.width, picture.height, pixel_format, qp - _RATE_FACTOR)
            graph.push(picture)
            picture = cast("av.VideoFrame", graph.pull())
        packets = self._context.encode(picture)
        (unit,) = (u for packet in packets for u in _nal_units(bytes(packet)) if u[0] & 31 != _SEI_TYPE)
        assert unit[0] in {_IDR_HEADER, _PREDICTED_HEADER}
        return KeyPicture(unit[1:], unit[0] == _PREDICTED_HEADER)


class KeyFrameDecoder:
    """Decodes pictures of `KeyFrameEncoder`, each chain in order; the result is the same on all machines.

    After a damaged or missing picture, the rest of its chain is refused.
    """

    def __init__(self, width: int, height: int, parameter_sets: bytes, *, luma_only: bool = False) -> None:
        check_size(width, height, "key frames")
        self._size = (width, height)
        self._coded_size = _coded_size(width, height)
        self._luma_only = luma_only
        sps, _ = _split_parameter_sets(parameter_sets)
        try:
            self._frame_num_bits, _ = _read_sps(sps, self._coded_size)
        except BitstreamError as err:
            raise BitstreamError(f"key frames: the parameter sets are damaged: {err}") from err
        self._num_decoded: int | None = None  # decoded frames of the chain; None before it or after damage
        self._parameter_sets = parameter_sets
        self._open()

    def _open(self) -> None:
        """Open FFmpeg's decoder, once per chain: flushing does not reset all effects of damage."""
        import av

        # The limit is checked against the decoder's buffers, which are wider than the picture.
        max_pixels = (self._coded_size[0] + 128) * (self._coded_size[1] + 128)
        self._context = av.CodecContext.create("h264", "r")
        self._context.thread_count = 1
        self._context.options = {**_DECODER_OPTIONS, "max_pixels": str(max_pixels)}
        # An AVC decoder configuration record: NAL units after it have 4-byte lengths.
        sps, pps = (
            struct.pack(">H", len(unit)) + unit for unit in _split_parameter_sets(self._parameter_sets)
        )
        self._context.extradata = bytes([1]) + sps[3:6] + bytes([0xFF, 0xE1]) + sps + b"\x01" + pps
        try:
            self._context.open()
        except (av.FFmpegError, ValueError) as err:
            raise BitstreamError("key frames: the parameter sets are damaged") from err

    def decode(self, data: bytes, *, predicted: bool = False) -> Frame:
        """Decode one picture, the next of its chain or, unless it is predicted, the first of another."""
        import av

        number, self._num_decoded = self._num_decoded if predicted else 0, None
        if number is None:
            raise BitstreamError("key frame: its reference picture is missing")
        self._check_slice(data, predicted, number)
        if not predicted:
            self._open()
        unit = bytes([_PREDICTED_HEADER if predicted else _IDR_HEADER]) + data
        try:
            pictures = self._context.decode(av.Packet(struct.pack(">I", len(unit)) + unit))
        except (av.FFmpegError, ValueError) as err:
            raise BitstreamError(f"key frame: damaged data ({getattr(err, 'strerror', err)})") from err
        if len(pictures) != 1:
            raise BitstreamError(f"key frame: {len(pictures)} pictures instead of one")
        (picture,) = pictures
        if picture.is_corrupt:
            raise BitstreamError("key frame: damaged picture")
        if (picture.width, picture.height) != self._coded_size:
            raise BitstreamError(
                f"key frame: the picture has {picture.width}x{picture.height} pixels, "
                f"not {self._coded_size[0]}x{self._coded_size[1]}"
            )
        if picture.format.name not in {"yuv420p", "gray"}:
            raise BitstreamError(f"key frame: the pixel format {picture.format.name} is not used here")
        self._num_decoded = number + 1
        width, height = self._size
        frame = frame_from_picture(picture)
        luma = frame.luma[:height, :width].copy()
        if self._luma_only:
            return Frame(luma)
        rows, columns = (height + 1) // 2, (width + 1) // 2
        cb, cr = (plane[:rows, :columns].copy() for plane in frame.with_chroma().chroma or ())
        return Frame(luma, (cb, cr))

    def _check_slice(self, data: bytes, predicted: bool, number: int) -> None:
        """Refuse a slice that is not the whole of the next picture of the chain."""
        reader = _SyntaxReader(data[:32])
        try:
            first_macroblock, slice_type, pps = (reader.unsigned() for _ in range(3))
            frame_num = reader.read_number(self._frame_num_bits)
        except BitstreamError as err:
            raise BitstreamError("key frame: not a slice") from err
        if first_macroblock or pps or slice_type not in (*_I_SLICES, *(_P_SLICES if predicted else ())):
            raise BitstreamError(f"key frame: a slice of type {slice_type}, which key pictures do not have")
        if frame_num != number % (1 << self._frame_num_bits):
            raise BitstreamError("key frame: its reference picture is missing")


def _coded_size(width: int, height: int) -> tuple[int, int]:
    """Round both sides up to whole macroblocks."""
    return -(-width // MACROBLOCK_PX) * MACROBLOCK_PX, -(-height // MACROBLOCK_PX) * MACROBLOCK_PX


@lru_cache(maxsize=MAX_QP)
def _qp_filter(width: int, height: int, pixel_format: str, offset: int) -> "av.filter.Graph":
    """Return a filter that makes all of a picture a region of interest."""
    import av.filter

    graph = av.filter.Graph()
    kind = av.VideoFormat(pixel_format, width, height)
    source = graph.add_buffer(width=width, height=height, format=kind, time_base=_TIME_BASE)
    region = graph.add("addroi", f"x=0:y=0:w=iw:h=ih:qoffset={offset}/51")
    sink = graph.add("buffersink")
    source.link_to(region)
    region.link_to(sink)
    graph.configure()
    return graph


def _nal_units(stream: bytes) -> list[bytes]:
    """Split a byte stream with start codes ([H264] annex B) into NAL units."""
    return [unit for part in stream.split(_START_CODE) if (unit := part.rstrip(b"\x00"))]


def _split_parameter_sets(data: bytes) -> tuple[bytes, bytes]:
    """Read the sequence and the picture parameter set, headers put back."""
    if len(data) < 6 or not 4 <= data[0] < len(data) - 1 or len(data) > 2 * _MAX_SPS_BYTES:
        raise BitstreamError("key frames: the parameter sets are damaged")
    end = 1 + data[0]
    return bytes([_SPS_HEADER]) + data[1:end], bytes([_PPS_HEADER]) + data[end:]


def _without_vui(sps: bytes, coded_size: tuple[int, int]) -> bytes:
    """Leave out the usability information (timing, aspect), which ends a sequence parameter set."""
    _, end = _read_sps(sps, coded_size)
    bits = np.unpackbits(np.frombuffer(_unescaped(sps), np.uint8))[:end]
    plain = np.packbits(np.append(bits, [0, 1])).tobytes()  # no VUI, stop bit
    # If the shorter form requires escaping again, the long one is valid as well.
    return sps if any(bytes((0, 0, low)) in plain for low in range(4)) else plain


def _unescaped(unit: bytes) -> bytes:
    """Remove emulation prevention bytes ([H264] 7.4.1)."""
    return unit.replace(b"\x00\x00\x03", b"\x00\x00")


class _SyntaxReader(BitReader):
    """Reads syntax elements of the beginning of a NAL unit."""

    def __init__(self, unit: bytes) -> None:
        super().__init__(_unescaped(unit))

    def unsigned(self) -> int:
        """Read an unsigned Exp-Golomb code ([H264] 9.1)."""
        num_zeros = 0
        while not self.read_number(1):
            num_zeros += 1
            if num_zeros > 31:
                raise BitstreamError("an Exp-Golomb code of more than 63 bits")
        return (1 << num_zeros) - 1 + self.read_number(num_zeros)


def _read_sps(sps: bytes, coded_size: tuple[int, int]) -> tuple[int, int]:
    """Return the bits of `frame_num`, and the number of bits before `vui_parameters_present_flag`.

    Refuse a sequence parameter set ([H264] 7.3.2.1.1) that `KeyFrameEncoder` does not write.
    """
    reader = _SyntaxReader(sps)
    reader.read(8)
    if (profile := reader.read_number(8)) not in _PROFILES:
        raise BitstreamError(f"profile {profile}")
    reader.read(16)  # constraints and level
    reader.unsigned()  # seq_parameter_set_id
    chroma_format = reader.unsigned()
    depths = reader.unsigned(), reader.unsigned()
    reader.read(1)  # qpprime_y_zero_transform_bypass_flag
    scaled = reader.read_number(1)
    frame_num_bits, order_type = reader.unsigned() + 4, reader.unsigned()
    num_references = reader.unsigned()
    gaps = reader.read_number(1)
    width, height = (MACROBLOCK_PX * (reader.unsigned() + 1) for _ in range(2))
    frames_only, _, cropped = (reader.read_number(1) for _ in range(3))
    unusual = any((*depths, scaled, gaps, cropped)) or not frames_only or chroma_format > 1
    if unusual or order_type != 2 or frame_num_bits > 16:
        raise BitstreamError("pictures of a kind that is not used here")
    if num_references > MAX_REFERENCES:
        raise BitstreamError(f"{num_references} references, at most {MAX_REFERENCES} are used")
    if (width, height) != coded_size:
        raise BitstreamError(f"pictures of {width}x{height} pixels, not {coded_size[0]}x{coded_size[1]}")
    return frame_num_bits, 8 * len(_unescaped(sps)) - reader.num_left
