"""`dvc-dibr view`: pages of streams and folders, what they tell, and what is refused."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from dvc.dibr.__main__ import main
from dvc.dibr.commands import dibr_render as view
from tests.dibr.running import answer, refusal, run


@pytest.fixture
def stream(views: Path) -> str:
    """Write a stream of two views."""
    options = ("--disparities", "0:8", "--lambda", "2e-3", "--quiet")
    assert main(["encode", "a.png", "b.png", "pair.dibr", *options]) == 0
    return "pair.dibr"


def scene_of(page: str) -> dict[str, Any]:
    text = Path(page).read_text(encoding="utf-8")
    found: dict[str, Any] = json.loads(text.split('id="scene">', 1)[1].split("</script>", 1)[0])
    return found


def test_page_is_one_file_that_loads_nothing(stream: str, capsys: pytest.CaptureFixture[str]) -> None:
    figures = answer(capsys, "view", stream, "--out", "page.html")
    text = Path("page.html").read_text(encoding="utf-8")
    assert figures["page_bytes"] == len(text.encode())
    assert figures["scene_bytes"] == Path(stream).stat().st_size
    assert figures["sources"] == figures["pieces"] == 1
    assert f"{figures['bpp']:.4f} bits per pixel" in text
    assert "default-src &#39;none&#39;" in text
    assert re.findall(r'(?:src|href)="(?!data:)', text) == []
    assert "http:" not in text
    assert "https:" not in text
    assert scene_of("page.html")["views"] == [{"m": float(m), "n": 0.0, "psnr_db": None} for m in (0, 1)]


def test_quality_is_that_of_rendered_views(stream: str, capsys: pytest.CaptureFixture[str]) -> None:
    wanted = []
    for place, truth in (("0", "a.png"), ("1", "b.png"), ("-1,0", "c.png")):
        options = ("--view", place, "--out", "view.png", "--truth", truth)
        wanted.append(answer(capsys, "render", stream, *options)["psnr_db"])
    truths = ("--truth", "a.png", "b.png", "-1,0=c.png")
    assert run("view", stream, "--out", "page.html", *truths, "--quiet") == 0
    assert capsys.readouterr().out == ""
    assert [place["psnr_db"] for place in scene_of("page.html")["views"]] == wanted
    assert run("view", stream, "--out", "page.html", "--truth", "1=b.png") == 0
    text = rf"page\.html: \d+ bytes, 1 source; PSNR {wanted[1]:.2f} dB\n"
    assert re.fullmatch(text, capsys.readouterr().out)
    assert [place["psnr_db"] for place in scene_of("page.html")["views"]] == [None, wanted[1]]


@pytest.mark.parametrize("name", ["layers", "sprites"])
def test_folders_of_layers_and_sprites(
    name: str, pieces: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    figures = answer(capsys, "view", name, "--out", "page.html")
    assert figures["sources"] == 1
    assert figures["pieces"] >= 2
    assert (figures["width"], figures["height"]) == (60, 40)
    assert 0 < figures["scene_bytes"] < sum(path.stat().st_size for path in Path(name).iterdir())
    monkeypatch.setattr(view, "MAX_PIXELS", 1000)
    assert "1000 at most" in refusal(capsys, "view", name, "--out", "large.html")


def test_damaged_streams_are_shown_as_far_as_they_go(stream: str, capsys: pytest.CaptureFixture[str]) -> None:
    options = ("--disparities", "0:8", "--lambda", "2e-3", "--quiet", "--quality-layers", "3")
    assert run("encode", "a.png", "b.png", "layers.dibr", *options) == 0
    data = Path("layers.dibr").read_bytes()
    Path("cut.dibr").write_bytes(data[:-5])
    assert run("view", "cut.dibr", "--out", "page.html", "--quiet") == 0
    assert capsys.readouterr().err.count("\n") == 1
    assert "The stream is damaged" in Path("page.html").read_text(encoding="utf-8")
    assert run("view", "layers.dibr", "--out", "page.html", "--quality-layers", "2", "--quiet") == 0
    assert "2 of 3 quality layers" in Path("page.html").read_text(encoding="utf-8")


def test_large_streams_are_shown_smaller(
    stream: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ("view", stream, "--out", "page.html", "--truth", "a.png")
    whole = answer(capsys, *options)
    monkeypatch.setattr(view, "MAX_PIXELS", 32 * 48 // 4)
    smaller = answer(capsys, *options)
    assert (smaller["width"], smaller["height"]) == (24, 16)
    assert (smaller["bpp"], smaller["psnr_db"]) == (whole["bpp"], whole["psnr_db"])
    assert smaller["bounds"] == whole["bounds"]
    assert "2 times shorter" in Path("page.html").read_text(encoding="utf-8")
    scene = scene_of("page.html")
    assert scene["highest"] < 5.0, "disparities are in pixels that are twice as large"


def test_refusals(stream: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "broken.dibr").write_bytes(Path(stream).read_bytes()[:20])
    (tmp_path / "layers").mkdir()
    (tmp_path / "layers" / "layers.json").write_text("{}")
    page = ("--out", "page.html")
    assert "nowhere.dibr" in refusal(capsys, "view", "nowhere.dibr", *page)
    assert "broken.dibr" in refusal(capsys, "view", "broken.dibr", *page)
    assert "layers.json" in refusal(capsys, "view", "empty", *page)
    assert "layers.json" in refusal(capsys, "view", "layers", *page)
    assert "folder" in refusal(capsys, "view", stream, "--out", "missing/page.html")
    assert ".html" in refusal(capsys, "view", stream, "--out", "page.txt")
    assert "require a stream" in refusal(capsys, "view", "empty", *page, "--truth", "a.png")
    assert "2 views" in refusal(capsys, "view", stream, *page, "--truth", "a.png", "b.png", "c.png")
    assert "two pictures" in refusal(capsys, "view", stream, *page, "--truth", "a.png", "0,0=b.png")
    assert "view 7" in refusal(capsys, "view", stream, *page, "--truth", "7=a.png")
    assert "nothing.png" in refusal(capsys, "view", stream, *page, "--truth", "nothing.png")
    assert "quality layers" in refusal(capsys, "view", stream, *page, "--quality-layers", "9")
