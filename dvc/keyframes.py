"""Key frames: H.264 intra pictures, each coded and decoded alone (libx264 and FFmpeg's decoder).

What x264 repeats or adds is left out of a record: start codes, the parameter sets (kept once, in the stream's
header), the version message, and the NAL unit header, which is the same byte for every key frame.
"""

import struct
from collections.abc import Mapping
from fractions import Fraction
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Literal

from dvc.config.sections import MAX_QP
from dvc.errors import BitstreamError
from dvc.video.frames import Frame, check_size
from dvc.video.pixels import frame_from_picture, picture_from_frame
from dvc.video.writers import pad_frame

if TYPE_CHECKING:
    import av
    from av.video.codeccontext import VideoCodecContext

MACROBLOCK_PX: Final = 16

# NAL unit headers: nal_ref_idc 3 and nal_unit_type ([H264] table 7-1).
_SPS_HEADER = 0x67
_PPS_HEADER = 0x68
_IDR_HEADER = 0x65
_SEI_TYPE = 6

_START_CODE = b"\x00\x00\x01"
_MAX_SPS_BYTES = 255

_X264_PARAMETERS = {
    "keyint": 1,
    "psy": 0,
    "ipratio": 1,
    "qpmin": 0,
    "scenecut": 0,
    "slices": 1,
    "sliced-threads": 0,
    "threads": 1,
}
CHROMA_QP_OFFSET = -4
"""By which chroma is finer than luma: that of all frames between rests on it. Chosen on box, desk, river,
stone, street and tree; `benchmarks.searches.settings --colour` searches."""
_SAME_PARAMETER_SETS = {"stitchable": 1}
"""So that they do not depend on the QP, for a byte in each picture."""
FAST_DECISIONS: Final = MappingProxyType({"subme": 5, "trellis": 0, "deadzone-intra": 7})
"""Parameters of libx264: modes by sums of transformed differences, no search by rate and distortion; the dead
zone is narrower than usual, which is worth its rate where no trellis decides about each coefficient."""
# Nothing may be concealed: any syntax error ends the decoding of the picture.
_DECODER_OPTIONS = {"err_detect": "crccheck+bitstream+buffer+explode", "ec": "0"}

Qp = int | Literal["lossless"]


class KeyFrameEncoder:
    """Code pictures as H.264 intra, one in and one out, at one quality or, if `several_qps`, at any."""

    def __init__(
        self,
        width: int,
        height: int,
        qp: Qp,
        *,
        luma_only: bool = False,
        parameters: Mapping[str, int] = MappingProxyType({}),
        several_qps: bool = False,
    ) -> None:
        if qp != "lossless" and not (isinstance(qp, int) and 1 <= qp <= MAX_QP):
            raise ValueError(f"`qp` must be 1 to {MAX_QP} or 'lossless', got {qp!r}")
        check_size(width, height, "key frames")
        self._size = (width, height)
        self._luma_only = luma_only
        self._parameters = {**parameters, **(_SAME_PARAMETER_SETS if several_qps else {})}
        self._several_qps = several_qps
        self._open(qp)
        self._count = 0
        self._decoder: KeyFrameDecoder | None = None
        units = _nal_units(self._context.extradata or b"")
        sps, pps = (next(u for u in units if u[0] == header) for header in (_SPS_HEADER, _PPS_HEADER))
        self._parameter_sets = _join_parameter_sets(_without_vui(sps), pps)

    @property
    def parameter_sets(self) -> bytes:
        """What `KeyFrameDecoder` needs once: the lengths and payloads of both parameter sets."""
        return self._parameter_sets

    def _open(self, qp: Qp) -> None:
        self._qp = qp
        size = _coded_size(*self._size)
        self._context = _open_encoder(*size, qp, self._luma_only, self._parameters)

    def encode(self, frame: Frame, qp: int | None = None) -> bytes:
        """Code one picture, at a QP of its own where there are several."""
        if qp not in (None, self._qp):
            if not self._several_qps:
                raise ValueError("`qp` is the same for all key frames but with `several_qps`")
            self._open(qp)
        if (frame.width, frame.height) != self._size:
            raise ValueError(f"`frame` must be {self._size} pixels, got {(frame.width, frame.height)}")
        pixel_format = "gray" if self._luma_only else "yuv420p"
        source = frame.without_chroma() if self._luma_only else frame
        picture = picture_from_frame(pad_frame(source, MACROBLOCK_PX), pixel_format)
        picture.pts = self._count
        self._count += 1
        packets = self._context.encode(picture)
        units = [u for packet in packets for u in _nal_units(bytes(packet)) if u[0] & 31 != _SEI_TYPE]
        assert [unit[0] for unit in units] == [_IDR_HEADER]
        return units[0][1:]

    def reconstruct(self, data: bytes) -> Frame:
        """Decode what `encode` gave, as the receiver will."""
        if self._decoder is None:
            self._decoder = KeyFrameDecoder(*self._size, self._parameter_sets, luma_only=self._luma_only)
        return self._decoder.decode(data)


class KeyFrameDecoder:
    """Decode pictures of `KeyFrameEncoder`, in any order; H.264 makes the result the same everywhere."""

    def __init__(self, width: int, height: int, parameter_sets: bytes, *, luma_only: bool = False) -> None:
        import av

        check_size(width, height, "key frames")
        self._size = (width, height)
        self._coded_size = _coded_size(width, height)
        self._luma_only = luma_only
        # The limit is checked against the decoder's buffers, which are wider than the picture.
        max_pixels = (self._coded_size[0] + 128) * (self._coded_size[1] + 128)
        self._context = av.CodecContext.create("h264", "r")
        self._context.thread_count = 1
        self._context.options = {**_DECODER_OPTIONS, "max_pixels": str(max_pixels)}
        self._context.extradata = _decoder_configuration(parameter_sets)
        try:
            self._context.open()
        except (av.FFmpegError, ValueError) as err:
            raise BitstreamError("key frames: the parameter sets are damaged") from err

    def decode(self, data: bytes) -> Frame:
        """Decode one picture."""
        picture = self._decode_picture(data)
        if picture.is_corrupt:
            raise BitstreamError("key frame: damaged picture")
        if (picture.width, picture.height) != self._coded_size:
            raise BitstreamError(
                f"key frame: the picture has {picture.width}x{picture.height} pixels, "
                f"not {self._coded_size[0]}x{self._coded_size[1]}"
            )
        if picture.format.name not in {"yuv420p", "gray"}:
            raise BitstreamError(f"key frame: the pixel format {picture.format.name} is not used here")
        return _crop(frame_from_picture(picture), *self._size, self._luma_only)

    def _decode_picture(self, data: bytes) -> "av.VideoFrame":
        """Push one slice through the decoder and leave the decoder empty."""
        import av

        if not data:
            raise BitstreamError("key frame: no data")
        packet = av.Packet(struct.pack(">IB", len(data) + 1, _IDR_HEADER) + data)
        try:
            pictures = [*self._context.decode(packet), *self._context.decode(None)]
        except (av.FFmpegError, ValueError) as err:
            raise BitstreamError(f"key frame: damaged data ({getattr(err, 'strerror', err)})") from err
        finally:
            self._context.flush_buffers()
        if len(pictures) != 1:
            raise BitstreamError(f"key frame: {len(pictures)} pictures where one is expected")
        return pictures[0]


def _coded_size(width: int, height: int) -> tuple[int, int]:
    """Round both sides up to whole macroblocks."""
    return -(-width // MACROBLOCK_PX) * MACROBLOCK_PX, -(-height // MACROBLOCK_PX) * MACROBLOCK_PX


def _open_encoder(
    width: int, height: int, qp: Qp, luma_only: bool, further: Mapping[str, int]
) -> "VideoCodecContext":
    """Open libx264 with parameter sets apart from the pictures."""
    import av
    from av.codec.context import Flags

    context = av.CodecContext.create("libx264", "w")
    context.width, context.height = width, height
    context.pix_fmt = "gray" if luma_only else "yuv420p"
    context.framerate = Fraction(25)
    context.time_base = Fraction(1, 25)
    context.thread_count = 1
    context.flags |= Flags.global_header
    parameters = {**_X264_PARAMETERS, **further}
    if not (luma_only or qp == "lossless"):
        parameters["chroma-qp-offset"] = CHROMA_QP_OFFSET
    context.options = {
        "preset": "medium",
        "tune": "zerolatency",
        "qp": "0" if qp == "lossless" else str(qp),
        "x264-params": ":".join(f"{name}={value}" for name, value in parameters.items()),
    }
    if qp != "lossless":
        context.profile = "High"
    context.open()
    return context


def _crop(frame: Frame, width: int, height: int, luma_only: bool) -> Frame:
    """Cut off what `pad_frame` added; the inverse of it."""
    luma = frame.luma[:height, :width].copy()
    if luma_only:
        return Frame(luma)
    rows, columns = (height + 1) // 2, (width + 1) // 2
    cb, cr = (plane[:rows, :columns].copy() for plane in frame.with_chroma().chroma or ())
    return Frame(luma, (cb, cr))


def _nal_units(stream: bytes) -> list[bytes]:
    """Split a byte stream with start codes ([H264] annex B) into NAL units."""
    return [unit for part in stream.split(_START_CODE) if (unit := part.rstrip(b"\x00"))]


def _join_parameter_sets(sps: bytes, pps: bytes) -> bytes:
    """Write both parameter sets without headers; the inverse of `_split_parameter_sets`."""
    return bytes([len(sps) - 1]) + sps[1:] + pps[1:]


def _split_parameter_sets(data: bytes) -> tuple[bytes, bytes]:
    """Read the sequence and the picture parameter set, headers put back."""
    if len(data) < 6 or not 4 <= data[0] < len(data) - 1 or len(data) > 2 * _MAX_SPS_BYTES:
        raise BitstreamError("key frames: the parameter sets are damaged")
    end = 1 + data[0]
    return bytes([_SPS_HEADER]) + data[1:end], bytes([_PPS_HEADER]) + data[end:]


def _decoder_configuration(parameter_sets: bytes) -> bytes:
    """Write an AVC decoder configuration record: from then on NAL units have 4-byte lengths."""
    sps, pps = _split_parameter_sets(parameter_sets)
    head = bytes([1]) + sps[1:4] + bytes([0xFF, 0xE1])
    return head + struct.pack(">H", len(sps)) + sps + b"\x01" + struct.pack(">H", len(pps)) + pps


def _without_vui(sps: bytes) -> bytes:
    """Leave out the usability information (timing, aspect), which ends a sequence parameter set."""
    payload = sps.replace(b"\x00\x00\x03", b"\x00\x00")
    bits = "".join(f"{byte:08b}" for byte in payload)
    end = _vui_flag_position(bits)
    kept = bits[:end] + "0" + "1"
    kept += "0" * (-len(kept) % 8)
    plain = bytes(int(kept[i : i + 8], 2) for i in range(0, len(kept), 8))
    # Where the shorter form would need escaping again, the long one serves as well.
    return sps if any(bytes((0, 0, low)) in plain for low in range(4)) else plain


def _vui_flag_position(bits: str) -> int:
    """Walk over a sequence parameter set as x264 writes it, up to `vui_parameters_present_flag`."""
    position = 32  # header, profile, constraints, level

    def unsigned() -> int:
        nonlocal position
        zeros = bits.index("1", position) - position
        start, position = position + zeros, position + 2 * zeros + 1
        return int(bits[start:position], 2) - 1

    unsigned()  # seq_parameter_set_id
    chroma_format = unsigned()
    assert chroma_format in {0, 1}
    unsigned()  # bit_depth_luma_minus8
    unsigned()  # bit_depth_chroma_minus8
    position += 1  # qpprime_y_zero_transform_bypass_flag
    assert bits[position] == "0", "no scaling matrices"
    position += 1
    unsigned()  # log2_max_frame_num_minus4
    picture_order_type = unsigned()
    assert picture_order_type == 2
    unsigned()  # max_num_ref_frames
    position += 1  # gaps_in_frame_num_value_allowed_flag
    unsigned()  # pic_width_in_mbs_minus1
    unsigned()  # pic_height_in_map_units_minus1
    assert bits[position : position + 3] == "110", "frames only, 8x8 inference, no cropping"
    return position + 3
