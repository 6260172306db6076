"""`dvc-dibr encode` of depth maps and pictures with depth: streams, folders out, refusals."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from dvc.dibr.depth_image.depth_image_stream import decode_stream, encode_stream
from dvc.picture_files import read_pfm, write_pfm
from tests.dibr.running import answer, refusal, run
from tests.dibr.scenes import two_discs

DISCS = two_discs(64, 80)


pytestmark = pytest.mark.usefixtures("maps")


def test_maps_are_coded_and_decoded(capsys: pytest.CaptureFixture[str]) -> None:
    told = answer(capsys, "encode", "map.pfm", "out.dibr", "--bpp", "0.3")
    assert told["stream_bytes"] == Path("out.dibr").stat().st_size <= 0.3 * 64 * 80 / 8
    assert sum(told["bits"].values()) == 8 * told["stream_bytes"]
    found = answer(capsys, "decode", "out.dibr", "--out", "d", "--truth-depth", "map.pfm")
    assert found["psnr_depth_db"] == pytest.approx(told["psnr_depth_db"], abs=1e-9)
    error = read_pfm("d/depth.pfm") - DISCS
    psnr = 10 * np.log10(np.ptp(DISCS.astype(np.float32)) ** 2 / np.mean(error**2))
    assert psnr == pytest.approx(told["psnr_depth_db"], abs=1e-3)
    assert psnr > 38
    assert {path.name for path in Path("d").iterdir()} == {
        "depth.pfm", "disparity.pfm", "preview-disparity.png", "edges.png", "dibr.json",
    }  # fmt: skip


def test_edges_of_a_folder_code_the_map_again(capsys: pytest.CaptureFixture[str]) -> None:
    first = answer(capsys, "encode", "map.pfm", "a.dibr", "--bpp", "0.3")
    assert run("decode", "a.dibr", "--out", "d", "--quiet") == 0
    second = answer(capsys, "encode", "map.pfm", "b.dibr", "--bpp", "0.3", "--edges", "d/edges.png")
    assert Path("a.dibr").read_bytes() == Path("b.dibr").read_bytes()
    assert second["edge_elements"] == first["edge_elements"] > 100


def test_transforms_and_edges_differ_as_they_should(capsys: pytest.CaptureFixture[str]) -> None:
    quality = {
        name: answer(capsys, "encode", "map.pfm", "out.dibr", "--bpp", "0.35", *options)["psnr_depth_db"]
        for name, options in {
            "auto": (),
            "canny": ("--edges", "canny"),
            "none": ("--edges", "none"),
            "standard": ("--transform", "standard"),
            "5/3": ("--wavelet", "5/3"),
            "cubic": ("--order-depth", "3"),
        }.items()
    }
    assert quality["auto"] > quality["standard"] + 4
    assert quality["canny"] > quality["standard"]
    assert quality["none"] == quality["standard"]
    assert min(quality["5/3"], quality["cubic"]) > quality["standard"]


@pytest.mark.parametrize(("name", "factor"), [("map8.png", 4), ("map16.png", 1024)])
def test_holes_of_levels_are_filled(name: str, factor: float, capsys: pytest.CaptureFixture[str]) -> None:
    told = answer(capsys, "encode", name, "out.dibr", "--bpp", "0.4")
    assert told["psnr_depth_db"] > 35
    assert run("decode", "out.dibr", "--out", "d", "--quiet") == 0
    inside = read_pfm("d/depth.pfm")[31:33, 61:65] / factor
    assert np.abs(inside - DISCS[31:33, 61:65]).max() < 3


def test_zeros_are_depths_where_that_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    for folder, options in (("a", ("--no-holes",)), ("b", ("--near-far", "2:50"))):
        assert run("encode", "map8.png", "out.dibr", "--bpp", "0.6", "--quiet", *options) == 0
        assert run("decode", "out.dibr", "--out", folder, "--quiet") == 0
        assert np.abs(read_pfm(f"{folder}/depth.pfm")[31:33, 61:65]).max() < 15
        told = answer(capsys, "encode", "map8.png", "out.dibr", "--bpp", "0.6", *options)
        for name, is_same in (("--no-holes", True), ("--hole=0", False)):
            out = ("--out", f"{folder}{name}", "--truth-depth", "map8.png", name)
            found = answer(capsys, "decode", "out.dibr", *out)
            assert (found["psnr_depth_db"] == pytest.approx(told["psnr_depth_db"], abs=1e-9)) is is_same
    disparity = read_pfm("b/disparity.pfm")
    depth = read_pfm("b/depth.pfm")
    np.testing.assert_allclose(disparity, depth / 255 * (1 / 2 - 1 / 50) + 1 / 50, atol=1e-6)


def test_a_picture_with_its_map_is_rendered_and_looked_at(capsys: pytest.CaptureFixture[str]) -> None:
    depth = ("--depth", "map8.png", "--depth-scale", "0.05")
    told = answer(capsys, "encode", "picture.png", "out.dibr", *depth, "--bpp", "3")
    assert told["depth_share"] == pytest.approx(0.2, abs=0.02)
    assert told["psnr_image_db"] > 35
    found = answer(capsys, "info", "out.dibr")
    assert found["bits"] == told["bits"]
    assert found["colour"]
    view = ("--view", "0,0", "--out", "v.png", "--truth", "picture.png")
    rendered = answer(capsys, "render", "out.dibr", *view)
    assert rendered["psnr_db"] == pytest.approx(told["psnr_image_db"], abs=0.2)
    assert answer(capsys, "render", "out.dibr", "--view", "1,0", "--out", "v.png")["filled_share"] > 0.01
    assert run("view", "out.dibr", "--out", "page.html", "--quiet") == 0
    truth = ("--truth-image", "picture.png", "--truth-depth", "map8.png")
    decoded = answer(capsys, "decode", "out.dibr", "--out", "d", *truth)
    assert decoded["psnr_image_db"] == told["psnr_image_db"]
    assert cv2.imread("d/image.png").shape == (64, 80, 3)


def test_disparities_wider_than_the_picture_are_told(capsys: pytest.CaptureFixture[str]) -> None:
    for options, told in ((("map16.png",), "map16.png: disparities of up to "), (("map.pfm",), "")):
        words = ["encode", "picture.png", "out.dibr", "--depth", *options, "--bpp", "1", "--quiet"]
        assert run(*words) == 0
        line = capsys.readouterr().err
        assert told in line
        assert line.count("\n") == bool(told)


def test_gray_and_automatic_shares(capsys: pytest.CaptureFixture[str]) -> None:
    options = ("--depth", "map.pfm", "--bpp", "2", "--gray", "--depth-share", "auto")
    told = answer(capsys, "encode", "picture.png", "out.dibr", *options)
    assert 0.01 < told["depth_share"] < 0.7
    assert not answer(capsys, "info", "out.dibr")["colour"]


def test_a_cut_stream_decodes_with_a_warning(capsys: pytest.CaptureFixture[str]) -> None:
    told = answer(capsys, "encode", "map.pfm", "out.dibr", "--bpp", "0.5")
    data = Path("out.dibr").read_bytes()
    Path("cut.dibr").write_bytes(data[:-30])
    capsys.readouterr()
    assert run("decode", "cut.dibr", "--out", "d", "--quiet") == 0
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{len(data) - 30} of {told['stream_bytes']} bytes" in line
    assert sum(answer(capsys, "info", "cut.dibr")["bits"].values()) == 8 * (len(data) - 30)


def test_the_rate_may_be_more_than_anything_needs(capsys: pytest.CaptureFixture[str]) -> None:
    write_pfm("small.pfm", DISCS[:8, :8].astype(np.float32))
    for rate in ("1e13", "1e308"):
        told = answer(capsys, "encode", "small.pfm", "out.dibr", "--bpp", rate, "--edges", "none")
        assert told["stream_bytes"] < 1000
        assert told["psnr_depth_db"] > 60


def test_flat_scenes_have_pages(capsys: pytest.CaptureFixture[str]) -> None:
    write_pfm("flat.pfm", np.full((64, 80), 5.0, np.float32))
    assert run("encode", "picture.png", "out.dibr", "--depth", "flat.pfm", "--bpp", "1", "--quiet") == 0
    bounds = answer(capsys, "view", "out.dibr", "--out", "page.html")["bounds"]
    assert 0.0 < bounds["right"] < 80.0


def test_damaged_edges_are_told_with_the_file(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("encode", "map.pfm", "out.dibr", "--bpp", "1", "--quiet", "--edges", "canny") == 0
    stream = decode_stream(Path("out.dibr").read_bytes())
    damaged = replace(stream, edges=b"\xff" * 40)
    Path("damaged.dibr").write_bytes(encode_stream(damaged))
    for command in (("info", "damaged.dibr"), ("decode", "damaged.dibr", "--out", "d")):
        assert "damaged.dibr: " in refusal(capsys, *command)


def test_refusals(capsys: pytest.CaptureFixture[str]) -> None:
    depth = ("encode", "map.pfm", "out.dibr", "--bpp")
    assert "too few" in refusal(capsys, *depth, "0.01")
    assert "shape-adaptive" in refusal(capsys, *depth, "1", "--transform", "standard", "--edges", "canny")
    assert "--near-far" in refusal(capsys, *depth, "1", "--near-far", "1:2")
    assert "NEAR < FAR" in refusal(capsys, *depth, "1", "--near-far", "2:1")
    assert "levels 0, 85" in refusal(capsys, *depth, "1", "--edges", "map8.png")
    assert "expected a picture of edges" in refusal(capsys, *depth, "1", "--edges", "map.pfm")
    assert ".dibr" in refusal(capsys, "encode", "map.pfm", "out.png", "--bpp", "1")
    image = ("encode", "picture.png", "out.dibr", "--depth", "map.pfm", "--bpp", "1")
    assert "between 0 and 1" in refusal(capsys, *image, "--depth-share", "1.5")
    cv2.imwrite("small.png", np.zeros((8, 8), np.uint8))
    assert "empty" in refusal(capsys, "encode", "small.png", "out.dibr", "--bpp", "1")
    assert "8x8" in refusal(capsys, "encode", "small.png", "o.dibr", "--depth", "map.pfm", "--bpp", "1")
    assert run(*depth, "0.5", "--quiet") == 0
    assert "without a picture" in refusal(capsys, "render", "out.dibr", "--view", "0,0", "--out", "v.png")
    assert "--quality-layers" in refusal(capsys, "decode", "out.dibr", "--out", "d", "--quality-layers", "1")
    assert "only" in refusal(capsys, "decode", "out.dibr", "--out", "d", "--truth-image", "picture.png")
    assert "empty" in refusal(capsys, "decode", "out.dibr", "--out", "d", "--truth-depth", "small.png")
