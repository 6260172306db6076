"""The decoder of layers and sprites."""

from dataclasses import dataclass

import numpy as np

from dvc.dibr.depth_image import depth_image_decoder as depth_image
from dvc.dibr.depth_image.piece_stream import LayeredStream
from dvc.dibr.depth_image.scene_pieces import Pieces
from dvc.errors import BitstreamError
from dvc.geometry.viewpoints import Viewpoint
from dvc.layers.sprites import Sprite


@dataclass(frozen=True, eq=False)
class DecodedPieces:
    """A decoded stream."""

    scene: Pieces  # what it holds
    damage: str | None  # what is missing of it

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of a view."""
        frame = self.scene.canvas.frame
        return frame.height, frame.width

    @property
    def viewpoints(self) -> tuple[Viewpoint, ...]:
        """The viewpoint of the reference view."""
        return (depth_image.ORIGIN,)


def decode(stream: LayeredStream) -> DecodedPieces:
    """Decode a stream.

    Parameters
    ----------
    stream : LayeredStream
        As it was read.

    Returns
    -------
    DecodedPieces
        Its pieces, but for those from the first one on that cannot have been written.

    Raises
    ------
    BitstreamError
        If that is the first one.
    """
    pieces: list[Sprite] = []
    damage = stream.damage
    for number, (rectangle, piece) in enumerate(zip(stream.rectangles, stream.pieces, strict=False), 1):
        if piece is None:
            nothing = np.zeros((0, 0, 3), np.uint8)
            pieces.append(Sprite(0, 0, nothing[..., 0] > 0, nothing, nothing[..., 0].astype(np.float32)))
            continue
        try:
            found = depth_image.decode(piece)
        except BitstreamError as err:
            damage = f"piece {number} of {len(stream.rectangles)}: {err}"
            break
        assert found.mask is not None
        assert found.picture is not None
        colour = np.broadcast_to(found.picture.reshape(*found.mask.shape, -1), (*found.mask.shape, 3))
        disparity = np.where(found.mask, found.disparity, 0.0).astype(np.float32)
        pieces.append(
            Sprite(rectangle.left, rectangle.top, found.mask, colour * found.mask[..., None], disparity)
        )
    if not any(piece.mask.any() for piece in pieces) and damage is not None:
        raise BitstreamError(f"not one piece can be decoded: {damage}")
    return DecodedPieces(Pieces(stream.canvas, stream.kind, tuple(pieces)), damage)
