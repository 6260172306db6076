"""Sweeps as they are asked for, and the points that they mean."""

import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.config import DiscoverMatrix
from dvc.errors import ConfigError
from dvc.rd.specification import (
    INTRA,
    USUAL_QPS,
    Point,
    Sweep,
    build_sweep,
    expand,
    parse_numbers,
    parse_options,
    read_spec,
)


@pytest.mark.parametrize(
    ("text", "numbers"),
    [("4", (4,)), ("1-3", (1, 2, 3)), ("8,1-2,2", (8, 1, 2)), ("2-8:3", (2, 5, 8)), (" 1 , 3 ", (1, 3))],
)
def test_numbers_are_read_in_order_and_once(text: str, numbers: tuple[int, ...]) -> None:
    assert parse_numbers(text, 1, 8) == numbers


@pytest.mark.parametrize(
    "text", ["", "0", "9", "3-1", "1-9", "a", "1,,2", "-1", "1-3:0", "1.5", "99999999999"]
)
def test_other_numbers_are_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="expected numbers from 1 to 8"):
        parse_numbers(text, 1, 8)


@given(st.text(max_size=20))
def test_any_text_is_numbers_or_refused(text: str) -> None:
    try:
        numbers = parse_numbers(text, 1, 8)
    except ConfigError:
        return
    assert numbers
    assert all(1 <= number <= 8 for number in numbers)


@pytest.mark.parametrize("word", ["wz-q=3", "quiet", "=x", "--coder=turbo", "Turbo", "json=x"])
def test_options_of_the_experiment_itself_are_refused(word: str) -> None:
    with pytest.raises(ConfigError, match="cannot be given"):
        parse_options([word])


def test_encoder_options_name_everything() -> None:
    options = parse_options(["seed=2", "adaptive"])
    assert options == (("adaptive", "true"), ("seed", "2"))
    point = Point("clip", "2d", 3, "auto", 4, 5, 7, luma_only=True, options=options)
    assert " ".join(point.encoder_options()) == (
        "--codec 2d --gop 4 --key-qp auto --start 5 --wz-q 3 --frames 7 --luma-only --adaptive --seed 2"
    )


def test_anchors_have_the_qps_of_the_sweep_and_their_own() -> None:
    """They have the distance of intra frames instead of a group, 0 if only the first is intra."""
    anchors = ("intra", "x264-ippp", "x264-ippp-16")
    sweep = Sweep(("clip",), "2d", wz_q=(1, 8), anchors=anchors, anchor_qp=(20, 44), luma_only=True)
    points = [point for point in sweep.points() if point.codec != "2d"]
    qps = ["20", str(DiscoverMatrix(8).key_qp), str(DiscoverMatrix(1).key_qp), "44"]
    found = [(point.codec, point.gop, point.key_qp) for point in points]
    gops = {INTRA: 1, "x264-ippp": 0, "x264-ippp-16": 16}
    assert found == [(codec, gop, qp) for codec, gop in gops.items() for qp in qps]
    assert all(point.wz_q is None for point in points)


def test_qualities_take_the_place_of_presets() -> None:
    """Either of the two; with neither, the usual qualities; anchors have the QPs of their key frames."""
    sweep = Sweep(("clip",), "2d", qp=(24, 36), anchors=("intra",), anchor_qp=(30,))
    points = list(sweep.points())
    assert [(point.wz_q, point.qp) for point in points[:2]] == [(None, 24), (None, 36)]
    assert all(point.has_wyner_ziv for point in points[:2])
    assert "--qp 24" in " ".join(points[0].encoder_options())
    assert "--wz-q" not in points[0].encoder_options()
    assert [point.key_qp for point in points[2:]] == ["24", "30", "36"]
    assert [point.qp for point in Sweep(("clip",)).points()] == list(USUAL_QPS)
    assert points[0].to_dict()["qp"] == 24
    assert "qp" not in points[2].to_dict()


@pytest.mark.parametrize(
    ("options", "points"),
    [
        ({"codec": "2d", "wz_q": (1, 2), "key_qp": ("40", "30")}, [(1, None, "40"), (2, None, "30")]),
        ({"gop": 1, "key_qp": ("30",)}, [(None, None, "30")]),
        ({"gop": 1, "key_qp": ("30", "34")}, [(None, None, "30"), (None, None, "34")]),
        ({"gop": 1, "qp": (22, 26)}, [(None, 22, "auto"), (None, 26, "auto")]),
    ],
)
def test_levels_and_key_qps_make_points(options: dict[str, Any], points: list[tuple[Any, ...]]) -> None:
    found = list(Sweep(("clip",), **options).points())
    assert [(point.wz_q, point.qp, point.key_qp) for point in found] == points
    assert any(point.has_wyner_ziv for point in found) == (options.get("gop") != 1)


def test_points_of_several_sweeps_are_listed_once() -> None:
    sweeps = [
        Sweep(("clip",), "2d", wz_q=(1, 2), anchors=("intra",)),
        Sweep(("clip",), "2d", wz_q=(2, 3), anchors=("intra",)),
    ]
    points = expand(sweeps)
    assert len(points) == len(set(points))
    assert sum(point.wz_q == 2 for point in points) == 1


@pytest.mark.parametrize(
    ("given_values", "message"),
    [
        ({}, "at least one sequence"),
        ({"sequences": ["a"], "codec": "4d"}, "`codec` must be one of"),
        ({"sequences": ["a"], "wz_q": "1-9"}, "expected numbers from 1 to 8"),
        ({"sequences": ["a"], "wz_q": [1.5]}, "`wz_q` must be a list"),
        ({"sequences": []}, "`sequences` must be a list"),
        ({"sequences": ["a"], "wz_q": [1], "qp": [30]}, "either qualities"),
        ({"sequences": ["a"], "qp": "0"}, "from 1 to 51"),
        ({"sequences": ["a"], "key_qp": [30, 31, 32], "wz_q": [1, 2]}, "3 key QPs for 2 matrices"),
        ({"sequences": ["a"], "key_qp": [30, 31, 32], "qp": [1, 2], "gop": 1}, "3 key QPs for 2 qualities"),
        ({"sequences": ["a"], "gop": 0}, "`gop`: Expected `int` >= 1"),
        ({"sequences": ["a"], "luma_only": "yes"}, "`luma_only`: Expected `bool`, got `str`"),
        ({"sequences": ["a"], "anchors": ["jpeg"]}, "the anchor must be one of"),
        ({"sequences": ["a"], "options": {"wz-q": 3}}, "cannot be given"),
        ({"sequences": ["a"], "options": 3}, "`options`: Expected `array`"),
        ({"sequences": ["a"], "side_information": 3}, "`side_information`: Expected `str | null`"),
        ({"sequences": ["a"], "side_information": "--json"}, "cannot be given"),
    ],
)
def test_senseless_sweeps_are_refused(given_values: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(message)):
        build_sweep(given_values)


def test_spec_merges_defaults(tmp_path: Path) -> None:
    path = tmp_path / "sweep.toml"
    path.write_text(
        '[defaults]\nframes = 9\nsequences = ["a"]\n[[sweep]]\nwz_q = "1-2"\n'
        "[[sweep]]\nwz_q = [4]\nframes = 5\noptions = { adaptive = true, seed = 3 }\n",
        encoding="utf-8",
    )
    first, second = (build_sweep(fields) for fields in read_spec(path))
    assert (first.frames, first.wz_q) == (9, (1, 2))
    assert (second.frames, second.wz_q) == (5, (4,))
    assert second.options == (("adaptive", "true"), ("seed", "3"))


@pytest.mark.parametrize(
    "text",
    [
        "[[sweep]\n",
        "sweep = 3\n",
        "[[sweep]]\nspeed = 1\n",
        "[other]\n",
        "",
        "sweep = [1]\n",
        "defaults = 1\n",
        f"[[sweep]]\nstart = {'9' * 5000}\n",
        f"x = {'[' * 20000}",
    ],
)
def test_other_specs_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "sweep.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=r"sweep\.toml"):
        read_spec(path)


@pytest.mark.parametrize(
    ("codec", "wz_q", "options", "length"),
    [
        ("3d-te", (), {}, 8),
        ("3d-te", (), {"references": "keys"}, 8),
        ("3d-te", (), {"key-frames": "intra"}, 16),
        ("3d-te", (4,), {}, 16),
        ("3d-te", (4,), {"intra-period": "30"}, 8),
        ("3d", (), {}, 2),
        ("3d", (4,), {}, 2),
    ],
)
def test_a_sweep_has_the_groups_of_its_codec(
    codec: str, wz_q: tuple[int, ...], options: dict[str, str], length: int
) -> None:
    """Without a length the points have that of the encoder, which depends on references and key frames."""
    sweep = Sweep(("clip",), codec=codec, wz_q=wz_q, options=tuple(options.items()))
    assert {point.gop for point in sweep.points()} == {length}


def test_side_information_is_an_option_of_the_decoder() -> None:
    """The method goes to the decoder, and is in the options of a point only if one was chosen."""
    plain, mesh = (
        next(iter(build_sweep({"sequences": ["clip"], "side_information": method}).points()))
        for method in (None, "mesh")
    )
    assert (plain.decoder_options(), mesh.decoder_options()) == ([], ["--side-information", "mesh"])
    assert mesh.to_dict() == {**plain.to_dict(), "side_information": "mesh"}
    assert plain.encoder_options() == mesh.encoder_options()


def test_streams_without_feedback_are_options_of_points() -> None:
    sweep = build_sweep({"sequences": ["clip"], "qp": "28,34", "no_feedback": True, "options": {"seed": 2}})
    assert [point.options for point in sweep.points()] == [(("no-feedback", "true"), ("seed", "2"))] * 2
    assert all(point.no_feedback for point in sweep.points())
    assert "--no-feedback" in next(iter(sweep.points())).encoder_options()
    assert not any(point.no_feedback for point in Sweep(("clip",)).points())


def test_the_file_that_the_document_shows_is_read(tmp_path: Path) -> None:
    text = (Path(__file__).resolve().parents[2] / "docs" / "rd.md").read_text(encoding="utf-8")
    (shown,) = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    path = tmp_path / "sweep.toml"
    path.write_text(shown, encoding="utf-8")
    first, second = map(build_sweep, read_spec(path))
    assert (first.qp, first.sequences, first.frames) == ((26, 32, 38), ("box", "clip.y4m"), 49)
    assert (second.codec, second.wz_q, second.options) == ("2d", (1, 4, 8), (("noise-model", "band"),))
    assert first.anchors == second.anchors == ("x264-medium",)
