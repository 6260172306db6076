"""Method `depth` with two costs: the mean of two predictions, from depths that were found in different ways.

Gradients and census bits mislead a plane sweep in different places, and so do a fine sweep and a coarse one
with stiffer surfaces. Where both depths are right the predictions are the same; where one is wrong, half of
the error is a quarter of the squared error. Between key frames that are near each other wrong depths move
little, and one depth is enough.

References
----------
[BatesGranger1969] J. M. Bates, C. W. J. Granger, "The combination of forecasts", Operational Research
Quarterly 20(4), 1969.
"""

import numpy as np
from numpy.typing import NDArray

from decoder.side_information.protocol import Interpolation
from decoder.side_information.scene.depth import DepthInterpolator
from dvc.geometry.depth_maps import Known
from dvc.geometry.plane_sweep import CENSUS_SWEEP, parallax_px
from dvc.geometry.warping import warp_matrix
from sfm.scene_model import Model

Floats = NDArray[np.float64]

MIN_PARALLAX = 0.07
"""Between what is nearest and what is farthest, for a second depth, as a share of the longer side."""


class AveragedDepthInterpolator:
    """Predicts frames between two key frames by two depths of each; see `SceneInterpolator`."""

    name = DepthInterpolator.name

    def __init__(
        self,
        model: Model,
        first: NDArray[np.uint8],
        second: NDArray[np.uint8],
        known: Known = (None, None),
    ) -> None:
        self._fine = DepthInterpolator(model, first, second, known)
        self._stiff = None
        settled = all(one is not None and one.depth is not None and one.is_settled for one in known)
        if not settled and relative_parallax(model) >= MIN_PARALLAX:
            self._stiff = DepthInterpolator(model, first, second, known, CENSUS_SWEEP)
        self.views = self._fine.views

    def interpolate(self, camera: Floats, temporal_position: float) -> Interpolation:
        """Average two predictions of one frame; positions and weights are those of the fine sweep."""
        wanted = camera, temporal_position
        found = self._fine.interpolate(*wanted)
        return found if self._stiff is None else average(found, self._stiff.interpolate(*wanted))


def relative_parallax(model: Model) -> float:
    """Measure the parallax between what is nearest and what is farthest."""
    pair, size = model.view_pair, model.pixel_frame
    shape = size.height_px, size.width_px
    warp = warp_matrix(*pair.cameras, size)
    return parallax_px(pair.inverse_depth_ranges[0], warp, shape) / max(shape)


def average(first: Interpolation, second: Interpolation) -> Interpolation:
    """Average two predictions of a frame."""
    return first._replace(
        luma=0.5 * (first.luma + second.luma),
        compensated=tuple(
            0.5 * (one + other) for one, other in zip(first.compensated, second.compensated, strict=True)
        ),
        expected_error=0.5 * (first.expected_error + second.expected_error),
    )
