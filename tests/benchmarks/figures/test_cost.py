"""Rate against cost: turns, means, and what the page shows of rows."""

from fractions import Fraction
from io import BytesIO
from pathlib import Path

import pytest

from benchmarks.figures.cost import encoder_time, rate_cost, recordings, without_feedback
from benchmarks.figures.harness import Row, Setting, there_and_back
from benchmarks.pictures import cost
from dvc.errors import DvcError
from dvc.video import Frame, VideoInfo
from tests.benchmarks.figures.test_allocation import made_up, with_curves
from tests.clips import moving_texture, same_frame


def test_encoders_are_timed_in_turn() -> None:
    """Each runs once to warm up, and then as often as asked, one after the other."""
    order: list[str] = []
    runs = {name: [lambda one=f"{name}{k}": order.append(one) for k in range(2)] for name in "ab"}
    found = rate_cost.times_ms(runs, 10, 3)
    assert order == ["a0", "a1", "b0", "b1"] * 4
    assert set(found) == {"a", "b"}
    assert all(ms >= 0.0 for ms in found.values())


def test_times_are_medians_of_turns_and_means_of_qualities(monkeypatch: pytest.MonkeyPatch) -> None:
    """A turn that something disturbed does not count."""
    spent = iter([0.0, 5.0, 0.0, 7.0, 0.1, 0.3, 0.2, 0.4, 9.0, 0.5])  # of two qualities, turn by turn
    now = [0.0]
    monkeypatch.setattr(rate_cost.time, "process_time", lambda: now[0])

    def run() -> None:
        now[0] += next(spent)

    found = rate_cost.times_ms({"a": [run, run]}, 100, 4)
    first, second = (0.0, 0.1, 0.2, 9.0), (7.0, 0.3, 0.4, 0.5)
    assert found["a"] == pytest.approx(10 * ((first[1] + first[2]) / 2 + (second[2] + second[3]) / 2) / 2)


@pytest.mark.parametrize("name", ["x264-superfast", rate_cost.ONE_WAY])
def test_frames_are_coded_in_memory(name: str) -> None:
    """Encoders of both kinds make something of the frames, and the same each time."""
    material = rate_cost.Material.read("street", 3)
    assert all(frame.chroma is None for frame in material.frames)
    run = material.one_way_run(40) if name == rate_cost.ONE_WAY else material.anchor_run(name, 40)
    made = []
    for one in (run(), run()):
        assert isinstance(one, list | BytesIO)
        made.append(b"".join(one) if isinstance(one, list) else one.getvalue())
    assert made[0] == made[1]
    assert 100 < len(made[0]) < material.frames[0].luma.size


def test_rates_are_beside_times(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every codec has its time and the BD-rates of its curve; the one to compare with has none of its own."""
    reference, other = made_up([30, 34, 38, 42]), made_up([30, 34, 38, 42], 1.25)
    monkeypatch.setattr(
        rate_cost, "curve", lambda _setting, _clip, name: reference if name == rate_cost.REFERENCE else other
    )
    monkeypatch.setattr(rate_cost.Material, "read", classmethod(lambda cls, _clip, n: cls(None, (None,) * n)))
    monkeypatch.setattr(
        rate_cost, "times_ms", lambda runs, n, turns: {name: float(len(of)) for name, of in runs.items()}
    )
    monkeypatch.setattr(rate_cost.Material, "one_way_run", lambda _self, qp: qp)
    monkeypatch.setattr(rate_cost.Material, "anchor_run", lambda _self, _name, qp: qp)
    names = (rate_cost.REFERENCE, "x264-superfast", rate_cost.ONE_WAY)
    found = rate_cost.rate_cost(Setting(), "made up", names)
    codecs = found.values["codecs"]
    assert codecs[rate_cost.REFERENCE] == {"cost_ms": 5.0, "bd_rate_percent": 0.0, "bd_rate_mse_percent": 0.0}
    assert codecs[rate_cost.ONE_WAY]["cost_ms"] == 4.0
    assert codecs["x264-superfast"]["bd_rate_percent"] == pytest.approx(25.0, abs=0.1)
    assert "3D-TE, no feedback 4.00 ms +25 %" in found.got
    mean = rate_cost.mean_rate_cost(Setting(), "", names)
    assert mean.values["num_clips"] == 5
    assert mean.values["codecs"] == codecs


@pytest.mark.parametrize(
    ("form", "ours_ms", "holds"),
    [("one-way", 1.01, False), ("live", 1.19, True), ("live-long-delay", 1.5, None), ("frames", 9.0, None)],
)
def test_times_are_shares_of_those_of_presets(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, form: str, ours_ms: float, holds: bool | None
) -> None:
    """What a form must reach is a share of the cheap preset with a search; the cheapest is beside it."""
    times = {"ours": ours_ms, "x264-superfast": 1.0, "x264-ultrafast": 0.5}
    monkeypatch.setattr(encoder_time, "times_ms", lambda _runs, _n, _turns: times)
    monkeypatch.setattr(encoder_time, "_record_requests", lambda _material, _form: [])
    material = rate_cost.Material(VideoInfo(48, 32, Fraction(25)), tuple(moving_texture(3, 32, 48)))
    found = encoder_time._compare(Setting(folder=tmp_path), material, form, 9)
    assert found.holds is holds
    assert found.values["ratios"]["x264-ultrafast"] == 2 * ours_ms
    assert f"{ours_ms:.2f} of superfast's" in found.got


def test_requests_of_a_decoder_are_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """They are recorded once, for each video and form."""
    recorded: list[tuple[int, str]] = []

    def _record(material: rate_cost.Material, form: str) -> list[bytes]:
        recorded.append((len(material.frames), form))
        return [b"\x01\x00", b"\xff"]

    monkeypatch.setattr(encoder_time, "_record_requests", _record)
    frames = tuple(moving_texture(3, 32, 48))
    cases = [(3, "live"), (2, "live"), (3, "live-long-delay")]
    for number, form in cases * 2:
        material = rate_cost.Material(VideoInfo(48, 32, Fraction(25)), frames[:number])
        assert encoder_time._requests(Setting(folder=tmp_path), material, form) == [b"\x01\x00", b"\xff"]
    assert recorded == cases


def test_recordings_go_there_and_back() -> None:
    """Neighbours in a recording are neighbours in the clip; a crop keeps colour in place."""
    frames = moving_texture(4, 32, 48)
    order = [next(k for k, one in enumerate(frames) if one is frame) for frame in there_and_back(frames, 9)]
    assert order == [0, 1, 2, 3, 2, 1, 0, 1, 2]
    cropped = recordings._cropped(frames[0], (24, 16))
    luma, (cb, _) = frames[0].luma[8:24, 12:36], frames[0].chroma or ()
    assert same_frame(cropped, Frame(luma, (cb[4:12, 6:18], (frames[0].chroma or ())[1][4:12, 6:18])))


def row(name: str, clip: str, values: dict[str, object]) -> Row:
    return {"area": "cost", "name": name, "clip": clip, "values": values}


def test_page_shows_means_over_the_clips_that_were_measured() -> None:
    """The largest group that has rows is shown, cheapest codec first."""
    codecs = {"x264-superfast": {"cost_ms": 1.0, "bd_rate_percent": 20.0}}
    dear = {"cost_ms": 3.0, "bd_rate_percent": 0.0}
    rows = [
        row("rate-cost-standard", "stone", {"codecs": {"x264-ippp": dear}}),
        row("rate-cost", "tree", {"codecs": {"x264-ippp": dear, **codecs}}),
        row("rate-cost", "box", {"codecs": {name: {**of, "cost_ms": 2.0} for name, of in codecs.items()}}),
    ]
    rows[2]["values"]["codecs"]["x264-ippp"] = {"cost_ms": 6.0, "bd_rate_percent": 0.0}
    points, clips = cost.rate_costs(rows)
    assert clips == ["box", "tree"]
    assert [(one.label, one.cost_ms) for one in points] == [("x264 IPPP, superfast", 1.5), ("x264 IPPP", 4.5)]
    assert all(style.is_open for style in cost.styles(points).values())
    with pytest.raises(DvcError, match="no row of rate against cost"):
        cost.rate_costs([])


def test_live_coding_is_shown_by_the_rows_that_tell_of_it() -> None:
    """Its time is relative to x264 superfast; without rows for all clips it is left out."""
    codecs = {"x264-superfast": {"cost_ms": 2.0, "bd_rate_percent": 20.0}}
    rows = [row("rate-cost", clip, {"codecs": codecs}) for clip in ("box", "tree")]
    rows.append(row("live-cpu", "box", {"ratios": {"x264-superfast": 1.5}}))
    rows.append({**row("te-qp-x264-ippp", "box", {"bd_rate_percent": 4.0}), "area": "allocation"})
    assert [one.label for one in cost.rate_costs(rows)[0]] == ["x264 IPPP, superfast"]
    (_, live), clips = cost.rate_costs([one for one in rows if one["clip"] == "box"])
    assert clips == ["box"]
    assert (live.label, live.cost_ms, live.bd_rate_percent) == ("3D-TE, live", 3.0, 4.0)
    assert not cost.styles([live])["3D-TE, live"].is_open


def test_operations_are_summed() -> None:
    """Stages are means over clips, and the last line their sum."""
    kinds = dict.fromkeys(cost.KINDS, 1.0)
    stages = {"transform": kinds, "planes": {**kinds, "bytes": 4.0}}
    text = cost.operations_table([row("operations", "box", {"operations_per_pixel": stages})])
    assert "| planes | 1.00 | 1.00 | 1.00 | 1.00 | 4.00 |" in text
    assert text.endswith("| all | 2.0 | 2.0 | 2.0 | 2.0 | 5.0 |\n")


def test_parts_of_the_page_are_replaced() -> None:
    """The page has the marks of both parts; text between them is replaced, and nothing else."""
    page = Path("docs/encoder_cost.md").read_text(encoding="utf-8")
    for name in ("operations", "rate against cost"):
        page = cost.with_part(page, name, f"new {name}\n")
        assert f"<!-- {name}: begin -->\nnew {name}\n<!-- {name}: end -->" in page
    assert cost.with_part(page, "operations", "new operations\n") == page
    with pytest.raises(DvcError, match="no marks"):
        cost.with_part(page, "other", "")


def test_no_feedback_is_compared_with_what_was_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """By whole curves: of each clip, and of all."""
    asked, estimated = made_up([30, 34, 38, 42]), made_up([30, 34, 38, 42], 1.1)
    with_curves(monkeypatch, without_feedback, tracked=asked, other=estimated)
    found = without_feedback.over_feedback(Setting(), "made up")
    assert found.values["bd_rate_percent"] == pytest.approx(10.0, abs=0.1)
    assert found.holds
    mean = without_feedback.mean_over_feedback(Setting(), "")
    assert mean.holds
    assert mean.got.startswith("+10.0 % over 5 clips")


def test_concealed_frames_are_counted_and_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of all qualities; at one of them with a stream that has enough for every decoder."""
    estimated = made_up([28, 32, 36])
    for point, failed in zip(estimated.points, (3, 1, 0), strict=True):
        point.frame_rows[1]["num_failed_planes"] = failed
    ample = made_up([32.4]).points
    with_curves(monkeypatch, without_feedback, tracked=estimated, other=estimated)
    monkeypatch.setattr(without_feedback, "measured", lambda _setting, _clip, _points: list(ample))
    without_feedback._concealment.cache_clear()
    found = without_feedback.concealed(Setting(), "box")
    assert found.got == "2 of 6 frames, 33.3 %; 0.40 dB on 1"
    assert not found.holds
    mean = without_feedback.mean_concealed(Setting(), "")
    assert mean.values["concealed_percent"] == pytest.approx(100 / 3)
    assert mean.values["loss_db"] == pytest.approx(0.4)
    without_feedback._concealment.cache_clear()
