"""`dvc-dibr evaluate`: streams of both kinds beside each other, and what is refused."""

from dataclasses import replace
from pathlib import Path

import cv2
import pytest

from dvc.dibr.commands.dibr_decode import lines_of
from dvc.dibr.depth_image.depth_image_stream import decode_stream, encode_stream
from tests.dibr.running import answer, refusal, run
from tests.dibr.scenes import texture

pytestmark = pytest.mark.usefixtures("maps")


def test_streams_of_maps_are_told(capsys: pytest.CaptureFixture[str]) -> None:
    encoded = answer(capsys, "encode", "gray.png", "a.dibr", "--depth", "map.pfm", "--bpp", "1")
    assert run("encode", "map.pfm", "b.dibr", "--bpp", "0.3", "--quiet") == 0
    truth = ["--truth-depth", "map.pfm", "--truth-image", "gray.png"]
    found = answer(capsys, "evaluate", "a.dibr", "b.dibr", *truth)
    assert list(found) == ["a.dibr", "b.dibr"]
    for name in ("stream_bytes", "bpp", "bits", "psnr_depth_db", "psnr_image_db", "edge_elements"):
        assert found["a.dibr"][name] == encoded[name]
    assert "psnr_image_db" not in found["b.dibr"]
    assert found["b.dibr"]["bits"]["image"] == 0


def test_streams_of_views_stand_beside_them(views: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--disparities", "0:9", "--lambda", "1e-3", "--quiet"]
    assert run("encode", "a.png", "b.png", "v.dibr", *options) == 0
    found = answer(capsys, "evaluate", "v.dibr", "--truth-image", "a.png")["v.dibr"]
    assert sum(found["bits"].values()) == 8 * Path("v.dibr").stat().st_size
    assert found["bits"]["depth"] > 0
    assert found["psnr_image_db"] > 25
    assert "--truth-depth" in refusal(capsys, "evaluate", "v.dibr", "--truth-depth", "map.pfm")


def test_a_table_is_printed_and_damage_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("encode", "map.pfm", "b.dibr", "--bpp", "0.3", "--quiet") == 0
    whole = Path("b.dibr").read_bytes()
    Path("b.dibr").write_bytes(whole[:-20])
    capsys.readouterr()
    assert run("evaluate", "b.dibr", "--truth-depth", "map.pfm") == 0
    out, err = capsys.readouterr()
    assert "| b.dibr |" in out
    assert err.count("\n") == 1
    assert "ends after" in err
    assert run("evaluate", "b.dibr") == 0
    assert "--truth-image and --truth-depth add PSNR" in capsys.readouterr().err


def test_mistakes_are_told_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("encode", "map.pfm", "b.dibr", "--bpp", "0.3", "--quiet") == 0
    cv2.imwrite("small.png", texture(32, 40))
    streams = ["evaluate", "b.dibr"]
    assert "40x32" in refusal(capsys, *streams, "--truth-depth", "small.png")
    assert "40x32" in refusal(capsys, *streams, "--truth-image", "small.png")
    assert "picture.png" in refusal(capsys, "evaluate", "picture.png")


def test_several_rates_of_layers_make_a_curve(pieces: None, capsys: pytest.CaptureFixture[str]) -> None:
    names = []
    for kind, rate in (("layers", 8), ("layers", 2), ("layers", 4), ("sprites", 4), ("sprites", 8)):
        names.append(f"{kind}-{rate}.dibr")
        assert run("encode", kind, names[-1], "--bpp", str(rate), "--keep", "all", "--quiet") == 0
    capsys.readouterr()
    Path("curves").mkdir()  # an empty folder will do
    found = answer(capsys, "evaluate", *names, "--truth-image", "reference.png", "--out", "curves")
    for name in names:
        assert found[name]["kind"] in name
        assert sum(found[name]["bits"].values()) == 8 * Path(name).stat().st_size
    lines = {line.label: line for line in lines_of(found, "psnr_image_db")}
    assert list(lines) == ["layers", "sprites"]
    for line, number in zip(lines.values(), (3, 2), strict=True):
        assert list(line.xs) == sorted(line.xs)
        assert list(line.ys) == sorted(line.ys)
        assert len(line.xs) == number
    assert sorted(path.name for path in Path("curves").iterdir()) == [
        "index.html", "picture.png", "picture.svg", "streams.json", "streams.md",
    ]  # fmt: skip
    assert "not an empty folder" in refusal(capsys, "evaluate", *names, "--out", "curves")
    assert "| layers-2.dibr |" in Path("curves/streams.md").read_text()
    assert "--truth-depth" in refusal(capsys, "evaluate", *names, "--truth-depth", "map.pfm")


def test_damage_is_named_by_its_file(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("encode", "map.pfm", "b.dibr", "--bpp", "0.3", "--quiet") == 0
    stream = decode_stream(Path("b.dibr").read_bytes())
    Path("bad.dibr").write_bytes(encode_stream(replace(stream, edges=b"\xff" * 40)))
    assert refusal(capsys, "evaluate", "b.dibr", "bad.dibr", "--out", "o", "--quiet").count("bad.dibr: ") == 1
