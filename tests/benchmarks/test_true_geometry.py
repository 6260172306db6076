"""P-type frames drawn by true geometry: original frames give the frame, and a run prints a row."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks import true_geometry
from benchmarks.true_geometry import Row, draw, measure, table
from dvc.metrics import psnr_db
from dvc.wynerziv.transform import to_uint8
from sequences.sequence import RenderedSequence


def test_true_geometry_draws_the_frame() -> None:
    """From originals nothing is left but sampling and what they do not show; depth that is wrong is worse."""
    views = list(RenderedSequence("stairway", 96, 80, num_frames=9).rendered())
    lumas = {k: view.frame.luma for k, view in enumerate(views)}
    drawn = draw(views, lumas, (0, 3), 8)
    wrong = draw([replace(view, depth=np.full_like(view.depth, 9.0)) for view in views], lumas, (0, 3), 8)
    assert psnr_db(lumas[8], to_uint8(drawn)) > 30.0
    assert np.abs(wrong - lumas[8]).mean() > 2.5 * np.abs(drawn - lumas[8]).mean()


def test_table_has_a_row_a_scene() -> None:
    """With the means of its frames."""
    lines = table({"a": {8: Row(20.0, 22.0, 30.0), 16: Row(22.0, 24.0, 31.0)}}).splitlines()
    assert lines[1].split() == ["a", "2", "21.00", "23.00", "30.50"]


def test_a_run_draws_p_type_frames_once_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first P-type frame has no scene yet; the second has."""
    monkeypatch.setattr("encoder.intra_decision.MAX_LOST_SHARE", np.inf)
    monkeypatch.setattr("benchmarks.p_type_prediction.REACH_PX", 4)
    rows = measure(RenderedSequence("stairway", 128, 96, num_frames=17), 26)
    assert list(rows) == [16]
    assert rows[16].true_geometry > 20.0
    assert rows[16].block_motion > rows[16].used


def test_a_scene_that_does_not_exist_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    """In one line, with those that there are."""
    with pytest.raises(SystemExit):
        true_geometry.main(["street", "moon"])
    assert "no scenes moon, but street" in capsys.readouterr().err
