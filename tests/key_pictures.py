"""H.264 pictures, taken apart and put together for tests of key frames."""

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import av

from dvc.keyframes import KeyPicture


def split_sets(parameter_sets: bytes) -> tuple[bytes, bytes]:
    """Return the payloads of both parameter sets."""
    end = 1 + parameter_sets[0]
    return parameter_sets[1:end], parameter_sets[end:]


def join_sets(sps: bytes, pps: bytes) -> bytes:
    """Write both parameter sets as streams hold them."""
    return bytes([len(sps)]) + sps + pps


def coded_qps(parameter_sets: bytes, pictures: Sequence[KeyPicture]) -> list[set[int]]:
    """Return the QPs of the macroblocks of each picture of a chain, as FFmpeg's decoder exports them."""
    sps, pps = (
        b"\0\0\1" + header + own for header, own in zip((b"g", b"h"), split_sets(parameter_sets), strict=True)
    )
    context = av.CodecContext.create("h264", "r")
    context.thread_count = 1
    context.options = {"export_side_data": "venc_params"}
    found = []
    for picture in pictures:
        unit = b"\0\0\1" + (b"\x41" if picture.predicted else b"\x65") + picture.data
        (decoded,) = context.decode(av.Packet(sps + pps + unit))
        (exported,) = (bytes(data) for data in decoded.side_data if data.type.name == "VIDEO_ENC_PARAMS")
        count, offset, size, _, qp = struct.unpack_from("@INNii", exported)
        deltas = (struct.unpack_from("iiiii", exported, offset + k * size)[4] for k in range(count))
        found.append({qp + delta for delta in deltas})
    return found


@dataclass(frozen=True)
class Sps:
    """A sequence parameter set ([H264] 7.3.2.1.1): that of key frames of 64x48 pixels, unless changed."""

    profile: int = 100
    chroma_format: int = 1
    more_bits: tuple[int, int] = (0, 0)  # of luma and chroma, beyond 8
    scaled: int = 0
    frame_num_bits: int = 4
    order_type: int = 2
    num_references: int = 3
    gaps: int = 0
    macroblocks: tuple[int, int] = (4, 3)
    frames_only: int = 1
    cropped: int = 0

    def payload(self) -> bytes:
        """Write it."""
        digits = f"{self.profile:08b}{0:08b}{10:08b}"
        digits += "".join(map(exp_golomb, (0, self.chroma_format, *self.more_bits))) + f"0{self.scaled}"
        digits += "0" * 8 * self.scaled  # scaling lists that are not present
        digits += "".join(map(exp_golomb, (self.frame_num_bits - 4, self.order_type, self.num_references)))
        digits += f"{self.gaps}" + "".join(exp_golomb(count - 1) for count in self.macroblocks)
        digits += f"{self.frames_only}" + "0" * (not self.frames_only) + f"1{self.cropped}"
        digits += exp_golomb(0) * 4 * self.cropped
        return _packed(digits + "01")


@dataclass(frozen=True)
class SliceHead:
    """The beginning of a slice ([H264] 7.3.3) of a stream with frame numbers of four bits."""

    first_macroblock: int
    slice_type: int
    pps: int
    frame_num: int


def slice_head(data: bytes) -> tuple[SliceHead, str]:
    """Read the beginning of a slice; return it and the bits behind it."""
    bits = iter("".join(f"{byte:08b}" for byte in data))
    first, kind, pps = (_read_exp_golomb(bits) for _ in range(3))
    return SliceHead(first, kind, pps, int("".join(next(bits) for _ in range(4)), 2)), "".join(bits)


def with_head(head: SliceHead, rest: str) -> bytes:
    """Write a slice with another beginning."""
    numbers = head.first_macroblock, head.slice_type, head.pps
    return _packed("".join(map(exp_golomb, numbers)) + f"{head.frame_num:04b}" + rest)


def exp_golomb(value: int) -> str:
    """Spell an unsigned Exp-Golomb code."""
    digits = f"{value + 1:b}"
    return "0" * (len(digits) - 1) + digits


def _read_exp_golomb(bits: Iterator[str]) -> int:
    num_zeros = 0
    while next(bits) == "0":
        num_zeros += 1
    return (1 << num_zeros) - 1 + int("0" + "".join(next(bits) for _ in range(num_zeros)), 2)


def _packed(digits: str) -> bytes:
    size = -(-len(digits) // 8)
    return int(digits.ljust(8 * size, "0"), 2).to_bytes(size, "big")
