"""Pages of the viewer without a browser: what they hold once, and names that cannot run."""

import base64
from pathlib import Path

import numpy as np
import pytest

from dvc.dibr.viewer_page import Caption, scene_values, write_page
from dvc.dibr.viewer_scene import scene_of_picture, source_of
from dvc.errors import DvcError

HOSTILE = '"></script><script>window.stolen = 1</script>'


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
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert text.count("data:image/webp;base64,") == 1
    assert "--width: 30; --height: 20" in text


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
