"""Evaluation of disparity maps: the rule, files, the command and its refusals."""

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.errors import ConfigError
from dvc.picture_files import read_picture, write_pfm
from dvc.stereo.__main__ import main
from dvc.stereo.evaluation import (
    disparity_error,
    evaluate,
    read_mask,
    read_truth,
    reported,
    sparsification,
    summary,
)
from tests.stereo.data import check_refused
from tests.stereo.plane_scenes import LABELS, SCENE, reconstruction_of, square_lattice

TRUTH = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, np.nan]])


def write_case(folder: Path) -> tuple[Path, Path]:
    """Write a map of six pixels and its truth, times 4 in 8 bits: errors 0, 1, 1.25, none, 0.5, unknown."""
    found = np.array([[1.0, 3.0, 4.25], [np.nan, 4.5, 9.0]], np.float32)
    write_pfm(folder / "map.pfm", found)
    cv2.imwrite(str(folder / "truth.png"), np.nan_to_num(TRUTH * 4).astype(np.uint8))
    return folder / "map.pfm", folder / "truth.png"


def test_mask_chooses_pixels() -> None:
    mask = np.zeros(TRUTH.shape, np.bool_)
    mask[1] = True
    error, counted = disparity_error(TRUTH + 3.0, TRUTH, mask)
    assert counted.sum() == 2
    assert error[counted].tolist() == [3.0, 3.0]
    assert not error[~counted].any()


def test_sparsification_is_the_mean_over_all_shares() -> None:
    bad = np.array([True, False, True, False])
    ideal = 100.0 * (0 + 0 + 1 / 3 + 1 / 2) / 4
    assert sparsification(bad, np.array([0.1, 0.9, 0.2, 0.8])) == pytest.approx((ideal, ideal))
    worst = 100.0 * (1 + 1 + 2 / 3 + 1 / 2) / 4
    assert sparsification(bad, np.array([200, 20, 255, 0], np.uint8)) == pytest.approx((worst, ideal))
    assert sparsification(bad, np.zeros(4)) == pytest.approx((50.0, ideal))


def test_confidence_is_judged_by_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found, truth = write_case(tmp_path)
    cv2.imwrite(str(tmp_path / "sure.png"), np.array([[9, 8, 255], [0, 7, 255]], np.uint8))
    options = ["--truth", str(truth), "--truth-scale", "4", "--thresholds", "1"]
    assert main(["evaluate", str(found), *options, "--confidence", str(tmp_path / "sure.png")]) == 0
    area, ideal = 20.0 * (1 + 1 / 2 + 1 / 3 + 1 / 4 + 2 / 5), 20.0 * (1 / 4 + 2 / 5)
    assert f"area by confidence > 1 px {area:.2f} % (ideal {ideal:.2f})" in capsys.readouterr().out


@given(st.floats(0.0, 5.0), st.floats(0.01, 5.0))
def test_a_shift_is_its_own_error(shift: float, threshold: float) -> None:
    """A map that is off by a constant has that mean error, and is all good or all bad."""
    truth = np.full((4, 5), 7.0)
    result = evaluate(truth + shift, truth, thresholds=(threshold,))
    assert result.mean_absolute_error_px == pytest.approx(shift, abs=1e-9)
    assert result.bad_percent[threshold] in (0.0, 100.0)


def test_nothing_to_count_and_other_sizes_are_refused() -> None:
    with pytest.raises(ConfigError, match="no pixel counts"):
        evaluate(TRUTH, np.full(TRUTH.shape, np.nan))
    with pytest.raises(ConfigError, match="truth is 2x2, but the disparity map is 3x2"):
        evaluate(TRUTH, np.ones((2, 2)))
    with pytest.raises(ConfigError, match="mask is 2x2"):
        evaluate(TRUTH, TRUTH, np.ones((2, 2), np.bool_))


def test_truth_of_every_kind(tmp_path: Path) -> None:
    levels = np.array([[0, 8], [40, 255]])
    cv2.imwrite(str(tmp_path / "a.png"), levels.astype(np.uint8))
    cv2.imwrite(str(tmp_path / "b.png"), (levels * 100).astype(np.uint16))
    write_pfm(tmp_path / "c.pfm", np.array([[0.0, -2.5], [np.inf, 1.0]], np.float32))
    a = read_truth(tmp_path / "a.png", 8.0)
    np.testing.assert_array_equal(a, [[np.nan, 1.0], [5.0, 31.875]])
    np.testing.assert_array_equal(read_truth(tmp_path / "b.png", 100.0, -16.0, None), levels - 16.0)
    np.testing.assert_array_equal(read_truth(tmp_path / "a.png", 1.0, 0.0, 255.0), [[0, 8], [40, np.nan]])
    np.testing.assert_array_equal(read_truth(tmp_path / "c.pfm"), [[np.nan, -2.5], [np.nan, 1.0]])
    np.testing.assert_array_equal(read_truth(tmp_path / "c.pfm", unknown=None)[0], [0.0, -2.5])
    np.testing.assert_array_equal(read_mask(tmp_path / "a.png"), levels == 255)


def test_command_prints_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An error of the threshold itself is good; a pixel without a value is bad, and not in the mean."""
    found, truth = write_case(tmp_path)
    arguments = ["evaluate", str(found), "--truth", str(truth), "--truth-scale", "4"]
    assert main([*arguments, "--thresholds", "0.5,1,2", "--json", "-"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["bad_percent"] == {"0.5": 60.0, "1": 40.0, "2": 20.0}
    assert printed["mean_absolute_error_px"] == pytest.approx(2.75 / 4)
    assert (printed["num_pixels"], printed["num_without_value"]) == (5, 1)


def test_command_prints_a_line_and_draws(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found, truth = write_case(tmp_path)
    drawn, figures = tmp_path / "error.png", tmp_path / "figures.json"
    arguments = ["evaluate", "--truth-scale", "4", str(found), "--truth", str(truth)]
    assert main([*arguments, "--error-map", str(drawn), "--json", str(figures)]) == 0
    assert "40.00 % > 1 px" in capsys.readouterr().out
    picture = read_picture(drawn)
    assert (picture[0, 0] == 255).all()
    assert picture[0, 2].tolist() == picture[1, 0].tolist()
    assert picture[0, 2, 0] > 2 * picture[0, 2, 1]
    assert json.loads(figures.read_text())["num_pixels"] == 5


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (["--truth", "none.png"], "none.png: No such file or directory"),
        (["--truth", "colour.png"], "expected grey levels"),
        (["--truth-scale", "0"], "must be positive"),
        (["--truth-scale", "inf"], "expected a number"),
        (["--thresholds", "1,x"], "expected a number"),
        (["--thresholds=-1,2"], "expected thresholds"),
        (["--mask", "small.png"], "the mask is 2x2, but the disparity map is 3x2"),
        (["--mask", "map.pfm"], "not a picture"),
        (["--truth-unknown", "x"], "expected a number"),
        (["--json", "nowhere/x.json"], "its folder does not exist"),
        (["--error-map", "map.pfm"], "is also an input"),
        (["--confidence", "small.png"], "not an eight-bit grey picture of 3x2"),
    ],
)
def test_bad_input_is_one_line(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    changes: list[str],
    message: str,
) -> None:
    write_case(tmp_path)
    cv2.imwrite(str(tmp_path / "small.png"), np.full((2, 2), 255, np.uint8))
    cv2.imwrite(str(tmp_path / "colour.png"), np.uint8([[[1, 2, 3]]]))
    before = sorted(tmp_path.iterdir())
    monkeypatch.chdir(tmp_path)
    arguments = ["evaluate", "map.pfm", "--truth", "truth.png", "--truth-scale", "4", *changes]
    check_refused(capsys, message, *arguments)
    assert sorted(tmp_path.iterdir()) == before


def test_bad_pixels_are_reported_at_three_thresholds() -> None:
    reconstruction = reconstruction_of(SCENE, square_lattice(1), LABELS)
    truth = reconstruction.surfaces[reconstruction.array.reference].disparity
    off = np.repeat([0.4, 0.8, 1.5, 3.0], truth.size // 4).reshape(truth.shape)
    output = summary(reported(reconstruction, (truth + off, None)))
    found = re.findall(r"([\d.]+) % > ([\d.]+) px", output)
    assert found == [("75.00", "0.5"), ("50.00", "1"), ("25.00", "2")]
    assert "bad pixels" not in summary(reported(reconstruction))
