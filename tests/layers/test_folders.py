"""Folders of layers and sprites: round trips, and refusal of damaged ones."""

import contextlib
import copy
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dvc.errors import DvcError
from dvc.layers import layer_folders
from dvc.layers.layered_depth_image import LayeredDepthImage, layered_depth_image
from dvc.layers.sprites import extract_sprites
from dvc.picture_files import write_png
from tests.layers.test_sprites import random_layers
from tests.stereo.plane_scenes import LABELS, SCENE, reconstruction_of, square_lattice

Reader = Callable[[Path], object]
READERS: dict[str, Reader] = {
    layer_folders.LAYERS_INDEX: layer_folders.read_layers,
    layer_folders.SPRITES_INDEX: layer_folders.read_sprites,
}


@pytest.fixture(scope="module")
def image() -> LayeredDepthImage:
    """Return the layers of three planes."""
    return layered_depth_image(reconstruction_of(SCENE, square_lattice(1), LABELS))


@pytest.fixture(params=list(READERS))
def index(request: pytest.FixtureRequest, image: LayeredDepthImage, tmp_path: Path) -> Path:
    """Return the index file of a folder of either kind."""
    layer_folders.write_layers(tmp_path, image)
    layer_folders.write_sprites(tmp_path, extract_sprites(image))
    return tmp_path / str(request.param)


def _read(index: Path) -> object:
    return READERS[index.name](index.parent)


@pytest.mark.parametrize("seed", range(3))
def test_round_trip(tmp_path: Path, seed: int) -> None:
    image = random_layers(seed, 6)
    matrix = np.diag([0.1, 0.1, 1.0, 1.0])[[0, 1, 3, 2]] + 1e-3
    image = replace(image, canvas=replace(image.canvas, world_from_rectified=matrix if seed else None))
    layer_folders.write_layers(tmp_path, image)
    found = layer_folders.read_layers(tmp_path)
    np.testing.assert_equal(vars(found.canvas), vars(image.canvas))
    np.testing.assert_equal(vars(found) | {"canvas": None}, vars(image) | {"canvas": None})
    assert (found.disparity.dtype, found.votes.dtype) == (np.float32, np.uint8)
    sprites = extract_sprites(image)
    layer_folders.write_sprites(tmp_path, sprites)
    again = layer_folders.read_sprites(tmp_path)
    np.testing.assert_equal(vars(again.canvas), vars(image.canvas))
    np.testing.assert_equal([*map(vars, again.sprites)], [*map(vars, sprites.sprites)])


def test_files_can_be_opened_by_others(tmp_path: Path, image: LayeredDepthImage) -> None:
    layer_folders.write_layers(tmp_path, image)
    layer_folders.write_sprites(tmp_path, extract_sprites(image))
    disparity = cv2.imread(str(tmp_path / "disparity-1.pfm"), cv2.IMREAD_UNCHANGED)
    colour = cv2.imread(str(tmp_path / "colour-1.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(np.isfinite(disparity), image.occupied[1])
    np.testing.assert_array_equal(colour[:, :, 3] == 255, image.occupied[1])
    depth = cv2.imread(str(tmp_path / "depth-0000.pfm"), cv2.IMREAD_UNCHANGED)
    near = cv2.imread(str(tmp_path / "disparity-0000.pfm"), cv2.IMREAD_UNCHANGED)
    scale = json.loads((tmp_path / "sprites.json").read_text())["depth"]
    expected = scale["scale"] / (near[np.isfinite(near)] + scale["shift"])
    np.testing.assert_allclose(depth[np.isfinite(near)], expected, rtol=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda index: index.update(version=2), "version 2 is not supported"),
        (lambda index: index.update(format="other"), "not an index of `dvc-stereo"),
        (lambda index: index.pop("frame"), "no 'frame'"),
        (lambda index: index.update(width=1 << 20), "'width' must be a whole number"),
        (lambda index: index.update(height=True), "'height' must be a whole number"),
        (lambda index: index.update(reference="\ud800"), "'reference' must be Unicode text"),
        (lambda index: index["frame"].update(width=1000), "'width' must be a whole number"),
        (lambda index: index["disparities"].update(step=0.0), "'step' is out of range"),
        (lambda index: index["disparities"].update(lowest="0"), "'lowest' must be a number"),
        (lambda index: index.update(resolution=1e99), "'resolution' is out of range"),
        (lambda index: index.update(world_from_rectified=[[1]]), "must be a 4x4 matrix"),
        (lambda index: index.update(world_from_rectified=np.eye(4).tolist()), "gives no depth"),
        (lambda index: index.update(world_from_rectified=np.zeros((4, 4)).tolist()), "must be an invertible"),
        (lambda index: _entries(index).clear(), "must be a list of 1 to"),
        (lambda index: _entries(index).append(3), "expected an object"),
        (lambda index: _entries(index)[0].update(disparity="../x.pfm"), "does not name a file in the folder"),
        (lambda index: _entries(index)[0].update(disparity=_entries(index)[0]["colour"]), "PFM"),
        (lambda index: _entries(index)[0].update(colour=_entries(index)[0]["disparity"]), "RGBA picture"),
        (lambda index: _entries(index)[0].update(disparity=_entries(index)[1]["disparity"]), "disparity"),
    ],
)
def test_bad_index(index: Path, change: Callable[[dict[str, Any]], object], message: str) -> None:
    values = json.loads(index.read_text())
    change(values)
    index.write_text(json.dumps(values))
    with pytest.raises(DvcError, match=message):
        _read(index)


def _entries(index: dict[str, Any]) -> list[Any]:
    found: list[Any] = index["layers"] if "layers" in index else index["sprites"]
    return found


@pytest.mark.parametrize("text", ["", "[]", "{", "[" * 100000, '{"format": "dvc3d layers"}', "\xff"])
def test_no_index(index: Path, text: str) -> None:
    index.write_bytes(text.encode("latin-1"))
    with pytest.raises(DvcError, match=r"not|version"):
        _read(index)


def test_layers_in_wrong_order(tmp_path: Path, image: LayeredDepthImage) -> None:
    layer_folders.write_layers(tmp_path, image)
    index = tmp_path / layer_folders.LAYERS_INDEX
    values = json.loads(index.read_text())
    values["layers"].reverse()
    index.write_text(json.dumps(values))
    with pytest.raises(DvcError, match="behind each other"):
        layer_folders.read_layers(tmp_path)


def test_damaged_pictures(index: Path) -> None:
    path = index.parent / _entries(json.loads(index.read_text()))[0]["colour"]
    picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    picture[:, :, 3] //= 2
    write_png(path, picture)
    with pytest.raises(DvcError, match="opacity"):
        _read(index)
    path.write_bytes(b"")
    with pytest.raises(DvcError, match="picture of"):
        _read(index)
    path.unlink()
    with pytest.raises(OSError, match=path.name):
        _read(index)


JUNK = st.none() | st.booleans() | st.integers(-(10**20), 10**20) | st.floats() | st.text(max_size=8)
JUNK |= st.lists(st.integers(-2, 2), max_size=4) | st.dictionaries(
    st.text(max_size=3), st.integers(), max_size=2
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=150)
@given(data=st.data())
def test_any_index(index: Path, data: st.DataObject) -> None:
    original = index.read_text()
    values = json.loads(original)
    place: Any = values
    while True:
        key = data.draw(st.sampled_from(range(len(place)) if isinstance(place, list) else sorted(place)))
        if not isinstance(place[key], dict | list) or not place[key] or data.draw(st.booleans()):
            break
        place = place[key]
    place[key] = copy.deepcopy(data.draw(JUNK))
    index.write_text(json.dumps(values))
    with contextlib.suppress(DvcError, OSError):
        _read(index)
    index.write_text(original)
