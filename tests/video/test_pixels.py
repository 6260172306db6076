"""Tests of the conversion of any pixel format to 8-bit 4:2:0."""

import av
import numpy as np
import pytest
from numpy.typing import NDArray

from dvc.video import Frame, chroma_shape
from dvc.video.pixels import (
    RGB_NOTICE,
    conversion_notices,
    frame_from_picture,
    frame_from_rgb,
    is_full_range,
    picture_from_frame,
    rgb_from_frame,
)
from tests.clips import same_frame


def colour_picture(width: int = 38, height: int = 22) -> av.VideoFrame:
    rows, columns = np.mgrid[:height, :width]
    blue = 255 - (rows + columns) * 255 // (width + height)
    channels = [columns * 255 // width, rows * 255 // height, blue]
    return av.VideoFrame.from_ndarray(np.stack(channels, axis=-1).astype(np.uint8), format="rgb24")


def planar_picture(pixel_format: str, planes: list[NDArray[np.integer]]) -> av.VideoFrame:
    """Fill a picture of a planar format, of 8 bits or of more in two bytes."""
    height, width = planes[0].shape
    picture = av.VideoFrame(width, height, pixel_format)
    for target, plane in zip(picture.planes, planes, strict=True):
        num_bytes = 2 if picture.format.components[0].bits > 8 else 1
        rows = np.zeros((plane.shape[0], target.line_size), np.uint8)
        order = ">" if picture.format.is_big_endian else "<"
        samples = np.ascontiguousarray(plane.astype(f"{order}u{num_bytes}"))
        rows[:, : plane.shape[1] * num_bytes] = samples.view(np.uint8).reshape(plane.shape[0], -1)
        target.update(rows.tobytes())
    return picture


def exact_ycbcr(picture: av.VideoFrame) -> NDArray[np.float64]:
    """Return the BT.601 limited-range values of an RGB picture without rounding."""
    red, green, blue = np.moveaxis(picture.to_ndarray(format="rgb24") / 255.0, -1, 0)
    luma = 0.299 * red + 0.587 * green + 0.114 * blue
    return np.stack([16 + 219 * luma, 128 + 224 * (blue - luma) / 1.772, 128 + 224 * (red - luma) / 1.402])


@pytest.mark.parametrize("size", [(38, 22), (37, 21), (1, 1), (64, 48)])
def test_rgb_follows_bt601(size: tuple[int, int]) -> None:
    picture = colour_picture(*size)
    luma, *chroma = exact_ycbcr(picture)
    frame = frame_from_picture(picture)
    assert np.abs(frame.luma - luma).max() <= 0.53
    for got, full in zip(frame.chroma or (), chroma, strict=True):
        below = np.minimum(np.arange(1, 2 * got.shape[0], 2), full.shape[0] - 1)
        rows = (full[::2] + full[below]) / 2
        centre = np.arange(0, full.shape[1], 2)
        left, right = np.maximum(centre - 1, 0), np.minimum(centre + 1, full.shape[1] - 1)
        expected = (rows[:, left] + 2 * rows[:, centre] + rows[:, right]) / 4
        assert np.abs(got - expected).max() <= 0.6


def test_rgb_is_converted_the_same_every_time() -> None:
    """Sides that are no multiple of a vector do not make the conversion depend on threads."""
    frames = [frame_from_picture(colour_picture()) for _ in range(300)]
    assert all(same_frame(frame, frames[0]) for frame in frames)


@pytest.mark.parametrize("size", [(8, 6), (7, 5), (1, 1), (3, 1)])
@pytest.mark.parametrize("pixel_format", ["gray", "yuv420p"])
def test_plain_formats_are_copied_both_ways(size: tuple[int, int], pixel_format: str) -> None:
    rng = np.random.default_rng(0)
    width, height = size
    planes = [
        rng.integers(0, 256, s, dtype=np.uint8) for s in ((height, width), *2 * [chroma_shape(height, width)])
    ]
    frame = Frame(planes[0], None if pixel_format == "gray" else (planes[1], planes[2]))
    picture = picture_from_frame(frame, pixel_format)
    assert conversion_notices(picture) == ()
    assert same_frame(frame_from_picture(picture), frame)


@pytest.mark.parametrize("order", ["le", "be"])
@pytest.mark.parametrize("bits", [9, 10, 12, 16])
def test_deep_samples_are_rounded_to_nearest(bits: int, order: str) -> None:
    values = np.linspace(0, 2**bits - 1, 64 * 64).astype(np.int64).reshape(64, 64)
    picture = planar_picture(f"gray{bits}{order}", [values])
    expected = np.minimum(np.floor(values / 2 ** (bits - 8) + 0.5), 255)
    frame = frame_from_picture(picture)
    assert np.array_equal(frame.luma, expected)
    assert conversion_notices(picture) == (f"{bits}-bit source reduced to 8 bits",)


@pytest.mark.parametrize("pixel_format", ["yuv444p", "yuv422p", "yuv440p", "yuv420p", "yuv411p", "yuv410p"])
@pytest.mark.parametrize("size", [(16, 8), (13, 7)])
def test_flat_colours_survive_any_chroma_resolution(pixel_format: str, size: tuple[int, int]) -> None:
    layout = av.VideoFormat(pixel_format, *size).components
    rng = np.random.default_rng(0)
    luma = rng.integers(0, 256, (size[1], size[0]))
    flat = [np.full((c.height, c.width), value) for c, value in zip(layout[1:], (90, 201), strict=True)]
    picture = planar_picture(pixel_format, [luma, *flat])
    frame = frame_from_picture(picture)
    assert np.array_equal(frame.luma, luma)
    assert [set(np.unique(plane)) for plane in frame.chroma or ()] == [{90}, {201}]
    expected = 0 if pixel_format == "yuv420p" else 1
    assert len(conversion_notices(picture)) == expected


@pytest.mark.parametrize("pixel_format", ["nv12", "yuyv422", "uyvy422", "p010le", "p016le", "nv16", "nv24"])
def test_packed_formats_equal_their_planar_twins(pixel_format: str) -> None:
    deep = pixel_format.startswith("p0")
    subsampling = {"nv12": "420", "nv24": "444", "p010le": "420", "p016le": "420"}.get(pixel_format, "422")
    depth = {"p010le": "10le", "p016le": "16le"}.get(pixel_format, "")
    planar = colour_picture(40, 24).reformat(format=f"yuv{subsampling}p{depth}", threads=1)
    packed = planar.reformat(format=pixel_format, threads=1)
    assert same_frame(frame_from_picture(packed), frame_from_picture(planar))
    assert any("reduced" in notice for notice in conversion_notices(packed)) == deep


@pytest.mark.parametrize(
    ("pixel_format", "notices"),
    [
        ("yuva420p", ("alpha channel dropped",)),
        ("ya8", ("alpha channel dropped",)),
        ("yuvj420p", ("full-range samples are kept as they are",)),
        ("rgba", (RGB_NOTICE, "alpha channel dropped", "4:4:4 chroma subsampled to 4:2:0")),
        ("pal8", (RGB_NOTICE,)),
    ],
)
def test_notices_say_what_is_changed(pixel_format: str, notices: tuple[str, ...]) -> None:
    got = conversion_notices(av.VideoFrame(16, 16, pixel_format))
    assert got[: len(notices)] == notices
    for size in ((1, 1), (2, 1), (1, 2)):  # the chroma resolution of tiny pictures is that of the format
        assert conversion_notices(av.VideoFrame(*size, "yuv420p")) == ()
        assert conversion_notices(av.VideoFrame(*size, "yuv444p")) == ("4:4:4 chroma subsampled to 4:2:0",)


def test_full_range_samples_are_not_changed() -> None:
    luma = np.arange(256).reshape(16, 16)
    chroma = np.full((8, 8), 77)
    picture = planar_picture("yuvj420p", [luma, chroma, chroma])
    assert is_full_range(picture)
    frame = frame_from_picture(picture)
    assert np.array_equal(frame.luma, luma)
    packed = picture.reformat(format="nv12", src_color_range=2, dst_color_range=2, threads=1)
    packed.color_range = 2
    assert same_frame(frame_from_picture(packed), frame)


def test_grey_with_alpha_keeps_its_samples() -> None:
    luma = np.arange(256, dtype=np.uint8).reshape(16, 16)
    picture = av.VideoFrame(16, 16, "ya8")
    rows = np.zeros((16, picture.planes[0].line_size), np.uint8)
    rows[:, :32:2], rows[:, 1:32:2] = luma, 200
    picture.planes[0].update(rows.tobytes())
    for color_range in (0, 1, 2):
        picture.color_range = color_range
        frame = frame_from_picture(picture)
        assert frame.chroma is None
        assert np.array_equal(frame.luma, luma)


@pytest.mark.parametrize("size", [(33, 47), (24, 32)])
def test_colours_come_back_from_frames(size: tuple[int, int]) -> None:
    """Smooth colours nearly, black and white of grey frames exactly; odd sides as well."""
    y, x = np.mgrid[: size[0], : size[1]] / max(size)
    picture = np.rint(255 * np.stack([x, y, 0.5 * (x + y)], axis=-1)).astype(np.uint8)
    found = rgb_from_frame(frame_from_rgb(picture))
    assert found.shape == picture.shape
    assert np.abs(found.astype(int) - picture).mean() < 4.0
    luma = np.full(size, 16, np.uint8)
    luma[0] = 235
    found = rgb_from_frame(Frame(luma))
    assert (found[1:] == 0).all()
    assert (found[0] == 255).all()
