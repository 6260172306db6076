"""The shape-adaptive transform: a plain twin, exact inverses, and vanishing moments beside edges."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.images.edge_maps import EdgeMaps, edges_inside
from dvc.images.lifting import MAX_ORDER, WAVELETS, Transform, mask_pyramid
from tests.images.columns import split
from tests.reference import lifting

ORDERS = range(MAX_ORDER + 1)


def random_edges(rng, shape, share):
    below, right = ((rng.random(shape) < share).astype(np.uint8) for _ in range(2))
    below[-1], right[:, -1] = 0, 0
    return EdgeMaps(below, right)


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


@given(
    st.integers(1, 40), st.integers(1, 40), st.sampled_from(ORDERS), st.sampled_from(sorted(WAVELETS)),
    st.floats(0, 1), st.integers(0, 2**32),
)  # fmt: skip
def test_the_inverse_is_exact_with_any_edges(height, width, order, name, share, seed):
    rng = np.random.default_rng(seed)
    plane = rng.normal(size=(height, width))
    edges = random_edges(rng, plane.shape, share)
    transform = Transform(5, name, edges, order)
    assert np.abs(transform.synthesise(transform.analyse(plane)) - plane).max() <= 1e-9


@pytest.mark.parametrize("name", WAVELETS)
@pytest.mark.parametrize("order", ORDERS)
def test_without_edges_it_is_the_standard_transform_to_the_last_bit(name, order):
    plane = np.random.default_rng(1).normal(size=(37, 50))
    found = Transform(5, name, None, order).analyse(plane)
    wanted = lifting.analyse(plane, 5, name)
    np.testing.assert_array_equal(found.low, wanted.low)
    for one, other in zip(found.details, wanted.details, strict=True):
        for band, expected in zip(one.bands, other.bands, strict=True):
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
        for band, changed in zip(one.bands, two.bands, strict=True):
            half = band.shape[1] // 2
            np.testing.assert_array_equal(band[:, :half], changed[:, :half])
            assert not np.array_equal(band[:, half:], changed[:, half:])


@given(
    st.integers(1, 40), st.integers(1, 40), st.sampled_from(ORDERS), st.sampled_from(sorted(WAVELETS)),
    st.floats(0, 1), st.floats(0, 1), st.integers(0, 2**32),
)  # fmt: skip
def test_the_inverse_is_exact_inside_any_mask(height, width, order, name, share, keep, seed):
    rng = np.random.default_rng(seed)
    mask = rng.random((height, width)) < keep
    edges = edges_inside(random_edges(rng, mask.shape, share), mask)
    plane = rng.normal(size=mask.shape)
    transform = Transform(5, name, edges, order, mask)
    pyramid, other = transform.analyse(plane), transform.analyse(np.where(mask, plane, 1e6))
    exists = mask_pyramid(mask, 5)
    bands = [(pyramid.low, other.low, exists.low)]
    for one, two, three in zip(pyramid.details, other.details, exists.details, strict=True):
        bands += zip(one.bands, two.bands, three.bands, strict=True)
    for band, same, where in bands:
        np.testing.assert_array_equal(band, same)
        assert not band[where == 0].any()
    assert sum(int(where.sum()) for _, _, where in bands) == mask.sum()
    found = transform.synthesise(pyramid)
    assert np.abs(found - np.where(mask, plane, 0.0)).max() <= 1e-9


def test_wrong_arguments_are_refused():
    edges = EdgeMaps.none((4, 4))
    with pytest.raises(ValueError, match="shape"):
        Transform(1, edges=edges).analyse(np.zeros((4, 5)))
    with pytest.raises(ValueError, match="order"):
        Transform(1, edges=edges, order=4)
