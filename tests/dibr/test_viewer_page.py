"""Pages of the viewer without a browser: sources of scenes, bounds, data of the page, hostile names."""

import base64
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dvc.dibr.depth_image.scene_pieces import Bounds, layers_of
from dvc.dibr.view_stream import decode, decode_stream
from dvc.dibr.viewer_page import (
    DEPTH_RANGE,
    Caption,
    _planes,
    is_whole,
    positions_of,
    scene_of_picture,
    scene_of_pieces,
    scene_of_stream,
    scene_values,
    seen_of,
    source_of,
    unit_of,
    write_page,
)
from dvc.errors import DvcError
from dvc.geometry.camera_array import LatticePosition
from dvc.geometry.viewpoints import CalibratedViewpoint
from dvc.layers.sprites import Sprite
from tests.dibr.piece_scenes import plane_layers, plane_sprites

GOLDEN = Path(__file__).resolve().parents[1] / "golden" / "dibr"


def test_references_of_a_stream_are_sources() -> None:
    decoded = decode(decode_stream((GOLDEN / "two-references.dibr").read_bytes()))
    scene = scene_of_stream(decoded)
    assert len(scene.sources) == 2
    for source, pair in zip(scene.sources, decoded.pairs, strict=True):
        assert source.viewpoint == pair.viewpoint
        (piece,) = source.pieces
        assert piece.mask.all()
        np.testing.assert_array_equal(piece.disparity, pair.disparity)
    lattice = np.array(decoded.header.viewpoints)
    assert scene.bounds.left < lattice[:, 0].min()
    assert scene.bounds.right > lattice[:, 0].max()
    assert scene.infinity < scene.range[0]


def test_calibrated_cameras_have_places_in_the_plane_of_the_first() -> None:
    decoded = decode(decode_stream((GOLDEN / "calibrated.dibr").read_bytes()))
    scene = scene_of_stream(decoded)
    positions = positions_of(scene.viewpoints)
    np.testing.assert_allclose(positions[0], 0.0)
    assert np.linalg.norm(positions, axis=1).max() == pytest.approx(1.0)
    assert scene.infinity == 0.0
    first = scene.viewpoints[0]
    assert isinstance(first, CalibratedViewpoint)
    assert unit_of([first]) == 1.0


def test_places_are_along_the_axes_of_the_first_camera() -> None:
    turned = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    centres = np.array([[3.0, 1.0, 2.0], [3.0, 3.0, 2.0], [2.0, 1.0, 2.0]])
    poses = [np.column_stack([turned, -turned @ centre]) for centre in centres]
    found = positions_of([CalibratedViewpoint(np.eye(3), pose) for pose in poses])
    np.testing.assert_allclose(found, [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.5, 0.0]])


@pytest.mark.parametrize(
    ("least", "is_at_zero"),
    [(1.0, True), (9.0 / DEPTH_RANGE, True), (0.01, False), (0.0, False), (-2.0, False)],
)
def test_infinity_is_where_disparities_may_be_inverse_depths(least: float, is_at_zero: bool) -> None:
    disparity = np.linspace(least, 9.0, 12).reshape(3, 4)
    scene = scene_of_picture(source_of(np.zeros((3, 4), np.uint8), disparity), 0.5)
    expected = 0.0 if is_at_zero else least - (9.0 - least) / (DEPTH_RANGE - 1.0)
    assert scene.infinity == pytest.approx(expected)


def test_a_picture_alone_has_bounds_by_its_parallax() -> None:
    picture = np.arange(12, dtype=np.uint8).reshape(3, 4)
    flat, deep = (
        scene_of_picture(source_of(picture, np.linspace(2.0, high, 12).reshape(3, 4)), 0.5) for high in (3, 9)
    )
    assert flat.sources[0].pieces[0].picture.shape == (3, 4, 3)
    assert flat.viewpoints == (LatticePosition(0.0, 0.0),)
    assert flat.bounds.right > deep.bounds.right > 0.0
    assert flat.bounds.left == -flat.bounds.right


def test_layers_are_pieces_in_the_frame_of_the_reference() -> None:
    layers = plane_layers()
    scene, image = scene_of_pieces(layers), layers_of(layers)
    (source,) = scene.sources
    assert len(source.pieces) == len(image.votes)
    assert scene.shape == (40, 60)
    first = source.pieces[0]
    assert (first.left, first.top) == (-image.canvas.frame.left, -image.canvas.frame.top)
    frame = image.canvas.frame.slices
    np.testing.assert_array_equal(first.picture[frame], image.colour[0][frame])
    hidden = source.pieces[1]
    beside = ~hidden.mask & (np.roll(hidden.mask, 1, axis=1) | np.roll(hidden.mask, -1, axis=1))
    assert (hidden.picture[beside][1:-1].max(axis=1) > 0).mean() > 0.9
    assert -2.0 < scene.bounds.left < -1.0
    assert 1.0 < scene.bounds.right < 2.0


def test_sprites_share_pieces_without_touching() -> None:
    sprites = plane_sprites()
    scene = scene_of_pieces(sprites)
    (source,) = scene.sources
    assert sum(int(piece.mask.sum()) for piece in source.pieces) == sprites.num_values
    assert len(source.pieces) <= len(sprites.pieces)
    for piece in source.pieces:
        for axis in (0, 1):
            both = np.diff(piece.mask.astype(int), axis=axis) == 0
            both &= np.take(piece.mask, range(1, piece.mask.shape[axis]), axis=axis)
            jumps = np.abs(np.diff(piece.disparity, axis=axis))[both]
            assert jumps.max(initial=0.0) <= 1.5 * scene.step


@pytest.mark.parametrize(("gap", "num_pieces"), [(0, 2), (1, 1)])
@pytest.mark.parametrize("step", [(0, 1), (0, -1), (1, 0), (-1, 0)])
def test_sprites_share_a_piece_where_a_pixel_is_between_them(
    step: tuple[int, int], gap: int, num_pieces: int
) -> None:
    top, left = (10 + {1: 5 + gap, 0: 1, -1: -(3 + gap)}[k] for k in step)
    sprites = [
        Sprite(x, y, np.ones((n, n), np.bool_), np.full((n, n, 3), 9, np.uint8), np.ones((n, n), np.float32))
        for x, y, n in ((10, 10, 5), (left, top, 3))
    ]
    assert len(_planes(sprites, (30, 30))) == num_pieces


def test_holes_of_a_sprite_take_others() -> None:
    ring = np.ones((9, 9), np.bool_)
    ring[1:8, 1:8] = False
    for size, num_pieces in ((5, 1), (6, 2)):
        middle, levels = np.ones((size, size), np.bool_), np.full((9, 9, 3), 9, np.uint8)
        sprites = [
            Sprite(at, at, mask, levels[: len(mask), : len(mask)], np.ones(mask.shape, np.float32))
            for at, mask in ((4, ring), (6, middle))
        ]
        assert len(_planes(sprites, (20, 20))) == num_pieces


def test_first_view_is_what_its_pieces_show() -> None:
    image = layers_of(plane_layers())
    for scene in map(scene_of_pieces, (plane_layers(), plane_sprites())):
        (source,) = scene.sources
        assert not is_whole(source, scene.shape)
        reference = image.colour[0][image.canvas.frame.slices]
        np.testing.assert_array_equal(seen_of(source, scene.shape), reference)
    alone = source_of(np.zeros((3, 4), np.uint8), np.zeros((3, 4)))
    assert is_whole(alone, (3, 4))
    assert not is_whole(alone, (3, 5))


def test_an_empty_scene_has_a_range() -> None:
    nothing = source_of(np.zeros((3, 4), np.uint8), np.zeros((3, 4)), np.zeros((3, 4), np.bool_))
    scene = scene_of_picture(nothing, 1.0)
    assert scene.range == (0.0, 0.0)
    assert isinstance(scene.bounds, Bounds)
    assert (scene.extent, replace(scene, step=0.0).extent) == (1.0, 1.0)
    assert replace(scene, step=0.25).extent == 0.25


HOSTILE = '"></script><script>window.stolen = 1</script>'


def test_picture_of_the_first_piece_is_there_once(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    picture = rng.integers(0, 256, (20, 30, 3)).astype(np.uint8)
    scene = scene_of_picture(source_of(picture, np.ones((20, 30))), 1.0)
    values = scene_values(scene, Caption("one", "picture", 10, 600))
    assert values["sources"][0]["pieces"][0]["picture"] is None
    assert values["highest"] > values["lowest"] > values["infinity"]
    assert len(base64.b64decode(values["palette"])) == 768
    write_page(tmp_path / "page.html", scene, Caption("one", "picture", 10, 600))
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert text.count("data:image/webp;base64,") == 1
    assert "--width: 30; --height: 20" in text


def test_scenes_of_one_disparity_and_no_step_have_a_range() -> None:
    for disparity in (0.0, 5.0, -2.0):
        scene = scene_of_picture(source_of(np.zeros((4, 5), np.uint8), np.full((4, 5), disparity)), 0.0)
        values = scene_values(scene, Caption("one", "picture", 10, 20))
        assert values["highest"] > values["lowest"] >= values["infinity"]
        assert values["highest"] - values["infinity"] >= 1.0
        assert 0.0 < scene.bounds.right < 5.0


def test_hostile_names_do_not_run(tmp_path: Path) -> None:
    scene = scene_of_picture(source_of(np.zeros((4, 5), np.uint8), np.ones((4, 5))), 1.0)
    write_page(tmp_path / "page.html", scene, Caption(HOSTILE, HOSTILE, 10, 20, (HOSTILE,)))
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "<script>window.stolen" not in text
    with pytest.raises(DvcError, match="cannot write"):
        write_page(tmp_path / "nowhere" / "page.html", scene, Caption("one", "picture", 10, 600))
