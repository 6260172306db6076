"""Prediction of P-type frames: frames of which only earlier ones are known.

Tracks bring the latest frames of the group into the place of the frame; each says the more, the less it
expects to be wrong. What comes into view is in none of them: it is left to the Wyner-Ziv decoder.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from decoder.side_information.block_motion.refinement import BLOCK, BlockRefiner
from decoder.side_information.protocol import Interpolation, Prediction, ReferenceFrame
from decoder.side_information.scene.extrapolated import Scene, extrapolate
from decoder.side_information.scene.synthesis import block_offsets, completed, warp_chroma
from decoder.side_information.tracked_warp import TrackedWarp, warp_by_tracks
from decoder.side_information.weighting import blend_tracked
from dvc.tracks import FeaturePoints, PointTracks

Floats = NDArray[np.float64]

METHOD = "p-type"
"""Name that these predictions carry."""
NUM_REFERENCES = 2
"""Latest frames that are warped: noise of two differs, and what one does not reach the other may."""


class TrackedExtrapolation:
    """Prediction from earlier frames of a group, brought into place by tracked points."""

    def predict(
        self,
        earlier: Sequence[ReferenceFrame],
        points: PointTracks | FeaturePoints | None,
        first_index: int,
        instant: int,
        scene: Scene | None = None,
    ) -> Prediction:
        """Predict one frame, from a scene if there is one that reaches to the latest of those before it."""
        alone = self._by_tracks(earlier, points, first_index, instant)
        if scene is None:
            return alone
        later = _positions(points, earlier[-1].index - first_index)
        rendered, reason = extrapolate(scene, later, _positions(points, instant - first_index))
        if rendered is None:
            return replace(alone, success=False, reason=reason)
        return completed(blend_tracked(alone, rendered), rendered, scene.frames, METHOD)

    def _by_tracks(
        self,
        earlier: Sequence[ReferenceFrame],
        points: PointTracks | FeaturePoints | None,
        first_index: int,
        instant: int,
    ) -> Prediction:
        references = [*reversed(earlier)][:NUM_REFERENCES]
        wanted = _positions(points, instant - first_index)
        warped = [
            warp_by_tracks(one.frame.luma, wanted, _positions(points, one.index - first_index))
            for one in references
        ]
        rendered = _weighed(warped)
        frames = [reference.frame for reference in references]
        lumas = tuple(one.luma for one in warped)
        single = len(warped) == 1
        return Prediction(
            rendered.luma,
            warp_chroma(rendered, [frame.chroma for frame in frames]),
            (*lumas, lumas[0] + rendered.expected_error) if single else lumas,
            METHOD,
            expected_error=rendered.expected_error,
            refiner=BlockRefiner(frames, block_offsets(rendered, BLOCK), METHOD),
            alternatives=() if single else lumas,
        )


def _positions(points: PointTracks | FeaturePoints | None, instant: int) -> Floats:
    if isinstance(points, PointTracks):
        positions: Floats = points.positions[:, instant]
        return positions
    return np.empty((0, 2))


def _weighed(warped: Sequence[TrackedWarp]) -> Interpolation:
    """Average warped references by the inverse squares of the errors that they expect."""
    shares = [1.0 / (one.expected_error * one.expected_error) for one in warped]
    total = shares[0] if len(shares) == 1 else shares[0] + shares[1]
    weights = tuple(share / total for share in shares)
    luma = warped[0].luma
    if len(warped) > 1:
        luma = luma + weights[1] * (warped[1].luma - luma)
    return Interpolation(
        luma,
        tuple(one.luma for one in warped),
        weights,
        tuple(one.positions for one in warped),
        1.0 / np.sqrt(total),
    )
