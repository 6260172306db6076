"""Conversion of all pixel formats of FFmpeg to 8-bit 4:2:0, and of frames to FFmpeg's pictures."""

from functools import partial
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from dvc.video.frames import Frame, Plane, chroma_shape

if TYPE_CHECKING:
    import av

RGB_NOTICE = "RGB converted to YCbCr BT.601 limited range"

_FULL_RANGE = 2  # AVCOL_RANGE_JPEG
_PLANAR_BITS = (8, 9, 10, 12, 14, 16)


def planar_frame_bytes(width: int, height: int) -> int:
    """Return the size of a planar 8-bit 4:2:0 frame."""
    rows, columns = chroma_shape(height, width)
    return width * height + 2 * rows * columns


def planar_frame(samples: Plane, width: int, height: int) -> Frame:
    """Take the planes of a 4:2:0 frame apart."""
    rows, columns = chroma_shape(height, width)
    luma, cb, cr = np.split(samples, [width * height, width * height + rows * columns])
    return Frame(luma.reshape(height, width), (cb.reshape(rows, columns), cr.reshape(rows, columns)))


def is_full_range(picture: "av.VideoFrame") -> bool:
    """Return whether the YCbCr samples of a decoded picture use 0 to 255; RGB never counts."""
    if _is_rgb(picture):
        return False
    return picture.format.name.startswith("yuvj") or picture.color_range == _FULL_RANGE


def conversion_notices(picture: "av.VideoFrame") -> tuple[str, ...]:
    """Return descriptions of the changes that `frame_from_picture` makes."""
    notices = []
    components = [c for c in picture.format.components if not c.is_alpha]
    if _is_rgb(picture):
        notices.append(RGB_NOTICE)
    elif is_full_range(picture):
        notices.append("full-range samples are kept as they are")
    if len(components) < len(picture.format.components):
        notices.append("alpha channel dropped")
    bits = max((c.bits for c in components), default=8)
    if bits > 8:
        notices.append(f"{bits}-bit source reduced to 8 bits")
    if _is_rgb(picture):
        notices.append("4:4:4 chroma subsampled to 4:2:0")
    elif len(components) > 1 and (ratio := _subsampling(picture)) != "420":
        verb = "interpolated" if ratio == "410" else "subsampled"
        notices.append(f"{':'.join(ratio)} chroma {verb} to 4:2:0")
    if picture.interlaced_frame:
        notices.append("interlaced source: both fields of a picture are kept woven into one frame")
    if picture.rotation:
        notices.append(f"the file asks for a rotation of {picture.rotation} degrees, which is not applied")
    return tuple(notices)


def frame_from_picture(picture: "av.VideoFrame") -> Frame:
    """Convert a decoded picture of any pixel format to 8-bit 4:2:0, or to luma if it is grey."""
    planar = _as_planar(picture)
    bits = planar.format.components[0].bits
    luma = _to_8_bits(_samples(planar, 0, bits), bits)
    if len([c for c in planar.format.components if not c.is_alpha]) == 1:
        return Frame(luma)
    shape = chroma_shape(*luma.shape)
    cb, cr = (_chroma_420(_samples(planar, index, bits), bits, luma.shape, shape) for index in (1, 2))
    return Frame(luma, (cb, cr))


def frame_from_rgb(picture: Plane) -> Frame:
    """Convert a picture to a frame, as RGB sources are converted."""
    import av

    colour = picture if picture.ndim == 3 else np.repeat(picture[:, :, None], 3, axis=2)
    return frame_from_picture(av.VideoFrame.from_ndarray(np.ascontiguousarray(colour), "rgb24"))


def picture_from_frame(frame: Frame, pixel_format: str) -> "av.VideoFrame":
    """Put a frame into an FFmpeg picture; the inverse of `frame_from_picture` for these two formats."""
    import av

    picture = av.VideoFrame(frame.width, frame.height, pixel_format)
    chroma = () if pixel_format == "gray" else frame.with_chroma().chroma or ()
    for target, plane in zip(picture.planes, (frame.luma, *chroma), strict=True):
        rows = np.zeros((plane.shape[0], target.line_size), np.uint8)
        rows[:, : plane.shape[1]] = plane
        target.update(rows.tobytes())
    return picture


def rgb_from_frame(frame: Frame) -> Plane:
    """Return a frame as red, green and blue, shape (H, W, 3); inverse of `frame_from_rgb`."""
    return np.ascontiguousarray(picture_from_frame(frame, "yuv420p").to_ndarray(format="rgb24"), np.uint8)


def _is_rgb(picture: "av.VideoFrame") -> bool:
    """Return whether the samples are red, green and blue, direct or through a palette."""
    return picture.format.is_rgb or picture.format.has_palette or picture.format.name.startswith("xyz")


def _subsampling(picture: "av.VideoFrame") -> str:
    """Name the chroma resolution of a format, such as ``"422"``."""
    import av

    # The picture itself may be too small: one pixel has one chroma sample in every format.
    chroma = av.VideoFormat(picture.format.name, 16, 16).components[1]
    names = {(16, 16): "444", (8, 16): "422", (16, 8): "440", (8, 8): "420", (4, 16): "411", (4, 4): "410"}
    return names.get((chroma.width, chroma.height), "420")


def _as_planar(picture: "av.VideoFrame") -> "av.VideoFrame":
    """Return the picture in a format with directly readable planes, of the same range and depth."""
    from av.video.reformatter import ColorRange, Colorspace

    kind, convert = picture.format, partial(picture.reformat, threads=1)
    if _is_rgb(picture):
        return convert(
            format="yuv444p16le", dst_colorspace=Colorspace.ITU601, dst_color_range=ColorRange.MPEG
        )
    is_plain = not kind.is_bit_stream and not any(part in kind.name for part in ("f16", "f32", "msb"))
    has_planes = [c.plane for c in kind.components] == list(range(len(picture.planes)))
    if is_plain and has_planes and all(c.bits in _PLANAR_BITS for c in kind.components):
        return picture
    components = [c for c in kind.components if not c.is_alpha]
    bits = components[0].bits
    suffix = "" if bits <= 8 else f"{bits}le" if bits in {10, 12} else "16le"
    if len(components) == 1:
        return convert(format="gray" + suffix)
    same = ColorRange.JPEG if is_full_range(picture) else ColorRange.MPEG
    name = f"yuv{_subsampling(picture)}p{suffix}"
    return convert(format=name, src_color_range=same, dst_color_range=same)


def _samples(picture: "av.VideoFrame", index: int, bits: int) -> NDArray[Any]:
    """Return a view of the samples of one plane, without the padding at the ends of its rows."""
    plane = picture.planes[index]
    padded = np.frombuffer(memoryview(cast(Any, plane)), np.uint8).reshape(-1, abs(plane.line_size))
    if bits == 8:
        return padded[: plane.height, : plane.width]
    order = ">u2" if picture.format.is_big_endian else "<u2"
    return padded[: plane.height, : 2 * plane.width].view(order)


def _to_8_bits(samples: NDArray[Any], bits: int) -> Plane:
    """Round to 8 bits; always a new array."""
    if bits == 8:
        return samples.astype(np.uint8)
    rounded = (samples.astype(np.uint32) + (1 << (bits - 9))) >> (bits - 8)
    return cast(Plane, np.minimum(rounded, 255).astype(np.uint8))


def _chroma_420(
    samples: NDArray[Any], bits: int, luma_shape: tuple[int, ...], shape: tuple[int, int]
) -> Plane:
    """Resample a chroma plane to 4:2:0 and 8 bits with one rounding at the end."""
    if samples.shape == shape:
        return _to_8_bits(samples, bits)
    total = samples.astype(np.uint32)
    if total.shape[0] == luma_shape[0] != shape[0]:
        below = np.minimum(np.arange(shape[0]) * 2 + 1, luma_shape[0] - 1)
        total = total[::2] + total[below]
        bits += 1
    else:
        total = np.repeat(total, -(-shape[0] // total.shape[0]), axis=0)[: shape[0]]
    if total.shape[1] == luma_shape[1] != shape[1]:
        centre = np.arange(shape[1]) * 2
        right = np.minimum(centre + 1, luma_shape[1] - 1)
        total = total[:, np.maximum(centre - 1, 0)] + 2 * total[:, centre] + total[:, right]
        bits += 2
    else:
        total = np.repeat(total, -(-shape[1] // total.shape[1]), axis=1)[:, : shape[1]]
    return _to_8_bits(total, bits)
