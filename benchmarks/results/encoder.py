"""Costs of encoding: processor time compared with x264 in the same run, operations a pixel, memory."""

import statistics
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

from benchmarks.results.harness import (
    STATIC_CLIPS,
    Measured,
    Setting,
    clip_source,
    mean_of,
    report_of,
    run_module,
    there_and_back,
)
from dvc.config import DEFAULT_QP
from dvc.rd.anchors import ANCHOR_CODECS
from dvc.video import create_video, open_video

FRAMES, QUICK_FRAMES = 49, 9
LENGTHS, QUICK_LENGTHS = (33, 241), (9, 33)
REPETITIONS = 3
CLIPS = (*STATIC_CLIPS, "cube")
ANCHORS = ("x264-superfast", "x264-superfast-no-asm")
OURS = "no-feedback"
_FEW_FRAMES, _MANY_FRAMES = 50, 1000
_DECODED_FRAMES, _DECODED_QP = (25, 250), 40
MIB = 2**20


def _encode(source: Path, folder: Path, frames: int, *options: object) -> dict[str, Any]:
    report = folder / "encoder.json"
    words = [source, folder / "stream.dvc", "--frames", frames, *options]
    run_module("encoder", *words, "--json", report, "--quiet")
    return report_of(report)


def own_cpu_s(report: dict[str, Any]) -> float:
    """Return the processor time of the encoder without reading the input and starting."""
    return float(report["coding_cpu_s"])


def anchor_cpu_s(source: Path, folder: Path, anchor: str, frames: int) -> float:
    """Return the processor time of a standard codec at the usual quality, without reading the input."""
    report, stream = folder / "anchor.json", folder / f"anchor{ANCHOR_CODECS[anchor].suffix}"
    words = ["encode", source, stream, "--codec", anchor, "--qp", DEFAULT_QP]
    run_module("dvc.rd.anchors", *words, "--frames", frames, "--json", report)
    return float(report_of(report)["coding_cpu_s"])


def later_frames_ms(cpu_s: Callable[[int], float], lengths: tuple[int, int]) -> float:
    """Return the processor time of a frame after the first ones, which pay for loading compiled code, too."""
    short, long = (cpu_s(frames) for frames in lengths)
    return 1000.0 * (long - short) / (lengths[1] - lengths[0])


def anchor_frame_ms(video: Path, folder: Path, setting: Setting) -> float:
    """Return the processor time of x264 superfast for a frame of a clip that is played again and again."""
    lengths = setting.choose(LENGTHS, QUICK_LENGTHS)
    looped_video = looped(video, folder / "looped.mkv", lengths[1])
    run = partial(anchor_cpu_s, looped_video, folder, ANCHORS[0])
    return statistics.median(later_frames_ms(run, lengths) for _ in range(REPETITIONS))


@cache
def times_ms(setting: Setting) -> dict[str, dict[str, float]]:
    """Run encoders in turn, again and again; return medians of the times of a frame by clip."""
    lengths, folder = setting.choose(LENGTHS, QUICK_LENGTHS), setting.scratch("encoder")
    found: dict[str, dict[str, float]] = {}
    for clip in setting.clips(CLIPS):
        video = looped(clip_source(clip).path, folder / f"{clip}.mkv", lengths[1])
        runs: dict[str, Callable[[int], float]] = {
            OURS: lambda frames, video=video: own_cpu_s(_encode(video, folder, frames, "--no-feedback")),  # type: ignore[misc]
            **{anchor: partial(anchor_cpu_s, video, folder, anchor) for anchor in ANCHORS},
        }
        times: dict[str, list[float]] = {name: [] for name in runs}
        for _ in range(setting.choose(REPETITIONS, 1)):
            for name, run in runs.items():
                times[name].append(later_frames_ms(run, lengths))
        found[clip] = {name: statistics.median(values) for name, values in times.items()}
    return found


def time_over(setting: Setting, anchor: str) -> Measured:
    """Compare the encoder without feedback with x264, one thread each."""
    times = times_ms(setting)
    ours, theirs = (statistics.fmean(one[name] for one in times.values()) for name in (OURS, anchor))
    note = (
        f"{ours:.2f} and {theirs:.2f} ms a frame; clips forth and back, frames {LENGTHS[0]} to {LENGTHS[1]}"
    )
    return mean_of({clip: one[OURS] / one[anchor] for clip, one in times.items()}, LENGTHS[1], note)


def operations(setting: Setting) -> Measured:
    """Count operations a pixel without key frames, by the model that tests compare with the kernels."""
    frames, found = int(setting.choose(FRAMES, QUICK_FRAMES)), {}
    for clip in setting.clips(CLIPS):
        report = _encode(clip_source(clip).path, setting.scratch("encoder"), frames, "--no-feedback")
        stages = report["operations_per_pixel"].values()
        found[clip] = sum(number for stage in stages for kind, number in stage.items() if kind != "bytes")
    return mean_of(found, frames)


def own_memory_mib(setting: Setting) -> Measured:
    """Take the peak of the encoder's memory beyond Python, libraries and compiled code."""
    frames, found = int(setting.choose(FRAMES, QUICK_FRAMES)), {}
    for clip in setting.clips(CLIPS):
        report = _encode(clip_source(clip).path, setting.scratch("encoder"), frames, "--no-feedback")
        found[clip] = report["memory"]["own_bytes"] / MIB
    return mean_of(found, frames)


def looped(source: Path, path: Path, num_frames: int, period: int = 25) -> Path:
    """Write a long video that plays the first frames of a short one forwards and backwards."""
    with open_video(source, num_frames=period) as reader:
        frames, info = list(reader), reader.info
    with create_video(path, info.size, info.frame_rate) as writer:
        for frame in there_and_back(frames, num_frames):
            writer.write(frame)
    return path


def memory_growth(setting: Setting) -> Measured:
    """Code a short and a long video, and return the growth of memory in percent."""
    folder = setting.scratch("memory")
    peaks: dict[str, list[int]] = {}
    small = folder / "small.mkv"
    run_module("sequences", "render", "street", "--size", "96x80", "--frames", 25, "--out", small)
    for name, counts in (
        ("encoder", (_FEW_FRAMES, setting.choose(_MANY_FRAMES, 100))),
        ("decoder", setting.choose(_DECODED_FRAMES, (9, 17))),
    ):
        for num_frames in counts:
            video, stream = folder / "video.mkv", folder / "stream.dvc"
            if name == "encoder":
                looped(clip_source(setting.clips(("box", "street"))[0]).path, video, num_frames)
                usage = run_module("encoder", video, stream, "--no-feedback", "--quiet")
            else:
                looped(small, video, num_frames)
                run_module("encoder", video, stream, "--qp", _DECODED_QP, "--quiet")
                usage = run_module("decoder", stream, folder / "decoded.mkv", "--quiet")
            peaks.setdefault(name, []).append(usage.peak_bytes)
    growth = {name: 100.0 * (long / short - 1.0) for name, (short, long) in peaks.items()}
    notes = [f"{name} {short / MIB:.0f} and {long / MIB:.0f} MiB" for name, (short, long) in peaks.items()]
    return Measured(max(growth.values()), growth, None, "; ".join(notes))
