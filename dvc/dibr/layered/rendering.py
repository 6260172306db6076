"""Rendering of layers and sprites: each piece is drawn forward, near over far."""

import numpy as np

from dvc.dibr.layered.decoder import DecodedPieces
from dvc.dibr.layered.pieces import Pieces
from dvc.dibr.viewer.scene import continued
from dvc.multiview.camera_array import LatticePosition
from dvc.multiview.hole_filling import fill_from_background
from dvc.multiview.rendering import EMPTY
from dvc.multiview.sampling import sample
from dvc.multiview.view_synthesis import PictureWithDepth, SynthesisedView, drawn_depth
from dvc.multiview.viewpoints import Viewpoint, lattice_warp
from dvc.multiview.warping import inverse_warp, warp_grid
from dvc.stereo.layers.sprites import Sprite

_MARGIN = 1
"""Pixels around a piece, in which the outer halves of its pixels are drawn."""


def render(decoded: DecodedPieces, viewpoint: Viewpoint) -> SynthesisedView:
    """Render a view of a decoded stream.

    Parameters
    ----------
    decoded : DecodedPieces
        Pieces.
    viewpoint : LatticePosition
        The wanted one; the reference view is at (0, 0).

    Returns
    -------
    SynthesisedView
        The view, of the size of the reference view.
    """
    assert isinstance(viewpoint, LatticePosition), "layers and sprites are rectified"
    return render_pieces(decoded.scene, viewpoint)


def render_pieces(scene: Pieces, viewpoint: LatticePosition) -> SynthesisedView:
    """Render a view of pieces.

    Parameters
    ----------
    scene : Pieces
        Pieces.
    viewpoint : LatticePosition
        The wanted one; the reference view is at (0, 0).

    Returns
    -------
    SynthesisedView
        The view, of the size of the reference view.
    """
    frame, resolution = scene.canvas.frame, scene.canvas.resolution
    nearest = np.full((frame.height, frame.width), EMPTY)
    image = np.zeros((*nearest.shape, 3))
    for piece in scene.pieces:
        if not piece.mask.any():
            continue
        source = _source(piece, viewpoint, (frame.left, frame.top), resolution)
        depth = drawn_depth(source, (frame.height, frame.width))
        rows, columns = np.nonzero(depth > nearest)
        nearest[rows, columns] = depth[rows, columns]
        positions = warp_grid(inverse_warp(source.warp), np.where(depth > EMPTY, depth, 0.0))
        chosen = np.ascontiguousarray(positions[rows, columns][np.newaxis])
        for channel in range(3):
            plane = np.ascontiguousarray(source.image[..., channel])
            image[rows, columns, channel] = sample(plane, chosen)[0]
    epipole = np.array([-viewpoint.m, -viewpoint.n, 0.0])
    filled, inverse_depth = fill_from_background(image, nearest, epipole)
    return SynthesisedView(filled, inverse_depth, nearest > EMPTY)


def _source(
    piece: Sprite, viewpoint: LatticePosition, origin: tuple[int, int], resolution: float
) -> PictureWithDepth:
    """A piece with a margin, and the warp from there to the wanted view."""
    around = ((_MARGIN, _MARGIN), (_MARGIN, _MARGIN))
    mask = np.pad(piece.mask, around)
    picture = continued(np.pad(piece.colour, (*around, (0, 0))), mask)
    disparity = np.pad(piece.disparity.astype(np.float64), around)
    warp = lattice_warp(LatticePosition(0.0, 0.0), viewpoint)
    warp[:2, 2] += piece.left - origin[0] - _MARGIN, piece.top - origin[1] - _MARGIN
    return PictureWithDepth(picture, np.where(mask, disparity, EMPTY), warp, resolution)
