"""Prediction of a frame from the surfaces of both key frames: depth there, which key sees it, and blending.

The surfaces are drawn into the wanted view with depth order, reliable parts first; what no surface reaches
takes the depth behind it. Every pixel then fetches its level from both key frames (a backward warp). A key
that does not see the point, outside the frame or behind something, has no say where the other one does.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from decoder.side_information import _kernels_3d
from decoder.side_information.plane_sweep import DepthMap
from decoder.side_information.surfaces import OUTSIDE, RELIABLE, KeySurface
from decoder.side_information.trifocal import inverse_transfer, transfer_matrix, transfer_surface
from sfm.model import PixelFrame

Floats = NDArray[np.float64]
Luma = NDArray[np.uint8]
Mask = NDArray[np.bool_]

PIECE = 0.5
"""How far each pixel beside a tear extends, in pixels."""
SOFTENING = 0.3
"""Share of the 3x3 mean where depth is uncertain: blur costs less there than a sharp misplaced edge."""
SIGHT_TOLERANCE_PX = 1.0
"""Largest parallax between a point and the surface that a key shows there, if it sees the point."""
HALO_PX = 1
"""Pixels beside something nearer mix both, and are avoided."""


class Interpolation(NamedTuple):
    """A predicted frame.

    Attributes
    ----------
    luma : ndarray of shape (H, W), float64
        Prediction.
    compensated : tuple of ndarray of shape (H, W), float64
        What each key frame says, whether it sees the point or not.
    weights : tuple of ndarray of shape (H, W), float64
        Share of each key frame in the prediction; they sum to 1.
    positions : tuple of ndarray of shape (H, W, 2), float64
        Where each pixel lies in each key frame, (x, y) in pixels; may be outside.
    expected_error : ndarray of shape (H, W), float64
        Expected absolute error, in luma levels.
    hypotheses : tuple of ndarray of shape (H, W), float64
        The predictions that it was fused from; none where there was only one.
    """

    luma: Floats
    compensated: tuple[Floats, ...]
    weights: tuple[Floats, ...]
    positions: tuple[Floats, ...]
    expected_error: Floats
    hypotheses: tuple[Floats, ...] = ()


def render_view(surfaces: Sequence[KeySurface], camera: Floats, frame: PixelFrame) -> DepthMap:
    """Draw the surfaces of the key frames into another view.

    Parameters
    ----------
    surfaces : sequence of KeySurface
        What the key frames show.
    camera : ndarray of shape (3, 4), float64
        Wanted view, in normalised coordinates.
    frame : PixelFrame
        Size of the images.

    Returns
    -------
    DepthMap
        Depth without holes.
    """
    reliable = np.full((frame.height_px, frame.width_px), _kernels_3d.EMPTY)
    rest = reliable.copy()
    for surface in surfaces:
        transfer = transfer_matrix(surface.camera, camera, frame)
        vertices = transfer_surface(transfer, surface.inverse_depth)
        doubtful = _cells(surface.state != RELIABLE)
        for buffer, chosen in ((reliable, ~doubtful), (rest, doubtful)):
            _kernels_3d.rasterise(vertices, surface.torn | ~chosen, buffer)
            _kernels_3d.rasterise_torn(transfer, surface.inverse_depth, surface.torn & chosen, PIECE, buffer)
    drawn = reliable > _kernels_3d.EMPTY
    return DepthMap(fill_holes(np.where(drawn, reliable, rest)), drawn)


def _cells(points: Mask) -> Mask:
    """Cells with at least one of their four corners in a set."""
    cells: Mask = points[:-1, :-1] | points[:-1, 1:] | points[1:, :-1] | points[1:, 1:]
    return cells


def fill_holes(inverse_depth: Floats) -> Floats:
    """Give what nothing was drawn on the depth of what is around and behind it.

    Parameters
    ----------
    inverse_depth : ndarray of shape (H, W), float64
        `_kernels_3d.EMPTY` in holes.

    Returns
    -------
    ndarray of shape (H, W), float64
        The same without holes; 0 if there is nothing at all.
    """
    empty = inverse_depth <= _kernels_3d.EMPTY
    if empty.all():
        return np.zeros_like(inverse_depth)
    if not empty.any():
        return inverse_depth
    filled = inverse_depth
    nowhere = np.full(empty.shape, OUTSIDE, np.int8)
    # what no ray reaches in eight directions is reached from what has been filled
    while empty.any():
        state = np.where(empty, OUTSIDE, RELIABLE).astype(np.int8)
        flat, slopes, none = np.zeros(empty.shape), np.zeros((*empty.shape, 2)), np.zeros((3, 4))
        source, filled = filled, np.empty(empty.shape)
        _kernels_3d.fill_surface(
            source, state, flat, slopes, 1.0, 0.0, np.full(3, 0.0), source, nowhere, none, none, 0.0, filled
        )
        empty = filled <= _kernels_3d.EMPTY
    return filled


def interpolate(
    surfaces: Sequence[KeySurface], view: DepthMap, camera: Floats, late: float, frame: PixelFrame
) -> Interpolation:
    """Predict a view from two key frames and its depth.

    Parameters
    ----------
    surfaces : sequence of two KeySurface
        Key frames, with what they see.
    view : DepthMap
        Depth of the wanted view.
    camera : ndarray of shape (3, 4), float64
        Its camera, in normalised coordinates.
    late : float
        Instant between the first key frame (0) and the second (1).
    frame : PixelFrame
        Size of the images.

    Returns
    -------
    Interpolation
        The predicted frame.
    """
    compensated, sights, positions = [], [], []
    for surface in surfaces:
        transfer = inverse_transfer(transfer_matrix(surface.camera, camera, frame))
        moved = transfer_surface(transfer, view.inverse_depth)
        compensated.append(sample(surface.luma, moved))
        sight = np.empty(view.inverse_depth.shape)
        _kernels_3d.see(
            moved,
            surface.inverse_depth,
            surface.state,
            surface.to_other,
            HALO_PX,
            SIGHT_TOLERANCE_PX,
            sight,
        )
        sights.append(sight)
        positions.append(moved[..., :2])
    return blend(compensated, sights, positions, view.reliable, late)


def sample(plane: Luma, positions: Floats) -> Floats:
    """Interpolate a plane by cubic convolution of fourth order (six points); the border repeats.

    Parameters
    ----------
    plane : ndarray of shape (H, W), uint8
        Samples.
    positions : ndarray of shape (rows, columns, 2 or more), float64
        x and y, then anything.

    Returns
    -------
    ndarray of shape (rows, columns), float64
        Interpolated samples.

    References
    ----------
    [Keys1981] R. Keys, "Cubic convolution interpolation for digital image processing", IEEE Trans. Acoust.,
    Speech, Signal Process. 29(6), 1981.
    """
    samples = np.empty(positions.shape[:2])
    _kernels_3d.sample_image(plane, positions, samples)
    return np.clip(samples, 0.0, 255.0)


def blend(
    compensated: Sequence[Floats],
    sights: Sequence[Floats],
    positions: Sequence[Floats],
    reliable: Mask,
    late: float,
) -> Interpolation:
    """Blend what the key frames say, by time and by what they see.

    Parameters
    ----------
    compensated : sequence of two ndarray of shape (H, W), float64
        Warped key frames.
    sights : sequence of two ndarray of shape (H, W), float64
        Positive trust in each.
    positions : sequence of two ndarray of shape (H, W, 2), float64
        Where each pixel lies in each key frame.
    reliable : ndarray of shape (H, W), bool
        Where the depth is certain.
    late : float
        Instant between the first key frame (0) and the second (1).

    Returns
    -------
    Interpolation
        The predicted frame.
    """
    early_mass, late_mass = (1.0 - late) * sights[0] + 1e-12, late * sights[1] + 1e-12
    share = late_mass / (early_mass + late_mass)
    mean = compensated[0] + share * (compensated[1] - compensated[0])
    activity = _box(np.abs(mean - _box(mean, 5)), 5)
    soft = mean + SOFTENING * (_box(mean, 3) - mean)
    luma = np.where(reliable, mean, soft)
    both = np.minimum(*sights) > _kernels_3d.HIDDEN
    seen = np.maximum(*sights) > _kernels_3d.HIDDEN
    difference = _box(np.abs(compensated[0] - compensated[1]), 3)
    certain = np.where(both, 1.0 + 0.4 * difference, 1.0 + 0.6 * activity)
    error = np.where(seen, np.where(reliable, certain, 2.0 + 1.0 * activity), 3.0 + 1.5 * activity)
    return Interpolation(luma, tuple(compensated), (1.0 - share, share), tuple(positions), error)


def _box(plane: Floats, side: int) -> Floats:
    return np.asarray(cv2.blur(plane, (side, side), borderType=cv2.BORDER_REPLICATE), dtype=np.float64)


def warp_chroma(
    interpolation: Interpolation, chroma: Sequence[tuple[Luma, Luma] | None]
) -> tuple[Luma, Luma] | None:
    """Predict the chroma planes of a predicted frame.

    Parameters
    ----------
    interpolation : Interpolation
        What `interpolate` returned.
    chroma : sequence of two (tuple of two ndarray of shape (ceil(H / 2), ceil(W / 2)), uint8, or None)
        Cb and Cr of each key frame.

    Returns
    -------
    tuple of two ndarray of shape (ceil(H / 2), ceil(W / 2)), uint8, or None
        Predicted Cb and Cr; None if a key frame has no chroma.
    """
    # A chroma sample lies half a pixel right of and below its luma sample, in all three frames alike.
    halved = [np.ascontiguousarray(position[::2, ::2]) / 2.0 for position in interpolation.positions]
    predicted = []
    for component in (0, 1):
        planes = [pair[component] for pair in chroma if pair is not None]
        if len(planes) < len(halved):
            return None
        warped = [sample(plane, position) for plane, position in zip(planes, halved, strict=True)]
        share = interpolation.weights[1][::2, ::2]
        predicted.append(np.floor(warped[0] + share * (warped[1] - warped[0]) + 0.5).astype(np.uint8))
    return predicted[0], predicted[1]


def block_offsets(interpolation: Interpolation, block: int = 4) -> tuple[NDArray[np.int64], ...]:
    """Summarise the positions as block offsets, for methods that refine by blocks.

    Parameters
    ----------
    interpolation : Interpolation
        What `interpolate` returned.
    block : int
        Side of the blocks.

    Returns
    -------
    tuple of ndarray of shape (ceil(H / block), ceil(W / block), 2), int64
        Per key frame, where each block lies in it: (vertical, horizontal) in quarter samples.
    """
    return tuple(_offsets(position, block) for position in interpolation.positions)


def _offsets(position: Floats, block: int) -> NDArray[np.int64]:
    height, width = position.shape[:2]
    rows, columns = np.indices((height, width))
    limit = 4.0 * max(height, width)
    motion = np.clip(np.stack([position[..., 1] - rows, position[..., 0] - columns], axis=-1), -limit, limit)
    spare = ((0, -height % block), (0, -width % block), (0, 0))
    padded = np.pad(motion, spare, mode="edge")
    cells = padded.reshape(padded.shape[0] // block, block, padded.shape[1] // block, block, 2)
    return np.floor(4.0 * np.median(cells, axis=(1, 3)) + 0.5).astype(np.int64)
