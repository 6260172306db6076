"""Epipolar block matching: blocks of the wanted frame, each with a depth searched along its epipolar lines.

A candidate depth puts a block into both key frames by trifocal transfer, and the two are compared. The search
covers all depths of the scene, pays for leaving its start, is kept smooth by semi-global matching on the
lattice of blocks, and ends with a golden section, except where depth does not move the block. It starts from
the nearest correspondence, or from the surfaces that the key frames show, which also tell what is hidden:
blocks that one key frame does not see have nothing to compare and keep their start.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from decoder.side_information import _kernels_3d
from decoder.side_information.plane_sweep import (
    DepthMap,
    LabelRange,
    SweepSettings,
    choose_labels,
    label_range,
    luma_features,
)
from decoder.side_information.rendering import Interpolation, interpolate, render_view
from decoder.side_information.surfaces import (
    OUTSIDE,
    RELIABLE,
    KeySurface,
    SurfaceSettings,
    estimate_surfaces,
    tear,
)
from decoder.side_information.trifocal import transfer_matrix, transfer_surface
from sfm.model import Model

Floats = NDArray[np.float64]
Luma = NDArray[np.uint8]

GOLDEN_STEPS = 6
"""Each leaves 0.618 of the interval."""
LEAST_PARALLAX_PX = 0.05
"""A block that a search over two labels moves by less keeps its depth."""


@dataclass(frozen=True)
class BlockSettings:
    """How blocks are matched.

    Attributes
    ----------
    block_px : int
        Side of the blocks.
    spacing_px : float
        Distance of the 4x4 samples of a block's window in the full search.
    window_radius_px : int
        Radius of the window of the golden section.
    start_weight : float
        Cost per label of leaving the depth of the nearest correspondence.
    start_limit : float
        Largest such cost.
    tear_px : float
        Neighbouring pixels whose motions differ by more belong to different surfaces.
    dense_start : bool
        Start from the surfaces of the key frames, not from the nearest correspondences.
    surfaces : SurfaceSettings
        How those are made.
    sweep : SweepSettings
        Labels, costs, and smoothness.
    """

    block_px: int = 4
    spacing_px: float = 2.0
    window_radius_px: int = 3
    start_weight: float = 4.0
    start_limit: float = 40.0
    tear_px: float = 1.5
    dense_start: bool = True
    surfaces: SurfaceSettings = field(default_factory=SurfaceSettings)
    sweep: SweepSettings = field(
        default_factory=lambda: SweepSettings(label_step_px=0.8, max_labels=96, small_jump=10, large_jump=100)
    )


class BlockInterpolator:
    """Predicts frames between two key frames by epipolar blocks.

    Parameters
    ----------
    model : Model
        Cameras of the key frames, and correspondences.
    first, second : ndarray of shape (H, W), uint8
        Luma of the key frames.
    settings : BlockSettings
        Sizes, costs and weights.
    surfaces : tuple of two KeySurface, optional
        What both key frames show, to start from; estimated if None and the settings ask for them.
    """

    def __init__(
        self,
        model: Model,
        first: Luma,
        second: Luma,
        settings: BlockSettings,
        surfaces: tuple[KeySurface, KeySurface] | None = None,
    ) -> None:
        self._model, self._settings = model, settings
        self._keys = (first, second)
        self._cameras = (model.first_camera, model.second_camera)
        if surfaces is None and settings.dense_start:
            surfaces = estimate_surfaces(model, first, second, settings.surfaces)
        self._surfaces = surfaces
        self._features = [luma_features(key, settings.sweep.gradient_weight) for key in self._keys]

    @property
    def surfaces(self) -> tuple[KeySurface, KeySurface] | None:
        """What both key frames show; None if the blocks start from correspondences."""
        return self._surfaces

    def interpolate(self, camera: Floats, late: float) -> Interpolation:
        """Predict one frame.

        Parameters
        ----------
        camera : ndarray of shape (3, 4), float64
            Its camera, in normalised coordinates.
        late : float
            Instant between the first key frame (0) and the second (1).

        Returns
        -------
        Interpolation
            The predicted frame.
        """
        frame, shape = self._model.pixel_frame, self._keys[0].shape
        rendered = render_view(self._surfaces, camera, frame) if self._surfaces else None
        depth = spread_blocks(self.block_depths(camera, rendered), self._settings.block_px, shape)
        view = DepthMap(depth, rendered.reliable if rendered else np.ones(shape, dtype=bool))
        surfaces = self._surfaces or self._key_surfaces(view, camera)
        return interpolate(surfaces, view, camera, late, frame)

    def block_depths(self, camera: Floats, rendered: DepthMap | None = None) -> Floats:
        """Search the depth of every block of a view.

        Parameters
        ----------
        camera : ndarray of shape (3, 4), float64
            The view, in normalised coordinates.
        rendered : DepthMap, optional
            Depth of the view to start from; that of the nearest correspondences if None.

        Returns
        -------
        ndarray of shape (ceil(H / block), ceil(W / block)), float64
            Inverse depth in the view.
        """
        settings, frame = self._settings, self._model.pixel_frame
        to_keys = [transfer_matrix(camera, key, frame) for key in self._cameras]
        _, known = self._known_points(camera)
        reference = self._reference_key(camera)
        labels = label_range(known, to_keys[reference], self._keys[0].shape, settings.sweep)
        rows, columns = (-(-side // settings.block_px) for side in self._keys[0].shape)
        cost = np.empty((rows, columns, labels.num_labels), np.int16)
        sweep = settings.sweep
        limits = np.array([sweep.level_limit, sweep.gradient_limit, sweep.gradient_limit], np.float32)
        _kernels_3d.block_cost(
            self._features[0],
            self._features[1],
            to_keys[0],
            to_keys[1],
            labels.lowest,
            labels.step,
            settings.block_px,
            settings.spacing_px,
            limits,
            sweep.unseen_cost,
            cost,
        )
        start, seen = self._start(camera, rendered)
        cost[~seen] = 0
        cost += self._start_cost(start, labels)
        chosen, _ = choose_labels(cost, np.zeros((rows, columns), np.uint8), sweep)
        depth = labels.lowest + labels.step * chosen
        refined = depth.copy()
        _kernels_3d.golden_search(
            self._features[0][0],
            self._features[1][0],
            to_keys[0],
            to_keys[1],
            settings.block_px,
            settings.window_radius_px,
            labels.step,
            LEAST_PARALLAX_PX,
            GOLDEN_STEPS,
            refined,
        )
        return np.where(seen, refined, depth)

    def _start(self, camera: Floats, rendered: DepthMap | None) -> tuple[Floats, NDArray[np.bool_]]:
        """Inverse depth where each block starts, and whether both key frames see the block."""
        block = self._settings.block_px
        if rendered is not None:
            seen = _block_medians(rendered.reliable.astype(np.float64), block) >= 0.5
            return _block_medians(rendered.inverse_depth, block), seen
        rows, columns = (-(-side // block) for side in self._keys[0].shape)
        start = _nearest(*self._known_points(camera), block, (rows, columns))
        return start, np.ones((rows, columns), dtype=bool)

    def _known_points(self, camera: Floats) -> tuple[Floats, Floats]:
        """Correspondences in the wanted view: image points and inverse depths."""
        model = self._model
        usable = np.isfinite(model.depths) & (model.depths > 0)
        to_view = transfer_matrix(model.first_camera, camera, model.pixel_frame)
        first = np.column_stack([model.correspondences.first, np.ones(len(model.depths))])[usable]
        inverse_depth = 1.0 / model.depths[usable]
        image = np.column_stack([first, inverse_depth]) @ to_view.T
        before = image[:, 2] > 1e-6
        depth = image[before, 2]
        return image[before, :2] / depth[:, None], inverse_depth[before] / depth

    def _reference_key(self, camera: Floats) -> int:
        """Return the key frame whose centre is farther from the wanted one: it moves most."""
        to_keys = [transfer_matrix(camera, key, self._model.pixel_frame) for key in self._cameras]
        distances = [np.linalg.norm(t[:, 3]) / np.linalg.norm(t[:, :3]) for t in to_keys]
        return int(distances[1] > distances[0])

    def _start_cost(self, start: Floats, labels: LabelRange) -> NDArray[np.int16]:
        """Cost of leaving where a block starts, per block and label."""
        distance = np.abs(labels.lowest + labels.step * np.arange(labels.num_labels) - start[..., None])
        cost = np.minimum(self._settings.start_weight * distance / labels.step, self._settings.start_limit)
        return np.floor(cost + 0.5).astype(np.int16)

    def _key_surfaces(self, view: DepthMap, camera: Floats) -> list[KeySurface]:
        """Draw the depth of the wanted view into the key frames: what it shows there hides the rest."""
        frame = self._model.pixel_frame
        surfaces = []
        for k in (0, 1):
            transfer = transfer_matrix(camera, self._cameras[k], frame)
            drawn = np.full(view.inverse_depth.shape, _kernels_3d.EMPTY)
            torn = tear(view.inverse_depth, transfer, self._settings.tear_px)
            _kernels_3d.rasterise(transfer_surface(transfer, view.inverse_depth), torn, drawn)
            state = np.where(drawn > _kernels_3d.EMPTY, RELIABLE, OUTSIDE).astype(np.int8)
            to_other = transfer_matrix(self._cameras[k], self._cameras[1 - k], frame)
            depth = np.where(state == RELIABLE, drawn, 0.0)
            surfaces.append(KeySurface(self._keys[k], self._cameras[k], depth, state, torn, to_other))
        return surfaces


def _nearest(points: Floats, known: Floats, block_px: int, shape: tuple[int, int]) -> Floats:
    """Inverse depth of the point nearest to each block; 0 if there is none."""
    from scipy.spatial import cKDTree

    if not len(points):
        return np.zeros(shape)
    rows, columns = np.indices(shape)
    centres = (np.stack([columns.ravel(), rows.ravel()], axis=-1) + 0.5) * block_px - 0.5
    _, nearest = cKDTree(points).query(centres)
    start: Floats = known[nearest].reshape(shape)
    return start


def _block_medians(plane: Floats, block_px: int) -> Floats:
    """Median of each block; blocks beyond the frame repeat its last pixels."""
    height, width = plane.shape
    padded = np.pad(plane, ((0, -height % block_px), (0, -width % block_px)), mode="edge")
    cells = padded.reshape(padded.shape[0] // block_px, block_px, padded.shape[1] // block_px, block_px)
    medians: Floats = np.median(cells, axis=(1, 3))
    return medians


def spread_blocks(depth: Floats, block_px: int, shape: tuple[int, ...]) -> Floats:
    """Give every pixel the depth of its block, or between those of blocks on one plane.

    Parameters
    ----------
    depth : ndarray of shape (rows, columns), float64
        Inverse depth of the blocks.
    block_px : int
        Side of the blocks.
    shape : tuple of int
        Height and width.

    Returns
    -------
    ndarray of shape (H, W), float64
        Inverse depth of the pixels.
    """
    span = float(np.ptp(depth))
    corners, shares = [], []
    positions = [(np.arange(side) + 0.5) / block_px - 0.5 for side in shape]
    for lower_row in (True, False):
        for lower_column in (True, False):
            at, share = [], []
            for position, count, lower in zip(positions, depth.shape, (lower_row, lower_column), strict=True):
                floor = np.floor(position)
                at.append(np.clip(floor + (not lower), 0, count - 1).astype(np.int64))
                share.append(1.0 - (position - floor) if lower else position - floor)
            corners.append(depth[np.ix_(*at)])
            shares.append(np.outer(*share))
    stack, weights = np.stack(corners), np.stack(shares)
    own = np.take_along_axis(stack, weights.argmax(axis=0)[None], axis=0)[0]
    weights = np.where(np.abs(stack - own) <= 0.03 * span, weights, 0.0)
    smooth: Floats = (weights * stack).sum(axis=0) / weights.sum(axis=0)
    return smooth
