"""Blending and weighting of predictions: fusion against a plain solution, hedging, share of the scene."""

import numpy as np
import pytest
from numpy.typing import NDArray

from decoder.side_information.protocol import Interpolation, Prediction
from decoder.side_information.synthesis import (
    MAX_GUESSED_SHARE,
    blend,
    block_offsets,
    fuse,
    fusion_weights,
    hedged,
    scene_share,
    warp_chroma,
)
from dvc.video import Frame


def _moments(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    errors = rng.normal(0.0, 3.0, (count, 12, 2, 3)) + rng.normal(0.0, 5.0, (12, 2, 3))
    return np.asarray(np.einsum("anij,bnij->abij", errors, errors) / 12.0)


@pytest.mark.parametrize("count", [1, 2, 5])
def test_weights_solve_the_system_of_second_moments(count: int) -> None:
    moments = _moments(np.random.default_rng(count), count)
    expected = np.empty((count, 2, 3))
    for i, j in np.ndindex(2, 3):
        matrix = moments[:, :, i, j]
        ridge = 0.3 * np.trace(matrix) / count + 0.02
        solved = np.maximum(np.linalg.solve(matrix + ridge * np.eye(count), np.ones(count)), 0.0)
        expected[:, i, j] = solved / solved.sum()
    pairs = zip(*np.tril_indices(count), strict=True)
    weights = fusion_weights({pair: moments[pair] for pair in pairs}, count)
    np.testing.assert_allclose(weights, expected, rtol=1e-10)


def test_weights_exist_if_no_hypothesis_errs() -> None:
    pairs = zip(*np.tril_indices(4), strict=True)
    np.testing.assert_allclose(fusion_weights(dict.fromkeys(pairs, np.zeros((1, 1))), 4), 0.25)


def test_mean_and_spread_follow_from_the_weights() -> None:
    rng = np.random.default_rng(3)
    hypotheses = rng.normal(0.0, 9.0, (3, 5, 6, 7))
    fused, spread = fuse(hypotheses, {0: rng.normal(0.0, 9.0, (6, 7)), 3: rng.normal(0.0, 9.0, (6, 7))})
    assert ((fused >= hypotheses.min(axis=0)) & (fused <= hypotheses.max(axis=0))).all()
    assert (spread <= np.ptp(hypotheses, axis=0)).all()
    squares = np.stack([hypotheses, hypotheses**2, np.ones_like(hypotheses)])
    weights = np.linalg.lstsq(hypotheses[:, :, 2, 3].T, fused[:, 2, 3], rcond=None)[0]
    mean, square, total = np.einsum("n,snb->sb", weights, squares[..., 2, 3])
    np.testing.assert_allclose(total, 1.0)
    np.testing.assert_allclose(spread[:, 2, 3], np.sqrt(square - mean**2))


def test_fused_prediction_follows_the_better_hypothesis_in_each_region() -> None:
    rng = np.random.default_rng(7)
    truth = rng.normal(0.0, 40.0, (16, 20, 20))
    hypotheses = np.stack([truth, truth])
    hypotheses[0, :, :, :10] += rng.normal(0.0, 20.0, (16, 20, 10))
    hypotheses[1, :, :, 10:] += rng.normal(0.0, 20.0, (16, 20, 10))
    fused, spread = fuse(hypotheses, {0: truth[0], 1: truth[1]})
    error = np.abs(fused - truth)[2:]
    assert error[:, :, :7].mean() < 4.0
    assert error[:, :, 13:].mean() < 4.0
    assert spread.shape == truth.shape
    assert np.all(spread >= 0.0)


def test_independent_errors_average_out() -> None:
    rng = np.random.default_rng(8)
    truth = rng.normal(0.0, 40.0, (16, 20, 20))
    hypotheses = truth + rng.normal(0.0, 10.0, (4, 16, 20, 20))
    fused, spread = fuse(hypotheses, {0: truth[0]})
    assert np.std(fused[1:] - truth[1:]) < 6.0
    assert 5.0 < spread[1:].mean() < 10.0


def test_equal_hypotheses_stay_as_they_are() -> None:
    bands = np.random.default_rng(9).normal(0.0, 40.0, (16, 5, 6))
    fused, spread = fuse(np.stack([bands] * 3), {0: bands[0] + 3.0})
    np.testing.assert_allclose(fused, bands, atol=1e-9)
    np.testing.assert_allclose(spread, 0.0, atol=1e-6)


def interpolation(motion_px: float) -> Interpolation:
    """Return a prediction of a ramp that moves to the right."""
    rows, columns = np.indices((20, 30)).astype(np.float64)
    in_first = np.stack([columns, rows], axis=-1)
    in_second = in_first + np.array([motion_px, 0.0])
    luma = 4.0 * columns + np.where(rows > 9, 30.0, 0.0)
    half = np.full(luma.shape, 0.5)
    return Interpolation(luma, (luma, luma), (half, half), (in_first, in_second), np.ones(luma.shape))


def test_hedging_blurs_along_the_motion_only() -> None:
    """A ramp stays but at its ends, an edge along the motion stays sharp; nothing changes at the keys."""
    rendered = interpolation(20.0)
    mean = hedged(rendered, 0.5)
    np.testing.assert_allclose(mean[:, 6:-6], rendered.luma[:, 6:-6], atol=1e-9)
    assert not np.allclose(mean[:, 0], rendered.luma[:, 0])
    np.testing.assert_allclose(hedged(rendered, 0.0), rendered.luma)
    np.testing.assert_allclose(hedged(interpolation(0.0), 0.5), interpolation(0.0).luma)


def test_the_scene_has_half_a_say_where_it_is_consistent() -> None:
    """The scene's share is one half where it expects little, and falls where it expects much."""
    rendered = interpolation(1.0)
    zeros = np.zeros(rendered.luma.shape)
    block_motion = Prediction(rendered.luma, None, (zeros, zeros + 3.0), "mci")
    np.testing.assert_allclose(scene_share(block_motion, rendered, bound=MAX_GUESSED_SHARE), 0.5)
    doubtful = rendered._replace(expected_error=np.full(zeros.shape, 40.0))
    assert scene_share(block_motion, doubtful, bound=MAX_GUESSED_SHARE).max() < 0.02


@pytest.mark.parametrize("bound", [0.5, 0.8, 1.0])
def test_the_share_of_the_scene_is_bounded(bound: float) -> None:
    rendered = interpolation(1.0)
    zeros = np.zeros(rendered.luma.shape)
    block_motion = Prediction(rendered.luma, None, (zeros, zeros + 50.0), "mci")
    sure = rendered._replace(expected_error=zeros)
    np.testing.assert_allclose(scene_share(block_motion, sure, bound=bound), bound)


def test_block_motion_is_doubted_where_it_is_far_from_the_scene() -> None:
    rendered = interpolation(1.0)
    for offset, doubted in ((1.0, False), (60.0, True)):
        luma = rendered.luma + offset
        block_motion = Prediction(luma, None, (luma, luma), "mci")
        plain, weighed = (
            scene_share(block_motion, rendered, disagreement_weight=weight) for weight in (0.0, 0.25)
        )
        assert (weighed > plain + 0.4).all() if doubted else np.array_equal(weighed, plain)


def test_a_key_that_does_not_see_has_no_say() -> None:
    """Blending follows time where both key frames see a point, and visibility where one does."""
    planes = [np.full((4, 6), 10.0), np.full((4, 6), 90.0)]
    visibility = [np.ones((4, 6)), np.ones((4, 6))]
    visibility[1][:, 3:] = 1e-4
    positions = [np.zeros((4, 6, 2))] * 2
    luma = blend(planes, visibility, positions, np.ones((4, 6), bool), 0.25).luma
    np.testing.assert_allclose(luma[:, :3], 30.0)
    np.testing.assert_allclose(luma[:, 3:], 10.0, atol=0.01)


def test_chroma_and_offsets_follow_the_positions() -> None:
    rows, columns = np.indices((14, 18)).astype(np.float64)
    positions = (np.stack([columns + 2, rows - 4], -1), np.stack([columns, rows], -1))
    weights = (np.ones((14, 18)), np.zeros((14, 18)))
    luma = np.zeros((14, 18))
    moved = Interpolation(luma, (luma, luma), weights, positions, luma)
    chroma = np.random.default_rng(0).integers(0, 256, (7, 9)).astype(np.uint8)
    frame = Frame(luma.astype(np.uint8), (chroma, chroma))
    predicted = warp_chroma(moved, [frame, frame])
    assert predicted is not None
    np.testing.assert_array_equal(predicted[0][3:, :-2], chroma[1:-2, 1:-1])
    assert warp_chroma(moved, [frame, frame.without_chroma()]) is None


def test_block_offsets() -> None:
    motion = np.random.default_rng(3).uniform(-9.0, 9.0, (10, 14, 2))
    positions = np.stack(np.mgrid[:10, :14][::-1], axis=-1) + motion
    plane = np.zeros((10, 14))
    (offsets,) = block_offsets(Interpolation(plane, (plane,), (plane,), (positions,), plane))
    cells = np.pad(motion[..., ::-1], ((0, 2), (0, 2), (0, 0)), mode="edge").reshape(3, 4, 4, 4, 2)
    np.testing.assert_array_equal(offsets, np.floor(4.0 * np.median(cells, axis=(1, 3)) + 0.5))
