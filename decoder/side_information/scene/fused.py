"""Method `fused`: depth and blocks, two predictions from one scene weighed by the errors that each expects.

Both know the depth of the key frames; one renders it into the wanted view, blocks search a depth there anew.
What they do not agree on is uncertain, whatever either expects of itself.

References
----------
[BatesGranger1969] J. M. Bates, C. W. J. Granger, "The combination of forecasts", Operational Research
Quarterly 20(4), 1969.
"""

import numpy as np
from numpy.typing import NDArray

from decoder.side_information.protocol import Interpolation
from decoder.side_information.scene.blocks import BlockInterpolator
from decoder.side_information.scene.depth import DepthInterpolator
from decoder.side_information.weighting import neighbourhood
from dvc.geometry.depth_maps import Known
from sfm.scene_model import Model

Floats = NDArray[np.float64]

BLOCK_WEIGHT = 0.5
"""Of blocks, where they expect the same error as rendered depth: they are mostly a little worse."""
DISAGREEMENT = 0.5
"""Part of the squared difference of the two that is added to their squared error."""


class FusedInterpolator:
    """Predicts frames between two key frames by depth and by epipolar blocks; see `SceneInterpolator`."""

    name = "fused"

    def __init__(
        self,
        model: Model,
        first: NDArray[np.uint8],
        second: NDArray[np.uint8],
        known: Known = (None, None),
    ) -> None:
        self._depth = DepthInterpolator(model, first, second, known)
        self.views = self._depth.views
        self._blocks = BlockInterpolator(model, first, second, views=self.views)

    def interpolate(self, camera: Floats, temporal_position: float) -> Interpolation:
        """Fuse one frame; positions and weights are those of the depth."""
        wanted = camera, temporal_position
        return fuse_scenes(self._depth.interpolate(*wanted), self._blocks.interpolate(*wanted))


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
