"""Methods `depth`, `blocks` and `fused`: dense depth of key frames, depth of blocks of a frame, or both."""

import numpy as np

from decoder.side_information.protocol import Interpolation
from decoder.side_information.synthesis import block_medians, neighbourhood, render_between
from dvc.arrays import Bytes, Floats
from dvc.geometry.cameras import homogeneous, inverse_depth_range
from dvc.geometry.continuation import DepthMap
from dvc.geometry.depth_maps import DepthView, Known, estimate_depths
from dvc.geometry.label_inference import semi_global
from dvc.geometry.plane_sweep import (
    CENSUS_SWEEP,
    GRADIENT_SWEEP,
    SweepSettings,
    VirtualView,
    block_costs,
    depth_hypotheses,
    luma_features,
    parallax_px,
    refine_blocks,
)
from dvc.geometry.rendering import render_depth
from dvc.geometry.warping import warp_matrix
from sfm.scene_model import Model

UNKNOWN: Known = (None, None)


class DepthInterpolator:
    """Predicts frames between two key frames by their depth; see `SceneInterpolator`."""

    name = "depth"

    def __init__(
        self,
        model: Model,
        first: Bytes,
        second: Bytes,
        known: Known = UNKNOWN,
        sweep: SweepSettings = GRADIENT_SWEEP,
    ) -> None:
        self._frame = model.pixel_frame
        self.views = estimate_depths(model.view_pair, first, second, known, sweep)

    def interpolate(self, camera: Floats, temporal_position: float) -> Interpolation:
        """Predict one frame."""
        return render_between(self.views, camera, temporal_position, self._frame)


MIN_PARALLAX = 0.07
"""Least range of parallax for a second depth, as a share of the longer side."""


class AveragedDepthInterpolator:
    """Predicts frames between two key frames by two depths of each; see `SceneInterpolator`."""

    name = DepthInterpolator.name

    def __init__(self, model: Model, first: Bytes, second: Bytes, known: Known = UNKNOWN) -> None:
        self._fine = DepthInterpolator(model, first, second, known)
        self._stiff = None
        settled = all(one is not None and one.depth is not None and one.is_settled for one in known)
        if not settled and relative_parallax(model) >= MIN_PARALLAX:
            self._stiff = DepthInterpolator(model, first, second, known, CENSUS_SWEEP)
        self.views = self._fine.views

    def interpolate(self, camera: Floats, temporal_position: float) -> Interpolation:
        """Average two predictions of one frame; positions and weights are those of the fine sweep."""
        fine = self._fine.interpolate(camera, temporal_position)
        if self._stiff is None:
            return fine
        stiff = self._stiff.interpolate(camera, temporal_position)
        pairs = zip(fine.compensated, stiff.compensated, strict=True)
        return fine._replace(
            luma=0.5 * (fine.luma + stiff.luma),
            compensated=tuple(0.5 * (one + other) for one, other in pairs),
            expected_error=0.5 * (fine.expected_error + stiff.expected_error),
        )


def relative_parallax(model: Model) -> float:
    """Return the range of parallax in the scene relative to the longer side."""
    pair, size = model.view_pair, model.pixel_frame
    shape = size.height_px, size.width_px
    warp = warp_matrix(*pair.cameras, size)
    return parallax_px(pair.inverse_depth_ranges[0], warp, shape) / max(shape)


BLOCK_PX = 4
"""Side of the blocks: that of the transform, and of the blocks that are refined later."""
SPACING_PX = 2.0
"""Distance of the 4x4 samples of a block's window in the full search: it is twice as wide as the block."""
WINDOW_RADIUS_PX = 3
"""Radius of the window of the golden section."""
START_WEIGHT, START_LIMIT = 4.0, 40.0
"""Cost per hypothesis of leaving the start, and its limit: above it a block may go anywhere."""
SWEEP = SweepSettings(step_px=0.8, max_hypotheses=96, small_jump=10, large_jump=100)
"""Coarser than the sweep of a key frame, for the golden section follows."""


class BlockInterpolator:
    """Predicts frames between two key frames by epipolar blocks; see `SceneInterpolator`."""

    name = "blocks"

    def __init__(
        self,
        model: Model,
        first: Bytes,
        second: Bytes,
        known: Known = UNKNOWN,
        views: tuple[DepthView, DepthView] | None = None,
    ) -> None:
        self._model = model
        self.views = views or estimate_depths(model.view_pair, first, second)
        self._features = (luma_features(first), luma_features(second))

    def interpolate(self, camera: Floats, temporal_position: float) -> Interpolation:
        """Predict one frame."""
        frame = self._model.pixel_frame
        rendered = render_depth(self.views, camera, frame)
        start = block_medians(rendered.inverse_depth, BLOCK_PX)
        visible = block_medians(rendered.reliable.astype(np.float64), BLOCK_PX) >= 0.5
        shape = rendered.inverse_depth.shape
        # Search the inverse depth of every block, starting from the rendered one.
        first, second = (warp_matrix(camera, view.camera, frame) for view in self.views)
        view = VirtualView(self._features, (first, second), BLOCK_PX)
        # The reference of the largest motion by depth, which grows with the distance between camera centres.
        reference = max(view.warps, key=lambda warp: np.linalg.norm(warp[:, 3]) / np.linalg.norm(warp[:, :3]))
        # Inverse depths of the correspondences in the view bound its hypotheses.
        model = self._model
        usable = np.isfinite(model.depths) & (model.depths > 0)
        to_view = warp_matrix(model.first_camera, camera, frame)
        inverse_depth = 1.0 / model.depths[usable]
        points = homogeneous(model.correspondences.first)[usable]
        third = (np.column_stack([points, inverse_depth]) @ to_view.T)[:, 2]
        before = third > 1e-6
        inverse_depths = inverse_depth_range(inverse_depth[before] / third[before])
        hypotheses = depth_hypotheses(inverse_depths, reference, shape, SWEEP)
        cost = block_costs(view, hypotheses, SPACING_PX)
        cost[~visible] = 0
        levels = hypotheses.inverse_depth(np.arange(float(hypotheses.num_hypotheses)))
        leaving = np.minimum(START_WEIGHT * np.abs(levels - start[..., None]) / hypotheses.step, START_LIMIT)
        cost += np.floor(leaving + 0.5).astype(np.int16)
        plain = np.zeros(cost.shape[:2], np.uint8)
        chosen, _ = semi_global(cost, plain, SWEEP.small_jump, SWEEP.large_jump)
        coarse = hypotheses.inverse_depth(chosen)
        refined = refine_blocks(view, coarse, hypotheses.step, WINDOW_RADIUS_PX)
        blocks = np.where(visible, refined, coarse)
        depth = DepthMap(spread_blocks(blocks, BLOCK_PX, shape), rendered.visibility)
        return render_between(self.views, camera, temporal_position, frame, depth)


def spread_blocks(depth: Floats, block_px: int, shape: tuple[int, ...]) -> Floats:
    """Give every pixel the depth of its block, or between those of blocks on one plane."""
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
    block = np.take_along_axis(stack, weights.argmax(axis=0)[None], axis=0)[0]
    weights = np.where(np.abs(stack - block) <= 0.03 * span, weights, 0.0)
    return np.asarray((weights * stack).sum(axis=0) / weights.sum(axis=0))


BLOCK_WEIGHT = 0.5
"""Weight of blocks relative to rendered depth of equal expected error: they are mostly a little worse."""
DISAGREEMENT = 0.5
"""Part of the squared difference of the two that is added to their squared error."""


class FusedInterpolator:
    """Predicts frames between two key frames by depth and by epipolar blocks; see `SceneInterpolator`."""

    name = "fused"

    def __init__(self, model: Model, first: Bytes, second: Bytes, known: Known = UNKNOWN) -> None:
        self._depth = DepthInterpolator(model, first, second, known)
        self.views = self._depth.views
        self._blocks = BlockInterpolator(model, first, second, views=self.views)

    def interpolate(self, camera: Floats, temporal_position: float) -> Interpolation:
        """Fuse one frame; positions and weights are those of the depth."""
        pose = camera, temporal_position
        return fuse_scenes(self._depth.interpolate(*pose), self._blocks.interpolate(*pose))


def fuse_scenes(depth: Interpolation, blocks: Interpolation) -> Interpolation:
    """Fuse two predictions of a frame by the errors that they expect."""
    ours, theirs = (neighbourhood(one.expected_error) ** 2 for one in (depth, blocks))
    share = BLOCK_WEIGHT * ours / (BLOCK_WEIGHT * ours + theirs)
    distance = neighbourhood((depth.luma - blocks.luma) ** 2)
    return depth._replace(
        luma=depth.luma + share * (blocks.luma - depth.luma),
        compensated=tuple(
            one + share * (other - one)
            for one, other in zip(depth.compensated, blocks.compensated, strict=True)
        ),
        expected_error=np.sqrt(depth.expected_error**2 + DISAGREEMENT * distance),
        hypotheses=(depth.luma, blocks.luma),
    )
