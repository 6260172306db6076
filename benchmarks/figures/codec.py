"""Speed, start-up and memory of the encoder and the decoder."""

import filecmp
import json
import os
import statistics
import tempfile
import time
from itertools import cycle, islice
from pathlib import Path
from typing import Any

from benchmarks.figures.harness import FOREMAN, Figure, Measured, Setting, clip_source, run_module
from dvc.config import key_qp_for

FINEST = 8
CIF_CLIPS = ("box", "desk", "river", "stone", "tree", "cube", "street", "stairway", "statue")
LOOP_FRAMES = 25


def encode(clip: str, stream: Path, *options: object) -> dict[str, Any]:
    """Encode luma in a fresh process."""
    report = stream.with_suffix(".encoder.json")
    source = clip_source(clip).path.absolute()
    run_module("encoder", [source, stream, "--luma-only", "--quiet", "--json", report, *options])
    values: dict[str, Any] = json.loads(report.read_text(encoding="utf-8"))
    return values


def decode_time(setting: Setting, clip: str, limit_s: float) -> Measured:
    """Time the decoding of Wyner-Ziv frames at the finest quantiser on one core."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for frames in (3, setting.choose(21, 5)):
            encode(clip, folder / "s.dvc", "--codec", "2d", "--wz-q", FINEST, "--frames", frames)
            arguments = [
                folder / "s.dvc",
                folder / "v.y4m",
                "--quiet",
                "--jobs",
                1,
                "--json",
                folder / "d.json",
            ]
            usage = run_module("decoder", arguments)
        report = json.loads((folder / "d.json").read_text(encoding="utf-8"))
    times_s = [frame["decode_s"] for frame in report["per_frame"] if frame["type"] == "wz"][1:]
    mean_s = statistics.fmean(times_s)
    values = {"mean_s": mean_s, "max_s": max(times_s), "num_frames": len(times_s)}
    values |= {"process_cpu_s": usage.cpu_s, "process_wall_s": usage.wall_s}
    return Measured(f"{mean_s:.2f} s (slowest {max(times_s):.2f} s)", mean_s <= limit_s, values)


def decode_jobs(setting: Setting, clip: str) -> Measured:
    """Compare one and two decoding processes: time, and every byte of what they write."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        quantiser, frames = setting.choose(FINEST, 1), setting.choose(61, 9)
        encode(clip, folder / "s.dvc", "--codec", "2d", "--wz-q", quantiser, "--frames", frames)
        walls_s = {}
        for jobs in (1, 2):
            outputs = [folder / f"{jobs}.y4m", "--punctured", folder / f"{jobs}.dvc"]
            walls_s[jobs] = run_module(
                "decoder", [folder / "s.dvc", *outputs, "--quiet", "--jobs", jobs]
            ).wall_s
        same = all(
            filecmp.cmp(folder / f"1{end}", folder / f"2{end}", shallow=False) for end in (".y4m", ".dvc")
        )
    speedup = walls_s[1] / walls_s[2]
    cores = len(os.sched_getaffinity(0))
    values = {"wall_1_s": walls_s[1], "wall_2_s": walls_s[2], "same_bytes": same, "num_cores": cores}
    times = f"{walls_s[1]:.1f} s and {walls_s[2]:.1f} s"
    text = f"{speedup:.2f} times ({times}), {'same' if same else 'OTHER'} bytes"
    return Measured(text, same and speedup >= 1.7, values, f"{cores} cores; start-up included")


def encode_cpu(setting: Setting, clip: str) -> Measured:
    """Compare the processor time of a Wyner-Ziv frame with that of H.264 intra on the same frames."""
    from dvc.config import CodecConfig, KeyFrameConfig, VideoConfig, WynerZivConfig
    from dvc.keyframes import KeyFrameEncoder
    from dvc.video import open_video
    from encoder.wyner_ziv import WynerZivEncoder

    num_frames = setting.choose(40, 6)
    with open_video(clip_source(clip).path, num_frames=num_frames) as reader:
        frames = [frame.without_chroma() for frame in reader]
        video = VideoConfig(reader.info.width, reader.info.height, 25, 1, luma_only=True)
    qp = key_qp_for(FINEST)
    config = CodecConfig("2d", video, key=KeyFrameConfig(qp), wyner_ziv=WynerZivConfig.preset(FINEST))
    wyner_ziv, intra = WynerZivEncoder(config), KeyFrameEncoder(video.width, video.height, qp, luma_only=True)
    times_ms: dict[str, list[float]] = {"wz": [], "intra": []}
    for frame in frames:
        started = time.process_time()
        wyner_ziv.encode(frame).buffered_payload()
        between = time.process_time()
        intra.encode(frame)
        times_ms["wz"].append(1000 * (between - started))
        times_ms["intra"].append(1000 * (time.process_time() - between))
    wz_ms, intra_ms = (statistics.median(times_ms[name][1:]) for name in ("wz", "intra"))
    values = {"wz_ms": wz_ms, "intra_ms": intra_ms, "key_qp": qp, "num_frames": len(frames) - 1}
    return Measured(f"{wz_ms:.1f} ms, H.264 intra {intra_ms:.1f} ms", wz_ms <= intra_ms, values)


def help_time(setting: Setting, clip: str) -> Measured:
    """Time ``dvc-encode --help``."""
    times_s = sorted(run_module("encoder", ["--help"]).wall_s for _ in range(setting.choose(9, 3)))
    median_s = statistics.median(times_s)
    values = {"median_s": median_s, "max_s": times_s[-1], "num_runs": len(times_s)}
    return Measured(f"{median_s:.2f} s (slowest {times_s[-1]:.2f} s)", median_s <= 0.5, values)


def short_encode_time(setting: Setting, clip: str) -> Measured:
    """Time the encoding of three QCIF frames, process start included, with the compiled kernels on disk."""
    source = clip_source(clip).path.absolute()
    with tempfile.TemporaryDirectory() as scratch:
        arguments = [source, Path(scratch) / "s.dvc", "--codec", "2d", "--frames", 3, "--quiet"]
        runs = [run_module("encoder", arguments) for _ in range(1 + setting.choose(5, 2))][1:]
    times_s = [run.wall_s for run in runs]
    median_s = statistics.median(times_s)
    values = {"median_s": median_s, "max_s": max(times_s), "num_runs": len(runs)}
    values["median_cpu_s"] = statistics.median(run.cpu_s for run in runs)
    return Measured(f"{median_s:.2f} s (slowest {max(times_s):.2f} s)", median_s <= 2, values)


def looped_clip(clip: str, path: Path, num_frames: int) -> None:
    """Write a long video that plays the beginning of a sequence again and again."""
    from dvc.video import create_video, open_video

    with open_video(clip_source(clip).path, num_frames=LOOP_FRAMES) as reader:
        frames, info = list(reader), reader.info

    with create_video(path, info.size, info.frame_rate) as writer:
        for frame in islice(cycle(frames), num_frames):
            writer.write(frame)


def _peaks_mib(clip: str, folder: Path, num_frames: int, quantiser: int) -> dict[str, float]:
    """Encode and decode a looped sequence; return the peak memory of either."""
    video, stream = folder / "v.mkv", folder / "s.dvc"
    looped_clip(clip, video, num_frames)
    options = ["--codec", "2d", "--wz-q", quantiser, "--json", folder / "e.json", "--quiet"]
    encoding = run_module("encoder", [video, stream, *options])
    outputs = [folder / "d.y4m", "--punctured", folder / "p.dvc", "--json", folder / "d.json"]
    decoding = run_module("decoder", [stream, *outputs, "--reference", video, "--jobs", 2, "--quiet"])
    return {"encoder": encoding.peak_bytes / 2**20, "decoder": decoding.peak_bytes / 2**20}


def memory(setting: Setting, clip: str) -> Measured:
    """Compare the peak memory of encoder and decoder on a short and on a ten times longer video."""
    lengths, quantiser = (setting.choose(50, 6), setting.choose(500, 60)), setting.choose(4, 1)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        _, short, long = (_peaks_mib(clip, folder, length, quantiser) for length in (lengths[1], *lengths))
    growth = {name: 100 * (long[name] / short[name] - 1) for name in short}
    parts = [f"{name} {short[name]:.0f} and {long[name]:.0f} MiB ({growth[name]:+.1f} %)" for name in short]
    values = {"num_frames": lengths, "short_mib": short, "long_mib": long}
    note = "largest process of each; the decoder with --jobs 2"
    return Measured("; ".join(parts), max(growth.values()) <= 10, values, note)


def _decode_time_cif(setting: Setting, clip: str) -> Measured:
    return decode_time(setting, clip, 4.0)


def _decode_time_qcif(setting: Setting, clip: str) -> Measured:
    return decode_time(setting, clip, 1.0)


AREA = "codec"
FIGURES = (
    Figure(
        AREA,
        "decode-time-cif",
        "decoding of a WZ frame, Q8, CIF, one core",
        "≤ 4 s",
        _decode_time_cif,
        CIF_CLIPS,
    ),
    Figure(
        AREA,
        "decode-time-qcif",
        "decoding of a WZ frame, Q8, QCIF, one core",
        "≤ 1 s",
        _decode_time_qcif,
        (FOREMAN,),
    ),
    Figure(
        AREA,
        "decode-jobs",
        "`--jobs 2` against `--jobs 1`, Q8",
        "≥ 1.7 times faster, same bytes",
        decode_jobs,
        (FOREMAN,),
    ),
    Figure(
        AREA,
        "encode-cpu",
        "processor time of encoding a WZ frame, Q8",
        "≤ H.264 intra of the same frame, QP 25",
        encode_cpu,
        (FOREMAN, *CIF_CLIPS),
    ),
    Figure(AREA, "help-time", "`dvc-encode --help`", "≤ 0.5 s", help_time),
    Figure(
        AREA,
        "short-encode-time",
        "encoding of 3 QCIF frames, warm caches",
        "≤ 2 s",
        short_encode_time,
        (FOREMAN,),
    ),
    Figure(
        AREA, "memory", "peak memory on 50 and on 500 QCIF frames", "the same within 10 %", memory, (FOREMAN,)
    ),
)
"""Figures of this area."""
