"""Coded layers and sprites against one picture with its map: views of the other cameras."""

import tempfile
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.figures.dibr.rendered import rendered_array
from benchmarks.figures.harness import Figure, Measured, Setting
from benchmarks.figures.stereo.runs import reconstructed, reconstruction_folder
from dvc.dibr.codec.rendering import picture_of, render
from dvc.dibr.codec.views import luma
from dvc.dibr.depth_image.decoder import decode as decode_image
from dvc.dibr.depth_image.depth_scale import DepthScale
from dvc.dibr.depth_image.encoder import DepthImage
from dvc.dibr.depth_image.encoder import encode_to_size as encode_image
from dvc.dibr.layered import pieces
from dvc.dibr.layered.decoder import decode
from dvc.dibr.layered.rendering import render_pieces
from dvc.dibr.layered.selection import encode_best
from dvc.dibr.layered.stream import decode_stream
from dvc.metrics import psnr_db
from dvc.multiview.camera_array import LatticePosition
from dvc.multiview.view_synthesis import SynthesisedView
from dvc.stereo.layers.layered_depth_image import layered_depth_image
from dvc.stereo.layers.sprites import extract_sprites
from dvc.stereo.surfaces.folder import read_reconstruction
from dvc.stereo.surfaces.surface import Reconstruction
from dvc.stereo.thesis.real_sets import PAIRS

RATES_BPP = 0.25, 0.5, 1.0
NUM_CAMERAS = {"tsukuba": 25, "teddy": 2}
"""Of real sets."""
RENDERED = "street"
"""Four cameras in two rows."""
MOST_LOSS_DB = 0.1


def coded_views(setting: Setting, clip: str) -> Measured:
    """Code layers, sprites, and the reference view with its map, and render the other cameras."""
    found = _rendered(clip) if clip == RENDERED else reconstructed(PAIRS[clip], NUM_CAMERAS[clip])
    return measure(found, RATES_BPP[1:2] if setting.quick else RATES_BPP)


def _rendered(name: str) -> Reconstruction:
    """Reconstruct a rendered array with the default settings."""
    scene = rendered_array(name)
    lowest, step, number = scene.labels
    with tempfile.TemporaryDirectory() as scratch:
        paths = [Path(scratch) / f"{view.name}.png" for view in scene.array]
        for path, view in zip(paths, scene.array, strict=True):
            cv2.imwrite(str(path), view.image[..., ::-1])
        labels = f"{lowest:g}:{lowest + step * (number - 1):g}:{step:g}"
        with reconstruction_folder(paths, labels, [view.position for view in scene.array]) as (folder, _):
            return read_reconstruction(folder)


def measure(found: Reconstruction, rates: tuple[float, ...]) -> Measured:
    """Measure at some rates."""
    image = layered_depth_image(found)
    scenes = {
        "layers": pieces.pieces_of_layers(image),
        "sprites": pieces.pieces_of_sprites(extract_sprites(image)),
    }
    values: dict[str, float] = {}
    texts, worst = [], np.inf
    for rate in rates:
        known = {"picture": _of_picture(found, rate)}
        known |= {name: _of_pieces(found, scene, rate) for name, scene in scenes.items()}
        values |= {f"{name}_db_at_{rate:g}_bpp": value for name, value in known.items()}
        worst = min(worst, *(known[name] - known["picture"] for name in scenes))
        each = [f"{name} {value:.2f}" for name, value in known.items()]
        texts.append(f"{rate:g} bpp: {', '.join(each)} dB")
    return Measured("; ".join(texts), bool(worst >= -MOST_LOSS_DB), values)


def _of_picture(found: Reconstruction, rate: float) -> float:
    number = found.array.reference
    picture, depth = found.array[number].image, found.surfaces[number].disparity.astype(np.float64)
    scene = DepthImage(depth, DepthScale.of(depth), picture)
    decoded = decode_image(encode_image(scene, int(rate * depth.size / 8), None).stream)
    return _mean_psnr_db(found, lambda place: render(decoded, place))


def _of_pieces(found: Reconstruction, scene: pieces.Pieces, rate: float) -> float:
    frame = scene.canvas.frame
    data = encode_best(scene, int(rate * frame.width * frame.height / 8)).encoded.data
    decoded = decode(decode_stream(data)).scene
    return _mean_psnr_db(found, lambda place: render_pieces(decoded, place))


def _mean_psnr_db(found: Reconstruction, view_of: Callable[[LatticePosition], SynthesisedView]) -> float:
    origin = found.array[found.array.reference].position
    values = []
    for number, camera in enumerate(found.array):
        if number == found.array.reference:
            continue
        place = LatticePosition(camera.position.m - origin.m, camera.position.n - origin.n)
        picture: NDArray[np.uint8] = luma(picture_of(view_of(place)))
        values.append(psnr_db(picture, luma(camera.image)))
    return float(np.mean(values))


FIGURES = (
    Figure(
        "shape-adaptive",
        "layers",
        "views of the other cameras from one picture with its map, from coded layers, from sprites",
        f"≥ picture with its map - {MOST_LOSS_DB:g} dB at each rate",
        coded_views,
        (*NUM_CAMERAS, RENDERED),
        slow=True,
    ),
)
"""Figures of this module."""
