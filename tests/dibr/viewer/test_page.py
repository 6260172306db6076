"""Pages of the viewer without a browser: disparities in few bytes, and names that cannot run."""

import base64
import zlib
from pathlib import Path

import numpy as np
import pytest

from dvc.dibr.viewer.page import Caption, disparity_codes, pack_codes, scene_values, write_page
from dvc.dibr.viewer.scene import Piece, scene_of_picture, source_of
from dvc.errors import DvcError

HOSTILE = '"></script><script>window.stolen = 1</script>'


def unpacked(data: bytes, shape: tuple[int, int]) -> np.ndarray:
    """Undo `pack_codes` as the page does: running sums of high and low bytes."""
    high, low = np.frombuffer(zlib.decompress(data), np.uint8).reshape(2, *shape).astype(np.int64)
    return np.cumsum(256 * high + low, axis=1) & 0xFFFF


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e6])
def test_disparities_survive_to_sixteen_bits(scale: float) -> None:
    """Codes give the disparities back to half a step of their range, and 0 is outside the mask."""
    rng = np.random.default_rng(3)
    disparity = scale * rng.normal(size=(7, 9))
    mask = rng.random((7, 9)) < 0.8
    codes, lowest, unit = disparity_codes(Piece(np.zeros((7, 9, 3), np.uint8), disparity, mask))
    found = unpacked(pack_codes(codes), codes.shape)
    np.testing.assert_array_equal(found > 0, mask)
    error = np.abs(lowest + (found[mask] - 1) * unit - disparity[mask])
    assert error.max() <= 0.51 * unit
    assert unit == pytest.approx(np.ptp(disparity[mask]) / 65534)


@pytest.mark.parametrize("mask", [np.zeros((2, 3), np.bool_), np.ones((2, 3), np.bool_)])
def test_constant_and_absent_disparities(mask: np.ndarray) -> None:
    """One disparity needs no range, and none at all is all zero."""
    codes, lowest, unit = disparity_codes(Piece(np.zeros((2, 3, 3), np.uint8), np.full((2, 3), 4.0), mask))
    np.testing.assert_array_equal(codes, mask)
    assert unit > 0.0
    assert lowest == (4.0 if mask.any() else 0.0)


def test_picture_of_the_first_piece_is_there_once(tmp_path: Path) -> None:
    """The page shows it before it draws, and takes its colours from there."""
    rng = np.random.default_rng(4)
    picture = rng.integers(0, 256, (20, 30, 3)).astype(np.uint8)
    scene = scene_of_picture(source_of(picture, np.ones((20, 30))), 1.0)
    values = scene_values(scene, Caption("one", "picture", 10, 600))
    assert values["sources"][0]["pieces"][0]["picture"] is None
    assert values["highest"] > values["lowest"] > values["infinity"]
    assert len(base64.b64decode(values["palette"])) == 768
    write_page(tmp_path / "page.html", scene, Caption("one", "picture", 10, 600))
    assert (tmp_path / "page.html").read_text(encoding="utf-8").count("data:image/webp;base64,") == 1


def test_scenes_of_one_disparity_and_no_step_have_a_range() -> None:
    """Programs divide by what lies between the largest disparity and infinity."""
    for disparity in (0.0, 5.0, -2.0):
        scene = scene_of_picture(source_of(np.zeros((4, 5), np.uint8), np.full((4, 5), disparity)), 0.0)
        values = scene_values(scene, Caption("one", "picture", 10, 20))
        assert values["highest"] > values["lowest"] >= values["infinity"]
        assert values["highest"] - values["infinity"] >= 1.0
        assert 0.0 < scene.bounds.right < 5.0


def test_hostile_names_do_not_run(tmp_path: Path) -> None:
    """Markup in a title or a note is text."""
    scene = scene_of_picture(source_of(np.zeros((4, 5), np.uint8), np.ones((4, 5))), 1.0)
    write_page(tmp_path / "page.html", scene, Caption(HOSTILE, HOSTILE, 10, 20, (HOSTILE,)))
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "<script>window.stolen" not in text
    with pytest.raises(DvcError, match="cannot write"):
        write_page(tmp_path / "nowhere" / "page.html", scene, Caption("one", "picture", 10, 600))
