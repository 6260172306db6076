"""Lifting of planes, with edges and masks: exact inverses, filters, norms, constants, twins, moments."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.images.edge_maps import EdgeMaps, edges_inside
from dvc.images.lifting import (
    MAX_ORDER,
    WAVELETS,
    Pyramid,
    Transform,
    low_band_gain,
    mask_pyramid,
    most_levels,
    scale_shapes,
)
from tests.images.columns import merge, random_edges, split
from tests.reference import lifting

SIZES = st.integers(1, 40)
ORDERS = range(MAX_ORDER + 1)
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
    sizes = [pyramid.low.size, *(band.size for details in pyramid.details for band in details)]
    assert sum(sizes) == plane.size
    assert pyramid.low.shape == scale_shapes((rows, columns), num_levels)[-1]


def filtered(signal: np.ndarray, taps: list[float], centre: int) -> float:
    """Return one sample of a symmetric filter on a signal that is mirrored about its ends."""
    mirrored = np.pad(signal, 10, mode="reflect")
    reach = np.arange(-len(taps) + 1, len(taps))
    return float(sum(taps[abs(k)] * mirrored[10 + centre + k] for k in reach))


@pytest.mark.parametrize("length", [11, 16, 21])
def test_steps_are_the_filters(length: int) -> None:
    signal = np.random.default_rng(3).normal(size=length)
    low, high = split(signal[:, np.newaxis])
    assert low[:, 0] == pytest.approx([filtered(signal, LOW_TAPS, k) for k in range(0, length, 2)], abs=1e-9)
    assert high[:, 0] == pytest.approx(
        [filtered(signal, HIGH_TAPS, k) for k in range(1, length, 2)], abs=1e-9
    )


def test_five_three_by_hand() -> None:
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
    pyramid = Transform(num_levels, name).analyse(np.ones((rows, columns)))
    assert pyramid.low == pytest.approx(np.full_like(pyramid.low, low_band_gain((rows, columns), num_levels)))
    assert all(np.abs(band).max(initial=0.0) < 1e-9 for each in pyramid.details for band in each)


def test_levels_end_at_one_pixel() -> None:
    for shape in [(1, 1), (1, 2), (3, 2), (375, 450), (512, 512), (1, 513)]:
        levels = most_levels(shape)
        assert scale_shapes(shape, levels)[-1] == (1, 1)
        assert levels == 0 or scale_shapes(shape, levels - 1)[-1] != (1, 1)


def test_coarse_scales_alone() -> None:
    plane = np.random.default_rng(0).normal(size=(37, 22))
    whole, less = Transform(4).analyse(plane), Transform(2).analyse(plane)
    assert Transform(4).synthesise(Pyramid(whole.low, whole.details[2:])) == pytest.approx(
        less.low, abs=1e-12
    )


def plain_split(signal, cuts, order, wavelet):
    """Lift one signal sample by sample; polynomials are fitted, not looked up."""
    samples = list(map(float, signal))
    last = len(samples) - 1

    def segment(i):
        first = max((k + 1 for k in range(i) if cuts[k]), default=0)
        return first, min((k for k in range(i, last) if cuts[k]), default=last)

    def neighbour(i, way):
        first, end = segment(i)
        j = i + way
        if not 0 <= j <= last:
            return samples[i - way] if first <= i - way <= end else None
        if first <= j <= end:
            return samples[j]
        known = [k for k in range(i - way, i - way * (2 * order + 3), -2 * way) if first <= k <= end]
        if not known:
            return None
        powers = np.vander(np.array(known, float) - j, len(known))
        return np.linalg.solve(powers, [samples[k] for k in known])[-1]

    for step, weight in enumerate(wavelet.weights):
        changed = samples.copy()
        for i in range(1 - step % 2, last + 1, 2):
            first, end = segment(i)
            final = order > 0 and step == len(wavelet.weights) - 1
            if first == end and i % 2 == 0:
                changed[i] = samples[i] * (wavelet.gain if step == 1 else 1.0)
                continue
            if first == end:
                around = [samples[i - 1], samples[i + 1] if i < last else samples[i - 1]]
            else:
                around = []
                for way in (-1, 1):
                    beyond = 0 <= i + way <= last and not first <= i + way <= end
                    around.append(0.0 if final and beyond else neighbour(i, way))
            changed[i] = samples[i] + weight * sum(around)
        samples = changed
    low, high = wavelet.scales
    return np.array(samples[0::2]) * low, np.array(samples[1::2]) * high


@pytest.mark.nojit
@pytest.mark.parametrize("name", WAVELETS)
@pytest.mark.parametrize("order", ORDERS)
def test_columns_are_lifted_as_by_a_plain_twin(name, order):
    rng = np.random.default_rng(order)
    for length in (2, 3, 4, 9, 16, 31):
        signal = rng.normal(size=(length, 5))
        cuts = (rng.random((length, 5)) < 0.3).astype(np.uint8)
        cuts[-1] = 0
        found = split(signal, name, cuts, order)
        for t in range(5):
            wanted = plain_split(signal[:, t], cuts[:, t], order, WAVELETS[name])
            np.testing.assert_allclose(found[0][:, t], wanted[0], atol=1e-10)
            np.testing.assert_allclose(found[1][:, t], wanted[1], atol=1e-10)


@pytest.mark.parametrize("name", WAVELETS)
@pytest.mark.parametrize("order", ORDERS)
def test_without_edges_it_is_the_standard_transform_to_the_last_bit(name, order):
    plane = np.random.default_rng(1).normal(size=(37, 50))
    found = Transform(5, name, None, order).analyse(plane)
    wanted = lifting.analyse(plane, 5, name)
    np.testing.assert_array_equal(found.low, wanted.low)
    for one, other in zip(found.details, wanted.details, strict=True):
        for band, expected in zip(one, other, strict=True):
            np.testing.assert_array_equal(band, expected)


@pytest.mark.parametrize(
    ("name", "order"), [("5/3", 0), ("5/3", 1), ("9/7", 0), ("9/7", 1), ("9/7", 2), ("9/7", 3)]
)
def test_polynomials_vanish_beside_edges_of_either_parity(name, order):
    for border in (24, 25):
        t = np.arange(64.0) / 16.0
        signal = np.where(np.arange(64) < border, t**order, 5.0 - (t - 2.0) ** order)
        cuts = np.zeros((64, 1), np.uint8)
        cuts[border - 1] = 1
        _, high = split(signal[:, np.newaxis], name, cuts, order)
        inside = high[4:-4]  # borders of the signal are symmetric
        assert np.abs(inside).max() < 1e-9
        _, standard = split(signal[:, np.newaxis], name)
        assert np.abs(standard[4:-4]).max() > 0.1


def test_what_an_edge_separates_does_not_matter_to_the_other_side():
    rng = np.random.default_rng(2)
    edges = EdgeMaps.none((32, 32))
    edges.between_columns[:, 15] = 1
    plane = rng.normal(size=(32, 32))
    other = plane.copy()
    other[:, 16:] = rng.normal(size=(32, 16))
    first, second = (Transform(2, "9/7", edges, 1).analyse(samples) for samples in (plane, other))
    for one, two in zip(first.details, second.details, strict=True):
        for band, changed in zip(one, two, strict=True):
            half = band.shape[1] // 2
            np.testing.assert_array_equal(band[:, :half], changed[:, :half])
            assert not np.array_equal(band[:, half:], changed[:, half:])


@given(
    st.integers(1, 40), st.integers(1, 40), st.sampled_from(ORDERS), st.sampled_from(sorted(WAVELETS)),
    st.floats(0, 1), st.floats(0, 1) | st.just(1.0), st.integers(0, 2**32),
)  # fmt: skip
def test_the_inverse_is_exact_with_any_edges_inside_any_mask(height, width, order, name, share, keep, seed):
    rng = np.random.default_rng(seed)
    mask = rng.random((height, width)) < keep
    edges = edges_inside(random_edges(rng, mask.shape, share), mask)
    plane = rng.normal(size=mask.shape)
    transform = Transform(5, name, edges, order, mask)
    pyramid, other = transform.analyse(plane), transform.analyse(np.where(mask, plane, 1e6))
    exists = mask_pyramid(mask, 5)
    bands = [(pyramid.low, other.low, exists.low)]
    for one, two, three in zip(pyramid.details, other.details, exists.details, strict=True):
        bands += zip(one, two, three, strict=True)
    for band, same, where in bands:
        np.testing.assert_array_equal(band, same)
        assert not band[where == 0].any()
    assert sum(int(where.sum()) for _, _, where in bands) == mask.sum()
    found = transform.synthesise(pyramid)
    assert np.abs(found - np.where(mask, plane, 0.0)).max() <= 1e-9


def test_wrong_arguments_are_named() -> None:
    edges = EdgeMaps.none((4, 4))
    for shape, maps, message in (
        ((0, 3), None, "`plane`"),
        ((5,), None, "`plane`"),
        ((4, 5), edges, "shape"),
    ):
        with pytest.raises(ValueError, match=message):
            Transform(1, edges=maps).analyse(np.zeros(shape))
    with pytest.raises(ValueError, match="`num_levels`"):
        Transform(-1)
    with pytest.raises(ValueError, match="order"):
        Transform(1, edges=edges, order=4)
