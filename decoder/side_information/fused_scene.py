"""Mesh and blocks together: two predictions from one scene, weighed by the errors that each expects.

Both know the surfaces of the key frames; the mesh draws them into the wanted view, blocks search a depth
there anew. What they do not agree on is uncertain, whatever either expects of itself.

References
----------
[BatesGranger1969] J. M. Bates, C. W. J. Granger, "The combination of forecasts", Operational Research
Quarterly 20(4), 1969.
"""

import numpy as np
from numpy.typing import NDArray

from decoder.side_information.blending import neighbourhood
from decoder.side_information.epipolar_blocks import BlockInterpolator, BlockSettings
from decoder.side_information.mesh import MeshInterpolator, MeshSettings
from decoder.side_information.rendering import Interpolation
from decoder.side_information.surfaces import KeySurface, Known
from sfm.model import Model

Floats = NDArray[np.float64]

BLOCK_WEIGHT = 0.5
"""Of blocks, where they expect the same error as the mesh: they are mostly a little worse."""
DISAGREEMENT = 0.5
"""Part of the squared difference of the two that is added to their squared error."""


class FusedInterpolator:
    """Predicts frames between two key frames by the dense mesh and by epipolar blocks.

    Parameters
    ----------
    model : Model
        Cameras of the key frames, and correspondences.
    first, second : ndarray of shape (H, W), uint8
        Luma of the key frames.
    known : tuple of two (KnownDepth or None), optional
        What is known of the depth of each key frame already.
    """

    def __init__(
        self,
        model: Model,
        first: NDArray[np.uint8],
        second: NDArray[np.uint8],
        known: Known = (None, None),
    ) -> None:
        self._mesh = MeshInterpolator(model, first, second, MeshSettings(), known)
        self._blocks = BlockInterpolator(model, first, second, BlockSettings(), self._mesh.surfaces)

    @property
    def surfaces(self) -> tuple[KeySurface, KeySurface]:
        """What both key frames show."""
        return self._mesh.surfaces

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
            The fused frame; positions and weights are those of the mesh.
        """
        return fuse_scenes(self._mesh.interpolate(camera, late), self._blocks.interpolate(camera, late))


def fuse_scenes(mesh: Interpolation, blocks: Interpolation) -> Interpolation:
    """Fuse two predictions of a frame by the errors that they expect.

    Parameters
    ----------
    mesh, blocks : Interpolation
        The predictions, from the same key frames.

    Returns
    -------
    Interpolation
        Their mean by inverse squared errors, with both as hypotheses.
    """
    ours, theirs = (neighbourhood(one.expected_error) ** 2 for one in (mesh, blocks))
    share = BLOCK_WEIGHT * ours / (BLOCK_WEIGHT * ours + theirs)
    distance = neighbourhood((mesh.luma - blocks.luma) ** 2)
    return mesh._replace(
        luma=mesh.luma + share * (blocks.luma - mesh.luma),
        compensated=tuple(
            one + share * (other - one)
            for one, other in zip(mesh.compensated, blocks.compensated, strict=True)
        ),
        expected_error=np.sqrt(mesh.expected_error**2 + DISAGREEMENT * distance),
        hypotheses=(mesh.luma, blocks.luma),
    )
