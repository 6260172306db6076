"""Inputs of the commands, written into the folder where they run."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from dvc.dibr.depth_image.scene_pieces import write_pieces
from dvc.picture_files import write_pfm, write_png
from tests.dibr.piece_scenes import plane_layers, plane_sprites
from tests.dibr.scenes import texture, two_discs, write_views
from tests.stereo.plane_scenes import LABELS, SCENE, reconstruction_of, square_lattice


@pytest.fixture
def views(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write a row of three views."""
    write_views(tmp_path, "abc", (0, 1, -1))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def maps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Write a map, as numbers and as levels of 8 and 16 bits with a hole, and pictures."""
    monkeypatch.chdir(tmp_path)
    discs, picture = two_discs(64, 80), texture(64, 80)
    write_pfm("map.pfm", discs.astype(np.float32))
    levels = np.round(4 * discs)
    levels[30:34, 60:66] = 0
    cv2.imwrite("map8.png", levels.astype(np.uint8))
    cv2.imwrite("map16.png", (256 * levels).astype(np.uint16))
    cv2.imwrite("gray.png", picture)
    cv2.imwrite("picture.png", np.stack([picture, picture[::-1], picture[:, ::-1]], axis=-1))


@pytest.fixture
def pieces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Write folders of layers and sprites, and the reference and another view with its position."""
    monkeypatch.chdir(tmp_path)
    for name, scene in (("layers", plane_layers()), ("sprites", plane_sprites())):
        Path(name).mkdir()
        write_pieces(Path(name), scene)
    array = reconstruction_of(SCENE, square_lattice(1), LABELS).array
    write_png(Path("reference.png"), array[array.reference].image[:, :, ::-1])
    write_png(Path("view.png"), array[1].image[:, :, ::-1])
    Path("position").write_text(f"{array[1].position.m:g},{array[1].position.n:g}")
