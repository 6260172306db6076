"""View synthesis: a frame predicted from its depth and two key frames, by backward warps and blending.

Every pixel fetches its level from both key frames. A key frame in which the point is outside or hidden has no
weight if the other one sees it.
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from decoder.side_information.block_motion import BLOCK, BlockRefiner
from decoder.side_information.protocol import Interpolation, Prediction
from decoder.side_information.track_interpolation import NEAR, Field, corrected_positions
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
    keys: Sequence[DepthView], camera: Floats, temporal_position: float, frame: PixelFrame
) -> Interpolation:
    """Predict a view from the depth of two key frames."""
    return interpolate(keys, render_depth(keys, camera, frame), camera, temporal_position, frame)


def interpolate(
    keys: Sequence[DepthView], depth: DepthMap, camera: Floats, temporal_position: float, frame: PixelFrame
) -> Interpolation:
    """Predict a view from two key frames and its depth."""
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


def warp_chroma(
    interpolation: Interpolation, chroma: Sequence[tuple[Bytes, Bytes] | None]
) -> tuple[Bytes, Bytes] | None:
    """Predict the chroma planes of a predicted frame."""
    # A chroma sample lies half a pixel right of and below its luma sample, in all three frames alike.
    halved = [np.ascontiguousarray(position[::2, ::2]) / 2.0 for position in interpolation.positions]
    predicted = []
    for component in (0, 1):
        planes = [pair[component] for pair in chroma if pair is not None]
        if len(planes) < len(halved):
            return None
        warped = [sample(plane, position) for plane, position in zip(planes, halved, strict=True)]
        level = warped[0]
        for plane, weight in zip(warped[1:], interpolation.weights[1:], strict=True):
            level = level + weight[::2, ::2] * (plane - warped[0])
        predicted.append(np.floor(level + 0.5).astype(np.uint8))
    return predicted[0], predicted[1]


def block_offsets(interpolation: Interpolation, block: int = BLOCK) -> tuple[Integers, ...]:
    """Return the median displacement of every block, in quarter samples, (vertical, horizontal)."""
    height, width = interpolation.luma.shape
    limit, pixels = 4.0 * max(height, width), np.indices((height, width))
    return tuple(
        np.stack(
            [
                np.floor(
                    4.0 * block_medians(np.clip(position[..., 1 - axis] - pixels[axis], -limit, limit), block)
                    + 0.5
                )
                for axis in (0, 1)
            ],
            axis=-1,
        ).astype(np.int64)
        for position in interpolation.positions
    )


def block_medians(plane: Floats, block: int) -> Floats:
    """Return the median of each block; blocks beyond the frame repeat its last pixels."""
    height, width = plane.shape
    padded = np.pad(plane, ((0, -height % block), (0, -width % block)), mode="edge")
    cells = padded.reshape(padded.shape[0] // block, block, padded.shape[1] // block, block)
    medians: Floats = np.median(cells, axis=(1, 3))
    return medians


def completed(
    prediction: Prediction, rendered: Interpolation, frames: Sequence[Frame], method: str
) -> Prediction:
    """Add the chroma, what refines a prediction, and depth, all by where its pixels come from."""
    return replace(
        prediction,
        chroma=warp_chroma(rendered, [frame.chroma for frame in frames]),
        method=method,
        refiner=BlockRefiner(frames, block_offsets(rendered), method),
        inverse_depth=None if rendered.depth is None else rendered.depth.inverse_depth,
    )


def corrected(
    rendered: Interpolation,
    keys: tuple[Bytes, Bytes],
    tracks: tuple[Floats, Floats, Floats],
    fields: Sequence[Field] = NEAR,
) -> Interpolation:
    """Correct a rendered frame by the residuals of tracks."""
    before, wanted, after = tracks
    luma, compensated, moved = rendered.luma, [], []
    for key, there, positions, weight, old in zip(
        keys, (before, after), rendered.positions, rendered.weights, rendered.compensated, strict=True
    ):
        place = corrected_positions(positions, wanted, there, fields)
        change = sample(key, place) - sample(key, positions)
        luma = luma + weight * change
        compensated.append(np.clip(old + change, 0.0, 255.0))
        moved.append(place)
    return rendered._replace(
        luma=np.clip(luma, 0.0, 255.0), compensated=tuple(compensated), positions=tuple(moved)
    )
