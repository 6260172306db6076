"""View synthesis from depth and two key frames, and weighting of several predictions of one frame.

Every pixel fetches its level from both key frames. A key frame has no weight if the point is outside or
hidden in it and the other one sees it. The result is blended with a prediction by block motion pixel by
pixel, by their consistency.

While the frame is being decoded, all predictions are fused block by block by their errors in the decoded
bands: the errors of predictions from the same references resemble each other. The weights of the best linear
mean therefore follow from the whole matrix of their second moments, not from each error separately.

References
----------
[BatesGranger1969] J. M. Bates, C. W. J. Granger, "The combination of forecasts", Operational Research
Quarterly 20(4), 1969.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import cv2
import numpy as np
from scipy.ndimage import map_coordinates, uniform_filter

from decoder.side_information.block_motion import BLOCK, BlockRefiner, predicted_chroma
from decoder.side_information.protocol import Interpolation, Prediction
from dvc.arrays import Bytes, Floats, Integers, Mask
from dvc.geometry.cameras import PixelFrame
from dvc.geometry.continuation import DepthMap
from dvc.geometry.depth_maps import DepthView
from dvc.geometry.rendering import OCCLUDED_WEIGHT, render_depth, visibility_weights
from dvc.geometry.warping import inverse_warp, sample, warp_grid, warp_matrix
from dvc.video import Frame

SOFTENING = 0.3
"""Share of the 3x3 mean where depth is not reliable: blur costs less there than a sharp misplaced edge."""


def render_between(
    keys: Sequence[DepthView],
    camera: Floats,
    temporal_position: float,
    frame: PixelFrame,
    depth: DepthMap | None = None,
) -> Interpolation:
    """Predict a view from two key frames and its depth, by default that rendered from theirs."""
    depth = depth or render_depth(keys, camera, frame)
    compensated, weights, positions = [], [], []
    for key in keys:
        warped = warp_grid(inverse_warp(warp_matrix(key.camera, camera, frame)), depth.inverse_depth)
        compensated.append(sample(key.luma, warped))
        weights.append(visibility_weights(key, warped))
        positions.append(warped[..., :2])
    blended = blend(compensated, weights, positions, depth.reliable, temporal_position)
    return blended._replace(depth=depth)


def blend(
    compensated: Sequence[Floats],
    visibility: Sequence[Floats],
    positions: Sequence[Floats],
    reliable: Mask,
    temporal_position: float,
) -> Interpolation:
    """Blend both key frames by time and visibility."""
    first = (1.0 - temporal_position) * visibility[0] + 1e-12
    second = temporal_position * visibility[1] + 1e-12
    share = second / (first + second)
    mean = compensated[0] + share * (compensated[1] - compensated[0])
    activity = _box(np.abs(mean - _box(mean, 5)), 5)
    soft = mean + SOFTENING * (_box(mean, 3) - mean)
    luma = np.where(reliable, mean, soft)
    both = np.minimum(*visibility) > OCCLUDED_WEIGHT
    visible = np.maximum(*visibility) > OCCLUDED_WEIGHT
    difference = _box(np.abs(compensated[0] - compensated[1]), 3)
    confident = np.where(both, 1.0 + 0.4 * difference, 1.0 + 0.6 * activity)
    error = np.where(visible, np.where(reliable, confident, 2.0 + 1.0 * activity), 3.0 + 1.5 * activity)
    return Interpolation(luma, tuple(compensated), (1.0 - share, share), tuple(positions), error)


def _box(plane: Floats, side: int) -> Floats:
    return np.asarray(cv2.blur(plane, (side, side), borderType=cv2.BORDER_REPLICATE), dtype=np.float64)


def warp_chroma(interpolation: Interpolation, references: Sequence[Frame]) -> tuple[Bytes, Bytes] | None:
    """Predict the chroma planes of a predicted frame."""
    # A chroma sample lies half a pixel right of and below its luma sample, in all three frames alike.
    halved = [np.ascontiguousarray(position[::2, ::2]) / 2.0 for position in interpolation.positions]

    def _warped(planes: list[Bytes]) -> Floats:
        warped = [sample(plane, position) for plane, position in zip(planes, halved, strict=True)]
        level = warped[0]
        for plane, weight in zip(warped[1:], interpolation.weights[1:], strict=True):
            level = level + weight[::2, ::2] * (plane - warped[0])
        return level

    return predicted_chroma(references, _warped)


def block_offsets(interpolation: Interpolation) -> tuple[Integers, ...]:
    """Return the median displacement of every block, in quarter samples, (vertical, horizontal)."""
    height, width = interpolation.luma.shape
    limit, pixels = 4.0 * max(height, width), np.moveaxis(np.indices((height, width))[::-1], 0, -1)
    offsets = []
    for position in interpolation.positions:
        moved = np.clip(position - pixels, -limit, limit)
        medians = np.stack([block_medians(moved[..., axis], BLOCK) for axis in (1, 0)], axis=-1)
        offsets.append(np.floor(4.0 * medians + 0.5).astype(np.int64))
    return tuple(offsets)


def block_medians(plane: Floats, block: int) -> Floats:
    """Return the median of each block; blocks beyond the frame repeat its last pixels."""
    height, width = plane.shape
    padded = np.pad(plane, ((0, -height % block), (0, -width % block)), mode="edge")
    cells = padded.reshape(padded.shape[0] // block, block, padded.shape[1] // block, block)
    return np.median(cells, axis=(1, 3))


def completed(
    prediction: Prediction, rendered: Interpolation, frames: Sequence[Frame], method: str
) -> Prediction:
    """Add the chroma, what refines a prediction, and depth, all by where its pixels come from."""
    return replace(
        prediction,
        chroma=warp_chroma(rendered, frames),
        method=method,
        refiner=BlockRefiner(frames, block_offsets(rendered), method),
        inverse_depth=None if rendered.depth is None else rendered.depth.inverse_depth,
    )


FUSION_BLOCKS = 5
"""Side of the square of blocks with joint errors."""
RIDGE = 0.3
"""Share of the mean squared error that is added to that of each hypothesis, as an independent error."""
MIN_MOMENT = 0.02
"""Squared error that is added to all, relative to that of the best hypothesis over the frame."""
ROUNDING = 1.0
"""Squared error of a coefficient by rounding."""
CONSISTENCY_WINDOW = 9
"""Side of the neighbourhood for comparing references, in pixels."""
USUAL_DISAGREEMENT = 2.0
"""Squared difference from the scene that block motion may have, in units of its own squared error."""
PATH_UNCERTAINTY = 0.3
"""Deviation of a fast camera from its guessed path, as a share of the motion between the references."""
STEADY_MOTION_PX = 10.0
"""Median motion between the references that halves this share: slow cameras are steady."""
MAX_GUESSED_SHARE = 0.5
"""Largest share of the scene in the prediction if its camera is a guess."""
TRUST = 2.0
"""Ratio of the scene's expected error to that of block motion at equal shares, if tracks give the camera."""
DISAGREEMENT_WEIGHT = 0.25
"""Weight of the distance of aligned block motion from several hypotheses of the scene."""


def fuse(hypotheses: Floats, decoded: Mapping[int, Floats]) -> tuple[Floats, Floats]:
    """Fuse predictions of a frame."""
    count, _, rows, columns = hypotheses.shape
    bands, known = list(decoded), np.stack(list(decoded.values()))
    least = np.abs(hypotheses[:, bands] - known).min(axis=0)
    usual = np.array([float(np.mean(band)) ** 2 + ROUNDING for band in least])
    pairs = [(a, b) for a in range(count) for b in range(a + 1)]
    moments = np.zeros((len(pairs), rows, columns))
    for band, truth, scale in zip(bands, known, usual, strict=True):
        errors = hypotheses[:, band] - truth
        for number, (a, b) in enumerate(pairs):
            moments[number] += errors[a] * errors[b] / scale
    local = uniform_filter(moments / len(decoded), (1, FUSION_BLOCKS, FUSION_BLOCKS), mode="nearest")
    weights = fusion_weights(dict(zip(pairs, local, strict=True)), count)
    mean: Floats = sum(weight * hypothesis for weight, hypothesis in zip(weights, hypotheses, strict=True))
    squares = (
        weight * (hypothesis - mean) ** 2 for weight, hypothesis in zip(weights, hypotheses, strict=True)
    )
    return mean, np.sqrt(sum(squares))


def fusion_weights(moments: Mapping[tuple[int, int], Floats], count: int) -> Floats:
    """Return the weights of the best mean of each block, from moments of errors `a` with errors `b <= a`."""
    matrix = [[moments[max(a, b), min(a, b)].copy() for b in range(count)] for a in range(count)]
    trace = sum((matrix[a][a] for a in range(1, count)), matrix[0][0].copy())
    weights = np.ones((count, *trace.shape))
    for a in range(count):
        matrix[a][a] += RIDGE * trace / count + MIN_MOMENT
    for a in range(count):  # Gaussian elimination
        for c in range(a + 1, count):
            factor = matrix[c][a] / matrix[a][a]
            for b in range(a, count):
                matrix[c][b] -= factor * matrix[a][b]
            weights[c] -= factor * weights[a]
    for a in reversed(range(count)):
        for b in range(a + 1, count):
            weights[a] -= matrix[a][b] * weights[b]
        weights[a] /= matrix[a][a]
    weights = np.maximum(weights, 0.0)
    return np.asarray(weights / sum(weights[1:], weights[0]))


def blend_guessed(block_motion: Prediction, rendered: Interpolation, temporal_position: float) -> Prediction:
    """Blend block motion with a scene if the camera is a guess."""
    share = scene_share(block_motion, rendered, bound=MAX_GUESSED_SHARE)
    return replace(
        block_motion,
        luma=share * hedged(rendered, temporal_position) + (1.0 - share) * block_motion.luma,
        compensated=_shared(share, rendered, block_motion),
        expected_error=rendered.expected_error,
        alternatives=(block_motion.luma, *rendered.hypotheses) if rendered.hypotheses else (),
    )


def blend_tracked(block_motion: Prediction, rendered: Interpolation) -> Prediction:
    """Blend a prediction from tracks with a scene from their cameras, by their expected errors."""
    share = scene_share(
        block_motion, rendered, TRUST, disagreement_weight=DISAGREEMENT_WEIGHT if rendered.hypotheses else 0.0
    )
    ours, theirs = neighbourhood(rendered.expected_error), inconsistency(block_motion)
    return replace(
        block_motion,
        luma=share * rendered.luma + (1.0 - share) * block_motion.luma,
        compensated=_shared(share, rendered, block_motion),
        expected_error=share * ours + (1.0 - share) * theirs,
        alternatives=(block_motion.luma, *rendered.hypotheses),
    )


def hedged(rendered: Interpolation, temporal_position: float) -> Floats:
    """Average a prediction along its motion, because the position of the camera is a guess."""
    motion = rendered.positions[1] - rendered.positions[0]
    speed_px = float(np.median(np.hypot(motion[..., 0], motion[..., 1])))
    between = np.sqrt(4.0 * temporal_position * (1.0 - temporal_position))
    share = PATH_UNCERTAINTY * speed_px / (speed_px + STEADY_MOTION_PX) * between
    rows, columns = np.indices(rendered.luma.shape)
    total = rendered.luma.copy()
    for step in (-share, share):
        at = (rows + step * motion[..., 1], columns + step * motion[..., 0])
        total += map_coordinates(rendered.luma, at, order=1, mode="nearest")
    return np.asarray(total / 3.0)


def neighbourhood(plane: Floats) -> Floats:
    """Average a plane over the neighbourhood for comparing references."""
    return np.asarray(uniform_filter(plane, CONSISTENCY_WINDOW, mode="nearest"))


def inconsistency(block_motion: Prediction) -> Floats:
    """Return the difference of the references of a prediction by block motion."""
    return neighbourhood(np.abs(block_motion.compensated[0] - block_motion.compensated[1])) + 1.0


def scene_share(
    block_motion: Prediction,
    rendered: Interpolation,
    trust: float = 1.0,
    bound: float = 1.0,
    disagreement_weight: float = 0.0,
) -> Floats:
    """Weigh the scene's prediction against that of block motion, pixel by pixel."""
    theirs, ours = inconsistency(block_motion), neighbourhood(rendered.expected_error)
    weight = theirs**2 * trust**2
    if disagreement_weight > 0.0:
        distance = neighbourhood((rendered.luma - block_motion.luma) ** 2)
        weight = weight + disagreement_weight * np.maximum(distance - USUAL_DISAGREEMENT * weight, 0.0)
    floor = np.sqrt(weight * (1.0 / bound - 1.0))
    return np.asarray(weight / (weight + np.maximum(ours, floor) ** 2))


def _shared(share: Floats, rendered: Interpolation, block_motion: Prediction) -> tuple[Floats, ...]:
    """Blend the compensated references of the scene with those of block motion."""
    limit = 2.0 * rendered.expected_error
    return tuple(
        share * (rendered.luma + np.clip(ours - rendered.luma, -limit, limit)) + (1.0 - share) * theirs
        for ours, theirs in zip(rendered.compensated, block_motion.compensated, strict=True)
    )
