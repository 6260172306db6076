"""Meshes of layers and sprites: what is beyond infinity has no point."""

import numpy as np

from dvc.geometry.camera_array import DisparityLabels
from dvc.layers.canvas import Canvas, Frame
from dvc.layers.layered_depth_image import LayeredDepthImage
from dvc.layers.sprites import extract_sprites
from dvc.stereo.meshes import layers_shape, sprites_shape


def test_nothing_is_behind_the_camera() -> None:
    """Disparities at infinity and beyond are left out, of layers and of sprites."""
    canvas = Canvas((2, 3), Frame(0, 0, 3, 2), DisparityLabels(1.0, 1.0, 8), 1.0, "middle", 2)
    disparity = np.array([[[2.0, 2.0, 0.0], [2.0, 2.0, -0.5]]], np.float32)
    image = LayeredDepthImage(
        canvas, np.zeros((1, 2, 3, 3), np.uint8), disparity, np.ones((1, 2, 3), np.uint16)
    )
    for shape in (layers_shape(image), sprites_shape(extract_sprites(image))):
        assert len(shape.points) == 4
        assert (shape.points[:, 2] == 0.5).all()
        assert len(shape.triangles) == 2
