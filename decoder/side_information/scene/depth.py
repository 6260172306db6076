"""Method `depth`: dense depth of both key frames, rendered into the wanted view."""

import numpy as np
from numpy.typing import NDArray

from decoder.side_information.protocol import Interpolation
from decoder.side_information.scene.synthesis import render_between
from dvc.geometry.depth_maps import Known, estimate_depths
from dvc.geometry.plane_sweep import GRADIENT_SWEEP, SweepSettings
from sfm.scene_model import Model

Floats = NDArray[np.float64]
Luma = NDArray[np.uint8]


class DepthInterpolator:
    """Predicts frames between two key frames by their depth; see `SceneInterpolator`."""

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
