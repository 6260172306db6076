"""Method `depth`: dense depth of both key frames, rendered into the wanted view."""

import numpy as np
from numpy.typing import NDArray

from decoder.side_information.protocol import Interpolation
from decoder.side_information.scene.synthesis import render_between
from dvc.multiview.depth_maps import Known, estimate_depths
from dvc.multiview.plane_sweep import GRADIENT_SWEEP, SweepSettings
from sfm.model import Model

Floats = NDArray[np.float64]
Luma = NDArray[np.uint8]


class DepthInterpolator:
    """Predicts frames between two key frames by their depth; see `SceneInterpolator`.

    Parameters
    ----------
    model : Model
        Cameras of the key frames, and correspondences that tell the range of depth.
    first, second : ndarray of shape (H, W), uint8
        Luma of the key frames.
    known : tuple of two (KnownDepth or None), optional
        What is known of the depth of each key frame already.
    settings : SweepSettings, optional
        How the depth is searched.
    """

    name = "depth"

    def __init__(
        self,
        model: Model,
        first: Luma,
        second: Luma,
        known: Known = (None, None),
        settings: SweepSettings = GRADIENT_SWEEP,
    ) -> None:
        self._frame = model.pixel_frame
        self.views = estimate_depths(model.view_pair, first, second, known, settings)

    def interpolate(self, camera: Floats, temporal_position: float) -> Interpolation:
        """Predict one frame."""
        return render_between(self.views, camera, temporal_position, self._frame)
