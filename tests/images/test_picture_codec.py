"""Codec of the reference view: pictures of any size and colour, multipliers, layers, resolution, headers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dvc.errors import BitstreamError
from dvc.images import picture_codec as codec
from dvc.images.colour import rgb_from_ycbcr, ycbcr_from_rgb
from dvc.images.picture_codec import PictureHeader
from dvc.metrics import psnr_db


def picture(rows: int, columns: int, colour: bool = False, seed: int = 0) -> np.ndarray:
    """Draw a smooth picture with an edge and some noise."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:rows, :columns]
    gray = (
        110 + 60 * np.sin(x / 9.0) * np.cos(y / 13.0) + 50 * (x + 2 * y > columns) + rng.normal(0, 3, x.shape)
    )
    planes = [gray, gray[::-1], 255 - gray] if colour else [gray]
    stacked = np.clip(np.stack(planes, -1), 0, 255).astype(np.uint8)
    return stacked if colour else stacked[..., 0]


@given(st.integers(1, 40), st.integers(1, 40), st.booleans(), st.sampled_from(["9/7", "5/3"]))
@settings(max_examples=40)
def test_all_bit_planes_are_nearly_the_picture(rows: int, columns: int, colour: bool, wavelet: str) -> None:
    original = picture(rows, columns, colour)
    header, data = codec.encode(original, wavelet=wavelet).cut(10**9)
    decoded = codec.decode(PictureHeader.from_bytes(header.to_bytes()), data, (rows, columns))
    assert decoded.picture().shape == original.shape
    assert np.abs(decoded.picture().astype(int) - original).max() <= 2


def test_error_is_what_the_curve_says() -> None:
    original = picture(96, 75)
    code = codec.encode(original)
    for num_bytes in (100, 400, 1600):
        header, data = code.cut(num_bytes)
        decoded = codec.decode(header, data, code.shape)
        found = float(np.mean((decoded.planes[0] - original) ** 2)) / 255**2
        told = float(np.interp(num_bytes * 8 / original.size, code.bits_per_pixel, code.mse))
        assert found == pytest.approx(told, rel=0.15)


def test_multipliers_choose_rates() -> None:
    code = codec.encode(picture(96, 75))
    lengths = [code.bytes_at_multiplier(multiplier) for multiplier in (1.0, 1e-2, 1e-3, 1e-4, 1e-5, 0.0)]
    assert lengths == sorted(lengths)
    assert lengths[0] < 20
    assert lengths[-1] == len(code.data)
    rate = lengths[2] * 8 / (96 * 75)
    for other in (rate - 0.2, rate + 0.2):
        gained = np.interp(rate, code.bits_per_pixel, code.mse) - np.interp(
            other, code.bits_per_pixel, code.mse
        )
        assert gained <= 1e-3 * (other - rate) + 1e-6


def test_layers_are_cuts() -> None:
    original = picture(64, 80)
    code = codec.encode(original)
    qualities = []
    for num_bytes in (60, 200, 700, 2000):
        header, data = code.cut(num_bytes)
        short = codec.encode(original, num_bytes)
        assert short.data == data
        decoded = codec.decode(header, code.data[:num_bytes], code.shape)
        again = codec.decode(header, short.data, code.shape)
        assert np.array_equal(decoded.planes, again.planes)
        qualities.append(psnr_db(decoded.picture(), original))
    assert np.all(np.diff(qualities) > 1.0)


def test_every_cut_decodes() -> None:
    code = codec.encode(picture(17, 22, colour=True))
    header, data = code.cut(10**9)
    significant = 0
    for length in [*range(0, len(data), 2), len(data)]:
        decoded = codec.decode(header, data[:length], code.shape)
        now = sum(int(each.sum()) for each in decoded.significance)
        assert now >= significant
        significant = now
    assert decoded.significance[0].shape == (9, 11)
    assert decoded.significance[-1].shape == (1, 1)


@pytest.mark.parametrize("shape", [(64, 64), (37, 50), (1, 40)])
def test_coarse_resolutions_are_intensities(shape: tuple[int, int]) -> None:
    y, x = np.mgrid[: shape[0], : shape[1]]
    ramp = 60 + x + y
    code = codec.encode(ramp)
    header, data = code.cut(10**9)
    coarse = codec.decode(header, data, shape, 2).planes[0]
    assert coarse.shape == (-(-shape[0] // 4), -(-shape[1] // 4))
    inner = (slice(2, -2) if shape[0] > 16 else slice(None), slice(2, -2))
    assert coarse[inner] == pytest.approx(ramp[::4, ::4][inner], abs=1.5)


def test_better_than_plain_bits() -> None:
    original = picture(128, 128)
    sizes = {}
    for adaptive in (True, False):
        code = codec.encode(original, adaptive=adaptive)
        sizes[adaptive] = float(np.interp(-1e-4, -code.mse, code.bits_per_pixel))
    assert sizes[True] < 0.9 * sizes[False]


def test_constant_pictures_are_a_few_bytes() -> None:
    for value in (0, 77, 128, 255):
        code = codec.encode(np.full((50, 60), value, np.uint8))
        header, data = code.cut(code.bytes_at_multiplier(1e-7))
        assert len(data) < 40
        assert np.abs(codec.decode(header, data, (50, 60)).planes - value).max() < 1.0


@given(st.binary(max_size=60), st.binary(min_size=3, max_size=3))
def test_any_bytes_are_a_picture_or_refused(data: bytes, header: bytes) -> None:
    try:
        decoded = codec.decode(PictureHeader.from_bytes(header), data, (21, 10))
    except BitstreamError:
        return
    assert decoded.picture().shape[:2] == (21, 10)
    assert np.isfinite(decoded.planes).all()


@pytest.mark.parametrize(
    ("shape", "options", "message"),
    [
        ((3, 3, 4), {}, "`picture`"),
        ((0, 3), {}, "`picture`"),
        ((3, 3), {"num_levels": 16}, "`num_levels`"),
        ((3, 3), {"wavelet": "haar"}, "`wavelet`"),
    ],
)
def test_wrong_arguments_are_named(shape, options, message) -> None:
    with pytest.raises(ValueError, match=message):
        codec.encode(np.zeros(shape), **options)
    header, data = codec.encode(picture(8, 8)).cut(30)
    with pytest.raises(ValueError, match="`num_skipped_levels`"):
        codec.decode(header, data, (8, 8), 4)
    with pytest.raises(BitstreamError, match="cut off"):
        PictureHeader.from_bytes(b"\0\0")


def test_colours_come_back() -> None:
    rgb = np.random.default_rng(0).uniform(0, 255, (4, 5, 3))
    assert rgb_from_ycbcr(ycbcr_from_rgb(rgb)) == pytest.approx(rgb)
    red = ycbcr_from_rgb([[[255.0, 0.0, 0.0]]])[:, 0, 0]
    assert red == pytest.approx([0.299 * 255, -0.168736 * 255, 127.5], abs=1e-3)


def test_frozen_code_is_read() -> None:
    y, x = np.mgrid[:12, :16]
    original = ((x * x + 3 * y * y + 140 * (x > y)) % 200 + 20).astype(np.uint8)
    frozen = (
        "c4cc10a714508ca8b7556ff7f452dd2f1b04617b15ce89df2f39c98ae7f0"
        "b332b9960135ac4a00ad6760a9c57dfaf669ce614945fe114631ada28bdc"
    )
    header = PictureHeader.from_bytes(bytes.fromhex("440b9e"))
    decoded = codec.decode(header, bytes.fromhex(frozen), original.shape).picture().astype(int)
    assert decoded.sum() == 22426
    assert np.abs(decoded - original).mean() == 10.53125
    assert codec.encode(original).cut(60) == (header, bytes.fromhex(frozen))
