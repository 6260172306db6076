"""Lifting: exact inverse for any size, the filters of the 9/7, its norms, constants stay in the low band."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.images.lifting import (
    WAVELETS,
    Pyramid,
    Transform,
    low_band_gain,
    most_levels,
    scale_shapes,
)
from tests.images.columns import merge, split

SIZES = st.integers(1, 40)
# Analysis filters of the biorthogonal 4.4 wavelet, from the middle outwards.
LOW_TAPS = [
    0.8526986790094034,
    0.3774028556126538,
    -0.1106244044184234,
    -0.0238494650193800,
    0.0378284555069955,
]
HIGH_TAPS = [0.7884856164056644, -0.4180922732222122, -0.0406894176095584, 0.0645388826289385]


@given(SIZES, SIZES, st.integers(0, 8), st.sampled_from(sorted(WAVELETS)), st.integers(0, 2**32 - 1))
def test_planes_come_back(rows: int, columns: int, num_levels: int, name: str, seed: int) -> None:
    """Any plane is what its coefficients are synthesised to, and there are as many of them."""
    plane = np.random.default_rng(seed).uniform(0.0, 255.0, (rows, columns))
    transform = Transform(num_levels, name)
    pyramid = transform.analyse(plane)
    assert np.abs(transform.synthesise(pyramid) - plane).max() < 1e-9
    sizes = [pyramid.low.size, *(band.size for details in pyramid.details for band in details.bands)]
    assert sum(sizes) == plane.size
    assert pyramid.low.shape == scale_shapes((rows, columns), num_levels)[-1]


def filtered(signal: np.ndarray, taps: list[float], centre: int) -> float:
    """Return one sample of a symmetric filter on a signal that is mirrored about its ends."""
    mirrored = np.pad(signal, 10, mode="reflect")
    reach = np.arange(-len(taps) + 1, len(taps))
    return float(sum(taps[abs(k)] * mirrored[10 + centre + k] for k in reach))


@pytest.mark.parametrize("length", [11, 16, 21])
def test_steps_are_the_filters(length: int) -> None:
    """The 9/7 by lifting is filtering by the published taps, borders included."""
    signal = np.random.default_rng(3).normal(size=length)
    low, high = split(signal[:, np.newaxis])
    assert low[:, 0] == pytest.approx([filtered(signal, LOW_TAPS, k) for k in range(0, length, 2)], abs=1e-9)
    assert high[:, 0] == pytest.approx(
        [filtered(signal, HIGH_TAPS, k) for k in range(1, length, 2)], abs=1e-9
    )


def test_five_three_by_hand() -> None:
    """The 5/3 of a short signal, calculated by hand."""
    low, high = split(np.array([[1.0], [2.0], [4.0], [8.0]]), "5/3")
    assert high[:, 0] * np.sqrt(2.0) == pytest.approx([-0.5, 4.0])
    assert low[:, 0] / np.sqrt(2.0) == pytest.approx([0.75, 4.875])


@pytest.mark.parametrize("length", [16, 33, 64])
def test_scaling_is_nearly_orthonormal(length: int) -> None:
    """Singular values of the synthesis, and the mean squared norm of its vectors, are those of (3.9)."""
    half = (length + 1) // 2
    identity = np.eye(length)
    synthesis = merge(identity[:half], identity[half:])
    values = np.linalg.svd(synthesis, compute_uv=False)
    assert values.min() > 0.79
    assert values.max() < 1.30
    assert np.mean(np.sum(synthesis**2, axis=0)) == pytest.approx(1.02, abs=0.02)


@given(SIZES, SIZES, st.integers(0, 7), st.sampled_from(sorted(WAVELETS)))
def test_constants_are_low(rows: int, columns: int, num_levels: int, name: str) -> None:
    """A constant plane has no details, and its low band is the gain that the codec divides by."""
    pyramid = Transform(num_levels, name).analyse(np.ones((rows, columns)))
    assert pyramid.low == pytest.approx(np.full_like(pyramid.low, low_band_gain((rows, columns), num_levels)))
    assert all(np.abs(band).max(initial=0.0) < 1e-9 for each in pyramid.details for band in each.bands)


def test_levels_end_at_one_pixel() -> None:
    """The most levels leave one sample, and one fewer do not."""
    for shape in [(1, 1), (1, 2), (3, 2), (375, 450), (512, 512), (1, 513)]:
        levels = most_levels(shape)
        assert scale_shapes(shape, levels)[-1] == (1, 1)
        assert levels == 0 or scale_shapes(shape, levels - 1)[-1] != (1, 1)


def test_coarse_scales_alone() -> None:
    """Without its finest details a pyramid is the low band of that scale."""
    plane = np.random.default_rng(0).normal(size=(37, 22))
    whole, less = Transform(4).analyse(plane), Transform(2).analyse(plane)
    assert Transform(4).synthesise(Pyramid(whole.low, whole.details[2:])) == pytest.approx(
        less.low, abs=1e-12
    )


def test_wrong_arguments_are_named() -> None:
    """Empty planes, and planes of one dimension, are refused."""
    with pytest.raises(ValueError, match="`plane`"):
        Transform(1).analyse(np.zeros((0, 3)))
    with pytest.raises(ValueError, match="`plane`"):
        Transform(1).analyse(np.zeros(5))
    with pytest.raises(ValueError, match="`num_levels`"):
        Transform(-1)
