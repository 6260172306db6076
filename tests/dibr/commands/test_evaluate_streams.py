"""`dvc-dibr evaluate --streams`: streams of both kinds beside each other, and what is refused."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from dvc.pfm import write_pfm
from dvc.picture_files import write_png
from tests.dibr.commands.running import answer, refusal, run
from tests.dibr.depth_maps import texture, two_discs
from tests.dibr.plane_views import planes

DISCS = two_discs(64, 80)


@pytest.fixture(autouse=True)
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Write a map and its picture; work there."""
    monkeypatch.chdir(tmp_path)
    write_pfm("map.pfm", DISCS.astype(np.float32))
    cv2.imwrite("picture.png", texture(64, 80))


def test_streams_of_maps_are_told(capsys: pytest.CaptureFixture[str]) -> None:
    """Figures are those that the encoder and the decoder tell."""
    encoded = answer(
        capsys, "encode-image", "picture.png", "--depth", "map.pfm", "a.dibr", "--bpp", "1", "--gray"
    )
    assert run("encode-depth", "map.pfm", "b.dibr", "--bpp", "0.3", "--quiet") == 0
    truth = ["--truth-depth", "map.pfm", "--truth-image", "picture.png"]
    found = answer(capsys, "evaluate", "--streams", "a.dibr", "b.dibr", *truth)
    assert list(found) == ["a.dibr", "b.dibr"]
    for name in ("stream_bytes", "bpp", "bits", "psnr_depth_db", "psnr_image_db", "edge_elements"):
        assert found["a.dibr"][name] == encoded[name]
    assert "psnr_image_db" not in found["b.dibr"]
    assert found["b.dibr"]["bits"]["image"] == 0


def test_streams_of_views_stand_beside_them(capsys: pytest.CaptureFixture[str]) -> None:
    """Bits of a stream of views add up, too; its picture is that of the reference."""
    for view in planes(64, 80):
        write_png(Path(f"{view.name}.png"), np.ascontiguousarray(view.image[:, :, ::-1]))
    options = ["--disparities", "0:9", "--slope", "1e-3", "--quiet"]
    assert run("encode", "left.png", "right.png", "v.dibr", *options) == 0
    found = answer(capsys, "evaluate", "--streams", "v.dibr", "--truth-image", "left.png")["v.dibr"]
    assert sum(found["bits"].values()) == 8 * Path("v.dibr").stat().st_size
    assert found["bits"]["depth"] > 0
    assert found["psnr_image_db"] > 25
    assert "--truth-depth" in refusal(capsys, "evaluate", "--streams", "v.dibr", "--truth-depth", "map.pfm")


def test_a_table_is_printed_and_damage_told(capsys: pytest.CaptureFixture[str]) -> None:
    """A stream that ends early is decoded as far as it goes, and said to be."""
    assert run("encode-depth", "map.pfm", "b.dibr", "--bpp", "0.3", "--quiet") == 0
    whole = Path("b.dibr").read_bytes()
    Path("b.dibr").write_bytes(whole[:-20])
    capsys.readouterr()
    assert run("evaluate", "--streams", "b.dibr", "--truth-depth", "map.pfm") == 0
    out, err = capsys.readouterr()
    assert "| b.dibr |" in out
    assert err.count("\n") == 1
    assert "ends after" in err


def test_mistakes_are_told_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    """Sizes, options of chapters, and files that are no streams."""
    assert run("encode-depth", "map.pfm", "b.dibr", "--bpp", "0.3", "--quiet") == 0
    cv2.imwrite("small.png", texture(32, 40))
    streams = ["evaluate", "--streams", "b.dibr"]
    assert "40x32" in refusal(capsys, *streams, "--truth-depth", "small.png")
    assert "40x32" in refusal(capsys, *streams, "--truth-image", "small.png")
    assert "--out: not for --streams" in refusal(capsys, *streams, "--out", "o")
    assert "--rates: not for --streams" in refusal(capsys, *streams, "--rates", "1")
    assert "picture.png" in refusal(capsys, "evaluate", "--streams", "picture.png")
