"""Frozen streams of pictures with depth decode to the same pictures and labels for ever, on any processor.

`DVC_REGENERATE=1` makes those that are not there, and stores anew what encoders decide.
"""

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dvc.dibr.depth_image import depth_image_stream
from dvc.dibr.depth_image import piece_stream as layered_stream
from dvc.dibr.depth_image.depth_image_encoder import DepthImage, DepthOptions, code_edges
from dvc.dibr.depth_image.depth_image_encoder import encode_to_size as encode_map
from dvc.dibr.depth_image.depth_image_stream import DepthScale
from dvc.dibr.depth_image.depth_image_stream import decode as decode_depth_image
from dvc.dibr.depth_image.piece_encoder import encode_to_size as encode_pieces
from dvc.dibr.depth_image.piece_stream import decode as decode_pieces
from dvc.dibr.dibr_streams import BUILT_IN_CODECS, Body
from dvc.dibr.view_encoder import ViewEncoder
from dvc.dibr.view_set import Views, labels_of_depths, views_of_cameras, views_of_pictures
from dvc.dibr.view_stream import decode, decode_stream
from dvc.environment import baseline_environment
from dvc.geometry.calibrated_cameras import Camera
from dvc.geometry.camera_array import DisparityLabels, LatticePosition
from dvc.images.chain_code import EdgeCode
from dvc.images.edge_selection import canny_edges
from tests import frozen
from tests.dibr.piece_scenes import odd_sprites, plane_layers
from tests.dibr.scenes import FOCAL_PX, texture, two_discs, views_of_square

FOLDER = frozen.GOLDEN / "dibr"
CANARIES = frozen.GOLDEN / "canaries" / "dibr.json"
MAX_BYTES = 20_000
LABELS = DisparityLabels(0.0, 1.0, 9)


def _row(gray: bool = True, references: tuple[int, ...] = (0,), size: tuple[int, int] = (32, 48)) -> Views:
    pictures = views_of_square((0, 1, -1), *size)
    places = [LatticePosition(float(m), 0.0) for m in (0, 1, -1)]
    return views_of_pictures(pictures, places, references, gray=gray)


def _stream(method: str, views: Views, num_layers: int = 1, labels: DisparityLabels = LABELS) -> bytes:
    return ViewEncoder(views, labels, method, num_layers).encode(2e-5).data


def _calibrated() -> bytes:
    intrinsic = np.array([[FOCAL_PX, 0.0, 24.0], [0.0, FOCAL_PX, 16.0], [0.0, 0.0, 1.0]])
    cameras = [Camera(f"{m}", intrinsic, np.eye(3), np.array([-m, 0.0, 0.0]), (48, 32)) for m in (0.0, 1.0)]
    views = views_of_cameras(views_of_square((0, 1)), cameras)
    return _stream("l", views, labels=labels_of_depths(views, FOCAL_PX / 8, np.inf))


def _map(depth: Any, num_bytes: int, picture: Any = None) -> bytes:
    return encode_map(DepthImage(depth, DepthScale.of(depth), picture), num_bytes, None).data


def _canny() -> bytes:
    depth, picture = two_discs(61, 75), texture(61, 75)
    edges = code_edges(canny_edges(depth), EdgeCode.FIXED)
    image = DepthImage(depth, DepthScale.of(depth, 0.5, 3.0), picture)
    return encode_map(image, 1500, edges, DepthOptions("5/3", order=2)).data


GOLDEN: dict[str, Callable[[], bytes]] = {
    "l": lambda: _stream("l", _row()),
    "s": lambda: _stream("s", _row()),
    "quadtree": lambda: _stream("quadtree", _row()),
    "blocks": lambda: _stream("blocks", _row()),
    "l-layers": lambda: _stream("l", _row(), 4),
    "s-layers-odd": lambda: _stream("s", _row(size=(29, 51)), 3),
    "colour": lambda: _stream("l", _row(gray=False)),
    "two-references": lambda: _stream("l", _row(gray=False, references=(0, 2)), 2),
    "calibrated": _calibrated,
}
LATER: dict[str, Callable[[], bytes]] = {
    "map": lambda: _map(two_discs(64, 80), 200),
    "map-picture": lambda: _map(
        two_discs(64, 80), 1500, np.stack([texture(64, 80, k) for k in range(3)], -1)
    ),
    "map-canny-odd": _canny,
    "pieces-layers": lambda: encode_pieces(plane_layers(), 1200).data,
    "pieces-sprites": lambda: encode_pieces(odd_sprites(), 1200).data,
}
"""Streams of a map, with its picture or without, and of layers and sprites."""
ALL = GOLDEN | LATER
ALL_PROCESSORS = os.environ.get("DVC_ALL_PROCESSORS") == "1"
PROCESSORS = {
    "baseline": baseline_environment(),
    "generic": {"NUMBA_CPU_NAME": "generic", "OPENBLAS_CORETYPE": "Sandybridge"},
}
"""What makes libraries believe that they run on another processor than this one."""


Arrays = list[NDArray[Any]]


def record(data: bytes) -> dict[str, Any]:
    """Return what is frozen of a stream: digests of pictures and disparities at each layer and resolution."""
    found = [["".join(map(_digest, arrays)) for arrays in one] for one in decoded_arrays(data)]
    return {"stream_sha256": hashlib.sha256(data).hexdigest(), "pairs_sha256": found}


def decoded_arrays(data: bytes) -> list[list[Arrays]]:
    """Return pictures, disparities and masks of each pair or piece, at each layer and resolution."""
    if data[4] == Body.PIECES:
        pieces = decode_pieces(layered_stream.decode_stream(data))
        assert pieces.damage is None
        return [[[one.mask, one.colour, one.disparity] for one in pieces.scene.pieces]]
    if data[4] == Body.DEPTH_IMAGE:
        maps = [decode_depth_image(depth_image_stream.decode_stream(data), halvings) for halvings in range(3)]
        assert maps[0].damage is None
        return [[[one.disparity, *([] if one.picture is None else [one.picture])]] for one in maps]
    stream = decode_stream(data)
    assert stream.damage is None
    views = [decode(stream, layers + 1) for layers in range(stream.header.num_layers)]
    views += [decode(stream, None, resolution) for resolution in (1, 2)]
    return [[[pair.picture, pair.disparity] for pair in one.pairs] for one in views]


def _digest(values: Any) -> str:
    array = np.ascontiguousarray(values)
    return hashlib.sha256(str((array.shape, array.dtype)).encode() + array.tobytes()).hexdigest()[:32]


def main() -> None:
    """Print what all frozen streams decode to, for a process of another environment."""
    found = {name: record((FOLDER / f"{name}.dibr").read_bytes()) for name in ALL}
    sys.stdout.write(json.dumps(found))


@pytest.mark.parametrize("name", ALL)
def test_golden_stream_decodes_to_the_frozen_pictures(name: str) -> None:
    path = FOLDER / f"{name}.dibr"
    if os.environ.get("DVC_REGENERATE") == "1" and frozen.missing(FOLDER, [name]):
        path.write_bytes(ALL[name]())
        frozen.freeze(FOLDER, {name: record(path.read_bytes())})
    assert path.stat().st_size <= MAX_BYTES
    assert record(path.read_bytes()) == frozen.records(FOLDER)[name]


@pytest.mark.parametrize("name", ALL)
def test_encoders_decide_as_before(name: str) -> None:
    data, stored = ALL[name](), json.loads(CANARIES.read_text())
    found = {"bytes": len(data), "stream_sha256": hashlib.sha256(data).hexdigest()}
    if os.environ.get("DVC_REGENERATE") == "1":
        stored |= {name: found}
        CANARIES.write_text(json.dumps({one: stored[one] for one in ALL if one in stored}, indent=1) + "\n")
    assert found == stored[name]


@pytest.mark.parametrize("processor", [*PROCESSORS][: None if ALL_PROCESSORS else 1])
def test_golden_streams_decode_alike_on_every_processor(processor: str) -> None:
    environment = os.environ | PROCESSORS[processor]
    command = [sys.executable, "-c", "from tests.dibr.test_golden import main; main()"]
    done = subprocess.run(
        command, cwd=FOLDER.parents[2], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == frozen.records(FOLDER)


def test_every_frozen_stream_is_listed() -> None:
    assert {path.stem for path in FOLDER.glob("*.dibr")} == set(ALL) == set(frozen.records(FOLDER))
    assert set(json.loads(CANARIES.read_text())) == set(ALL)


def test_frozen_streams_are_of_their_kinds() -> None:
    streams = {name: decode_stream((FOLDER / f"{name}.dibr").read_bytes()) for name in GOLDEN}
    assert {stream.header.method for stream in streams.values()} == set(BUILT_IN_CODECS)
    assert streams["l-layers"].header.num_layers == 4
    assert streams["two-references"].header.references == (0, 2)
    assert streams["s-layers-odd"].header.shape == (29, 51)
    kinds = {name: (FOLDER / f"{name}.dibr").read_bytes()[4] for name in LATER}
    assert [kinds[name] for name in LATER] == [3, 3, 3, 5, 5]
    canny = depth_image_stream.decode_stream((FOLDER / "map-canny-odd.dibr").read_bytes())
    assert (canny.edge_code, canny.depth.header.wavelet, canny.shape) == (EdgeCode.FIXED, "5/3", (61, 75))
    assert not isinstance(streams["calibrated"].header.viewpoints[0], LatticePosition)
