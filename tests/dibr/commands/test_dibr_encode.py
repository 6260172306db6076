"""`dvc-dibr`: from pictures to streams, decoded folders, rendered views, and what is refused."""

import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from dvc.dibr.commands import dibr_render as view
from dvc.picture_files import read_pfm
from dvc.video import open_video
from tests.dibr.running import answer, refusal, run
from tests.dibr.scenes import FAR, FOCAL_PX, NEAR, cameras, true_disparity

ENCODE = ("--disparities", "0:8", "--lambda", "2e-3", "--quiet")


def encoded(*options: str, views: tuple[str, ...] = ("a.png", "b.png")) -> bytes:
    assert run("encode", *views, "out.dibr", *ENCODE, *options) == 0
    return Path("out.dibr").read_bytes()


@pytest.mark.parametrize("command", ["info", "evaluate", "view"])
def test_streams_come_through_pipes(
    views: Path, command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    data = encoded()
    monkeypatch.setattr(view, "MAX_PIXELS", 32 * 48 // 4)
    reader, writer = os.pipe()
    with os.fdopen(reader), os.fdopen(writer, "wb") as file:
        file.write(data)
        file.close()
        path = f"/dev/fd/{reader}"
        told = answer(capsys, command, path, *(["--out", "page.html"] if command == "view" else []))
    figures = told[path] if command == "evaluate" else told
    assert figures["scene_bytes" if command == "view" else "stream_bytes"] == len(data)


def test_processes_encode_decode_and_render(views: Path) -> None:
    command = [sys.executable, "-m", "dvc.dibr"]
    steps = (
        "encode a.png b.png pair.dibr --disparities 0:8 --bpp 6 --json encoded.json",
        "decode pair.dibr --out decoded",
        "render pair.dibr --view 1,0 --out right.png --truth b.png --json rendered.json",
        "render pair.dibr --path 0,0 0.5,0 1,0 --frames 3 --out flight.mp4",
        "info pair.dibr",
    )
    for step in steps:
        done = subprocess.run([*command, *step.split()], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert not done.stderr
    assert "quality_layers: 1" in done.stdout
    figures = json.loads((views / "encoded.json").read_text())
    size = (views / "pair.dibr").stat().st_size
    assert figures["stream_bytes"] == size == sum(figures["bits"].values()) / 8
    assert figures["bpp"] == 8 * size / (48 * 32) <= 6.0
    assert figures["disparity_share"] == figures["bits"]["disparity"] / (8 * size)
    disparity = read_pfm(views / "decoded" / "disparity.pfm")
    assert np.mean(np.abs(disparity - true_disparity()) < 0.5) > 0.85
    picture, truth = cv2.imread("decoded/reference.png"), cv2.imread("a.png")
    assert picture is not None
    assert truth is not None
    assert np.abs(picture.astype(int) - truth).mean() < 6.0
    assert json.loads((views / "rendered.json").read_text())["psnr_visible_db"] > 27.0
    with open_video("flight.mp4") as video:
        assert len(list(video)) == 3


def test_help_is_quick() -> None:
    for arguments in (
        ["--help"],
        *([name, "--help"] for name in ("encode", "decode", "render", "info", "view", "evaluate")),
    ):
        command = [sys.executable, "-X", "importtime", "-m", "dvc.dibr", *arguments]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        assert "examples:" in done.stdout
        assert not {"numpy", "cv2", "numba"} & {line.split()[-1] for line in done.stderr.splitlines()}


def test_layers_and_resolutions(views: Path, capsys: pytest.CaptureFixture[str]) -> None:
    encoded("--quality-layers", "3", "--lambda", "5e-4")
    truth = ("--view", "1", "--truth", "b.png")
    psnrs = [
        answer(capsys, "render", "out.dibr", *truth, "--out", "v.png", "--quality-layers", str(k))["psnr_db"]
        for k in (1, 2, 3)
    ]
    assert psnrs == sorted(psnrs)
    small = answer(capsys, "decode", "out.dibr", "--out", "small", "--resolution", "1")
    assert (small["width"], small["height"]) == (24, 16)
    disparity = read_pfm(views / "small" / "disparity.pfm")
    assert disparity.shape == (16, 24)
    assert np.median(disparity) == FAR / 2
    assert np.percentile(disparity, 90) == NEAR / 2


def test_arrays_and_further_references(views: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (views / "views.csv").write_text("file,m,n\na.png,0,0\nb.png,1,0\nc.png,-1,0\n")
    array = ("a.png", "b.png", "c.png")
    by_table = encoded("--views", "views.csv", views=array)
    assert encoded("--lattice", "0,0", "1,0", "-1,0", views=array) == by_table
    alone = answer(capsys, "render", "out.dibr", "--view", "1", "--out", "v.png", "--truth", "b.png")
    encoded("--views", "views.csv", "--references", "b.png", views=array)
    found = answer(capsys, "decode", "out.dibr", "--out", "decoded")
    assert found["references"] == [0, 1]
    names = {path.name for path in (views / "decoded").iterdir()}
    parts = [("reference", "png"), ("disparity", "pfm"), ("preview-disparity", "png")]
    assert names == {"dibr.json", *(f"{part}{n}.{kind}" for part, kind in parts for n in ("", "-1"))}
    both = answer(capsys, "render", "out.dibr", "--view", "1,0", "--out", "v.png", "--truth", "b.png")
    assert both["psnr_db"] > alone["psnr_db"]
    near = ("--view", "0.4,0", "--blend", "nearest", "--out", "n.png")
    assert answer(capsys, "render", "out.dibr", *near)["filled_share"] < 0.05


def test_calibrated_views(views: Path, capsys: pytest.CaptureFixture[str]) -> None:
    entries = cameras("ab", (0, 1))
    (views / "cameras.json").write_text(json.dumps(entries))
    depths = f"{FOCAL_PX / 8:g}:inf"
    options = ("--cameras", "cameras.json", "--depths", depths, "--lambda", "1e-4")
    figures = answer(capsys, "encode", "a.png", "b.png", "out.dibr", *options)
    assert figures["labels"]["num_labels"] == 9
    assert run("decode", "out.dibr", "--out", "decoded", "--quiet") == 0
    inverse_depth = read_pfm(views / "decoded" / "disparity.pfm")
    assert np.mean(np.abs(inverse_depth * FOCAL_PX - true_disparity()) < 0.5) > 0.85
    assert answer(capsys, "info", "out.dibr")["viewpoints"][1]["t"] == [-1.0, 0.0, 0.0]
    truth = ("--view", "1", "--out", "v.png", "--truth", "b.png")
    assert answer(capsys, "render", "out.dibr", *truth)["psnr_visible_db"] > 25.0
    assert "no lattice" in refusal(capsys, "render", "out.dibr", "--view", "1,0", "--out", "w.png")
    cv2.imwrite("small.png", np.zeros((31, 48, 3), np.uint8))
    told = refusal(capsys, "encode", "a.png", "small.png", "new.dibr", *options)
    assert "small.png: 48x31, but a.png is 48x32" in told
    entries[0]["distortion"] = [0.1]
    (views / "cameras.json").write_text(json.dumps(entries))
    assert "lens distortion" in refusal(capsys, "encode", "a.png", "b.png", "new.dibr", *options)


def test_depths_of_known_points(views: Path, capsys: pytest.CaptureFixture[str]) -> None:
    document = {"cameras": cameras("ab", (0, 1)), "points": [[0, 0, FOCAL_PX / NEAR], [1, 0, FOCAL_PX / FAR]]}
    (views / "cameras.json").write_text(json.dumps(document))
    options = ("--cameras", "cameras.json", "--lambda", "1e-3")
    labels = answer(capsys, "encode", "a.png", "b.png", "out.dibr", *options)["labels"]
    assert 0.8 * FAR < FOCAL_PX * labels["lowest"] < FAR
    highest = labels["lowest"] + labels["step"] * (labels["num_labels"] - 1)
    assert NEAR < FOCAL_PX * highest < 1.2 * NEAR
    (views / "cameras.json").write_text(json.dumps(document["cameras"]))
    assert "--depths" in refusal(capsys, "encode", "a.png", "b.png", "new.dibr", *options)


def test_gray_pictures_cost_no_chroma(views: Path) -> None:
    picture = cv2.imread("a.png", cv2.IMREAD_GRAYSCALE), cv2.imread("b.png", cv2.IMREAD_GRAYSCALE)
    for name, gray in zip(("g", "h"), picture, strict=True):
        assert gray is not None
        cv2.imwrite(f"{name}.png", gray)
        cv2.imwrite(f"{name}16.png", gray.astype(np.uint16) * 257)
    on_demand = encoded("--gray")
    assert encoded(views=("g.png", "h.png")) == encoded(views=("g16.png", "h16.png"))
    assert abs(len(encoded(views=("g.png", "h.png"))) - len(on_demand)) < 0.1 * len(on_demand)
    assert run("decode", "out.dibr", "--out", "decoded", "--quiet") == 0
    decoded = cv2.imread("decoded/reference.png", cv2.IMREAD_UNCHANGED)
    assert decoded is not None
    assert decoded.ndim == 2


def test_a_cut_stream_gives_what_is_whole(views: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = encoded("--quality-layers", "2", "--disparity", "blocks", "--lambda", "2e-2")
    sizes = [layer["bytes"] for layer in answer(capsys, "info", "out.dibr")["layers"]]
    first = len(data) - sizes[1]
    for end in (*range(0, first, 16), first - 1, first, first + 1, len(data) - 1):
        (views / "cut.dibr").write_bytes(data[:end])
        whole = end >= first
        assert run("render", "cut.dibr", "--view", "1", "--out", "v.png", "--quiet") == (0 if whole else 2)
        (line,) = capsys.readouterr().err.splitlines()
        assert "cut.dibr" in line
        assert ("layer 2 of 2" in line) == whole
        assert (views / "v.png").exists() == whole
    assert answer(capsys, "info", "cut.dibr")["damage"].startswith("layer 2 of 2")


REFUSED = {
    "sizes": ("a.png small.png o.dibr --disparities 0:8 --bpp 1", "48x31"),
    "reference": ("a.png b.png o.dibr --disparities 0:8 --bpp 1 --references c.png", "c.png is not among"),
    "rate": ("a.png b.png o.dibr --disparities 0:8 --bpp 0.1", "too few"),
    "not a number": ("a.png b.png o.dibr --disparities 0:8 --bpp nan", "nan"),
    "memory": ("big.png also.png o.dibr --disparities 0:4000 --bpp 1", "GiB"),
    "missing": ("a.png none.png o.dibr --disparities 0:8 --bpp 1", "none.png"),
    "input": ("a.png b.dibr b.dibr --disparities 0:8 --bpp 1", "also an input"),
    "no stream": ("a.png b.png c.png --disparities 0:8 --bpp 1", "end in .dibr"),
    "one view": ("a.png o.dibr --disparities 0:8 --bpp 1", "requires two or more views"),
    "places": ("a.png b.png c.png o.dibr --disparities 0:8 --bpp 1", "--lattice"),
    "disparities": ("a.png b.png o.dibr --bpp 1", "--disparities"),
    "kinds": ("a.png b.png o.dibr --cameras x.json --disparities 0:8 --bpp 1", "--depths"),
    "depths": ("a.png b.png o.dibr --depths 2:1 --bpp 1", "NEAR < FAR"),
    "small lambda": ("a.png b.png o.dibr --disparities 0:8 --lambda 1e-9", "lambda from 1e-08 to 10"),
    "large lambda": ("a.png b.png o.dibr --disparities 0:8 --lambda 11", "lambda from 1e-08 to 10"),
    "depths of arrays": ("a.png b.png o.dibr --depths 1:2 --disparities 0:8 --bpp 1", "--cameras"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_views_are_refused(views: Path, case: str, capsys: pytest.CaptureFixture[str]) -> None:
    cv2.imwrite("small.png", np.zeros((31, 48, 3), np.uint8))
    cv2.imwrite("big.png", np.zeros((400, 600), np.uint8))
    cv2.imwrite("also.png", np.zeros((400, 600), np.uint8))
    arguments, told = REFUSED[case]
    assert told in refusal(capsys, "encode", *arguments.split())


def test_bad_requests_are_refused(views: Path, capsys: pytest.CaptureFixture[str]) -> None:
    encoded()
    assert "DIBR" in refusal(capsys, "decode", "a.png", "--out", "decoded")
    assert "quality layers" in refusal(capsys, "decode", "out.dibr", "--out", "d", "--quality-layers", "2")
    assert "resolution 9" in refusal(capsys, "decode", "out.dibr", "--out", "d", "--resolution", "9")
    view = ("render", "out.dibr", "--out", "v.png")
    assert "0 to 1" in refusal(capsys, *view, "--view", "2")
    assert "number of a view" in refusal(capsys, *view, "--view", "x")
    assert ".png" in refusal(capsys, "render", "out.dibr", "--out", "v.jpg", "--view", "1")
    assert "at least two" in refusal(capsys, "render", "out.dibr", "--out", "v.mp4", "--path", "1,0")
    assert "also an input" in refusal(capsys, "render", "out.dibr", "--out", "out.dibr", "--view", "1")
    assert "must end in" in refusal(capsys, "render", "none.dibr", "--out", "v.avi", "--path", "0", "1")


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (2, 2), (21, 33)])
@pytest.mark.parametrize("method", ["l", "s", "quadtree", "blocks"])
def test_any_size(views: Path, shape: tuple[int, int], method: str) -> None:
    picture = np.full((*shape, 3), 77, np.uint8)
    cv2.imwrite("s.png", picture)
    cv2.imwrite("t.png", picture)
    encoded("--disparity", method, "--quality-layers", "2", "--lambda", "1e-6", views=("s.png", "t.png"))
    assert run("render", "out.dibr", "--view", "0.5,0", "--out", "v.png", "--quiet") == 0
    rendered = cv2.imread("v.png")
    assert rendered is not None
    np.testing.assert_allclose(rendered.astype(float), picture, atol=1.0)
