"""Layers and sprites of which everything is known."""

import numpy as np

from dvc.dibr.depth_image.scene_pieces import Kind, Pieces, layers_of, pieces_of_layers
from dvc.geometry.camera_array import DisparityLabels
from dvc.layers.canvas import Canvas, Frame
from dvc.layers.layered_depth_image import layered_depth_image
from dvc.layers.sprites import Sprite, extract_sprites
from tests.stereo.plane_scenes import LABELS, SCENE, reconstruction_of, square_lattice


def plane_layers() -> Pieces:
    """Return the layers of three planes as nine cameras see them."""
    return pieces_of_layers(layered_depth_image(reconstruction_of(SCENE, square_lattice(1), LABELS)))


def plane_sprites() -> Pieces:
    """Return the sprites of the same."""
    sprites = extract_sprites(layers_of(plane_layers()))
    return Pieces(sprites.canvas, Kind.SPRITES, sprites.sprites)


def canvas_of(shape: tuple[int, int], **changes: object) -> Canvas:
    """Return a canvas that is all frame."""
    options = {"frame": Frame(0, 0, shape[1], shape[0]), "labels": DisparityLabels(0.0, 1.0, 16)} | changes
    return Canvas(shape, resolution=1.0, reference="middle", num_cameras=3, **options)


def sprite_of(mask: np.ndarray, left: int = 0, top: int = 0, seed: int = 0) -> Sprite:
    """Return a piece of a mask, with a smooth picture and a slanted map."""
    rng = np.random.default_rng(seed)
    y, x = np.indices(mask.shape, np.float64)
    waves = [
        128 + 60 * np.sin(x * rng.uniform(0.1, 0.4) + k) * np.cos(y * rng.uniform(0.1, 0.4)) for k in range(3)
    ]
    colour = np.rint(np.stack(waves, axis=-1)).astype(np.uint8) * mask[..., None]
    disparity = np.where(mask, 4.0 + 0.05 * x - 0.03 * y + rng.uniform(0, 5), 0.0).astype(np.float32)
    return Sprite(left, top, mask, colour, disparity)


def odd_sprites() -> Pieces:
    """Return sprites of odd sizes: scattered pixels, a single one, a line, a disc with a hole."""
    rng = np.random.default_rng(5)
    y, x = np.indices((33, 29))
    radius = np.hypot(y - 16, x - 14)
    masks = [
        (radius < 14) & (radius > 5),
        rng.random((17, 21)) < 0.2,
        np.ones((1, 1), np.bool_),
        np.ones((1, 13), np.bool_),
        np.ones((9, 7), np.bool_),
    ]
    pieces = [sprite_of(mask, 3 * k, 2 * k, k) for k, mask in enumerate(masks)]
    return Pieces(canvas_of((45, 61)), Kind.SPRITES, tuple(pieces))
