"""`dvc-dibr encode` of layers and sprites: streams, which are decoded, rendered, shown; refusals."""

from pathlib import Path

import pytest

from dvc.dibr.depth_image.piece_encoder import encode_to_size
from dvc.dibr.depth_image.scene_pieces import read_pieces
from tests.dibr.piece_scenes import plane_layers
from tests.dibr.running import answer, refusal, run

pytestmark = pytest.mark.usefixtures("pieces")


@pytest.mark.parametrize("kind", ["layers", "sprites"])
def test_folders_are_coded_decoded_rendered_and_shown(kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    told = answer(capsys, "encode", kind, "a.dibr", "--bpp", "8")
    assert told["stream_bytes"] == Path("a.dibr").stat().st_size <= 40 * 60
    assert sum(told["bits"].values()) == 8 * told["stream_bytes"]
    assert told["psnr_image_db"] > 35
    assert told["psnr_disparity_db"] is None or told["psnr_disparity_db"] > 30
    known = answer(capsys, "info", "a.dibr")
    assert known["bits"] == told["bits"]
    assert (known["kind"], known["num_pieces"]) == (kind, told["num_pieces"])
    assert run("info", "a.dibr") == 0
    assert kind in capsys.readouterr().out
    assert run("decode", "a.dibr", "--out", "d", "--quiet") == 0
    values = [[one.num_values for one in read_pieces(folder).pieces] for folder in ("d", kind)]
    assert values[0] == values[1]
    view = ("--view", Path("position").read_text(), "--truth", "view.png")
    rendered = answer(capsys, "render", "a.dibr", *view, "--out", "out.png")
    assert rendered["psnr_db"] > 28
    assert run("render", "a.dibr", "--path", "0,0", "1,0", "--frames", "2", "--out", "p.y4m", "--quiet") == 0
    page = answer(capsys, "view", "a.dibr", "--out", "p.html", "--truth", f"{view[1]}=view.png")
    assert rendered["psnr_db"] in page["psnr_db"]
    assert run("view", "d", "--out", "q.html", "--quiet") == 0


def test_a_cut_stream_is_used_with_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    data = encode_to_size(plane_layers(), 2400).data
    Path("cut.dibr").write_bytes(data[: len(data) // 2])
    for number, command in enumerate(
        (["decode", "--out", "d", "--quiet"], ["render", "--view", "0,0", "--out", "o.png", "--quiet"])
    ):
        assert run(command[0], "cut.dibr", *command[1:]) == 0
        (line,) = capsys.readouterr().err.splitlines()
        assert "ends after" in line, number
    assert "ends after" in answer(capsys, "info", "cut.dibr")["damage"]
    Path("none.dibr").write_bytes(data[:40])
    for command in (["decode", "--out", "e"], ["render", "--view", "0,0", "--out", "e.png"], ["info"]):
        refusal(capsys, command[0], "none.dibr", *command[1:])


def test_what_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    Path("empty").mkdir()
    bpp = ("--bpp", "1")
    assert "layers.json" in refusal(capsys, "encode", "empty", "o.dibr", *bpp)
    inside = ("--json", "layers/layers.json")
    assert "is also an input" in refusal(capsys, "encode", "layers", "o.dibr", *bpp, *inside)
    assert ".dibr" in refusal(capsys, "encode", "layers", "o.png", *bpp)
    assert "masks take" in refusal(capsys, "encode", "layers", "o.dibr", "--bpp", "0.1")
    Path("a.dibr").write_bytes(encode_to_size(plane_layers(), 2400).data)
    assert "require views" in refusal(capsys, "decode", "a.dibr", "--out", "d", "--resolution", "1")
    assert "quality-layers" in refusal(capsys, "view", "a.dibr", "--out", "p.html", "--quality-layers", "1")
    assert "view 1" in refusal(capsys, "render", "a.dibr", "--view", "1", "--out", "o.png")


@pytest.mark.parametrize("bpp", ["1e9", "1e308"])
def test_any_rate_is_accepted(bpp: str, capsys: pytest.CaptureFixture[str]) -> None:
    told = answer(capsys, "encode", "sprites", "a.dibr", "--bpp", bpp, "--keep", "all")
    assert told["psnr_image_db"] is None or told["psnr_image_db"] > 50
