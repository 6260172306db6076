"""Prediction of P-type frames: frames of which only earlier ones are known.

Tracks bring the latest frames of the group into the place of the frame; each says the more, the less it
expects to be wrong. What comes into view is in none of them: it is left to the Wyner-Ziv decoder, unless an
earlier key frame, the long-term reference, has it.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from decoder.side_information.protocol import Interpolation, Prediction, ReferenceFrame
from decoder.side_information.scene.extrapolated import Scene, extrapolate
from decoder.side_information.scene.synthesis import completed
from decoder.side_information.tracked_warp import TrackedWarp, warp_by_tracks
from decoder.side_information.weighting import blend_tracked
from dvc.tracks import FeaturePoints, PointTracks
from dvc.video import Frame

Floats = NDArray[np.float64]

METHOD = "p-type"
"""Name that these predictions carry."""
NUM_REFERENCES = 2
"""Latest frames that are warped: noise of two differs, and what one does not reach the other may."""


class LongTerm(NamedTuple):
    """An earlier key frame that shows what the camera has come back to."""

    frame: Frame
    matches: Floats  # where the tracks of the group are in it, (N, 2) in pixels; nan where they are not


class _Drawn(NamedTuple):
    """A prediction, and where it comes from."""

    prediction: Prediction
    interpolation: Interpolation
    frames: Sequence[Frame]  # that it fetches its pixels from


class TrackedExtrapolation:
    """Prediction from earlier frames of a group, brought into place by tracked points."""

    def predict(
        self,
        earlier: Sequence[ReferenceFrame],
        points: PointTracks | FeaturePoints | None,
        first_index: int,
        instant: int,
        scene: Scene | None = None,
        long_term: LongTerm | None = None,
    ) -> Prediction:
        """Predict one frame, from a scene if there is one that reaches to the latest of those before it."""
        wanted = _positions(points, instant - first_index)
        at_earlier = [_positions(points, one.index - first_index) for one in earlier]
        drawn = self._by_tracks(earlier, at_earlier, wanted)
        if scene is not None:
            drawn = _with_scene(drawn, scene, at_earlier[-1], wanted)
        if long_term is not None:
            drawn = _with_long_term(drawn, long_term, wanted)
        return completed(*drawn, METHOD)

    def _by_tracks(
        self, earlier: Sequence[ReferenceFrame], at_earlier: Sequence[Floats], wanted: Floats
    ) -> _Drawn:
        frames = [one.frame for one in reversed(earlier)][:NUM_REFERENCES]
        places = [*reversed(at_earlier)][:NUM_REFERENCES]
        warped = [
            warp_by_tracks(frame.luma, wanted, place) for frame, place in zip(frames, places, strict=True)
        ]
        rendered = _weighed(warped)
        lumas = tuple(one.luma for one in warped)
        single = len(warped) == 1
        prediction = Prediction(
            rendered.luma,
            None,
            (*lumas, lumas[0] + rendered.expected_error) if single else lumas,
            METHOD,
            expected_error=rendered.expected_error,
            alternatives=() if single else lumas,
        )
        return _Drawn(prediction, rendered, frames)


def _with_scene(drawn: _Drawn, scene: Scene, at_latest: Floats, wanted: Floats) -> _Drawn:
    """Blend a prediction with what is seen of the scene, where its camera is found."""
    rendered, reason = extrapolate(scene, at_latest, wanted)
    if rendered is None:
        return drawn._replace(prediction=replace(drawn.prediction, success=False, reason=reason))
    return _Drawn(blend_tracked(drawn.prediction, rendered), rendered, scene.frames)


def _with_long_term(drawn: _Drawn, long_term: LongTerm, wanted: Floats) -> _Drawn:
    """Average a prediction with a long-term reference by the inverse squares of their expected errors."""
    prediction, rendered, frames = drawn
    assert prediction.expected_error is not None
    warp = warp_by_tracks(long_term.frame.luma, wanted, long_term.matches)
    theirs, ours = 1.0 / prediction.expected_error**2, 1.0 / warp.expected_error**2
    share = ours / (theirs + ours)
    joined = replace(
        prediction,
        luma=prediction.luma + share * (warp.luma - prediction.luma),
        compensated=(prediction.luma, warp.luma),
        expected_error=1.0 / np.sqrt(theirs + ours),
        alternatives=(prediction.luma, warp.luma, *prediction.alternatives),
    )
    interpolation = rendered._replace(
        weights=(*((1.0 - share) * weight for weight in rendered.weights), share),
        positions=(*rendered.positions, warp.positions),
    )
    return _Drawn(joined, interpolation, [*frames, long_term.frame])


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
