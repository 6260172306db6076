"""Live runs of both programs: costs of the encoder for all requests, and equality with files."""

import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from benchmarks.results.encoder import anchor_frame_ms, later_frames_ms, own_cpu_s
from benchmarks.results.harness import Measured, Setting, clip_source, mean_of, report_of, run_module
from dvc.environment import child_environment, python_module
from dvc.errors import DvcError

LENGTHS, QUICK_LENGTHS = (9, 33), (5, 9)
CLIPS, QUICK_CLIPS = ("box", "tree"), ("box", "street")
PATIENCE_S = 600


@dataclass(frozen=True)
class LiveRun:
    """Costs of a live run."""

    encoder_cpu_s: float
    num_messages: float  # messages of requests for each Wyner-Ziv frame
    same_as_file: bool  # whether a file of the same options gives the same frames and bits


@contextmanager
def serving(video: Path, folder: Path, options: Sequence[object]) -> Iterator[str]:
    """Run an encoder that waits for a decoder, which comes to the address that the block is given."""
    words = [video, "--serve", "127.0.0.1:0", "--timeout", PATIENCE_S, *options]
    command = python_module("encoder", *words, "--json", folder / "encoder.json", "--quiet")
    with subprocess.Popen(command, env=child_environment(), stderr=subprocess.PIPE, text=True) as encoder:
        assert encoder.stderr is not None
        try:
            yield encoder.stderr.readline().split()[-1]
            _, said = encoder.communicate(timeout=60)
        except BaseException:
            encoder.kill()
            raise
    if encoder.returncode != 0:
        raise DvcError(f"the encoder ended with status {encoder.returncode}: {said.strip()[-300:]}")


def live_run(video: Path, folder: Path, options: Sequence[object]) -> LiveRun:
    """Code a video live, and as a file."""
    with serving(video, folder, options) as address:
        outputs = [folder / "live.mkv", "--punctured", folder / "live.dvc", "--quiet"]
        outputs += ["--json", folder / "decoder.json"]
        run_module("decoder", "--connect", address, *outputs, "--timeout", PATIENCE_S)
    run_module("encoder", video, folder / "stream.dvc", *options, "--quiet")
    outputs = [folder / "file.mkv", "--punctured", folder / "file.dvc", "--quiet"]
    run_module("decoder", folder / "stream.dvc", *outputs)
    pairs = ((folder / f"live{end}", folder / f"file{end}") for end in (".mkv", ".dvc"))
    same = all(live.read_bytes() == file.read_bytes() for live, file in pairs)
    encoder, decoder = (report_of(folder / f"{end}.json") for end in ("encoder", "decoder"))
    num_messages = decoder["num_messages"] / max(encoder["num_wyner_ziv_frames"], 1)
    return LiveRun(own_cpu_s(encoder), num_messages, same)


@cache
def _runs(setting: Setting) -> dict[str, tuple[float, float, bool]]:
    """Return, by clip, the encoder's time over that of x264, messages, and whether files are the same."""
    lengths, found = setting.choose(LENGTHS, QUICK_LENGTHS), {}
    for clip in setting.clips(setting.choose(CLIPS, QUICK_CLIPS)):
        folder, video = setting.scratch(f"live-{clip}"), clip_source(clip).path
        runs = {n: live_run(video, folder, ["--frames", str(n)]) for n in lengths}
        taken_s = {n: run.encoder_cpu_s for n, run in runs.items()}
        ours_ms = later_frames_ms(taken_s.__getitem__, lengths)
        same = all(run.same_as_file for run in runs.values())
        ratio = ours_ms / anchor_frame_ms(video, folder, setting)
        found[clip] = ratio, runs[lengths[1]].num_messages, same
    return found


def encoder_time(setting: Setting) -> Measured:
    """Compare the processor time of the encoder, all requests answered, with that of x264 superfast."""
    ratios = {clip: ratio for clip, (ratio, _, _) in _runs(setting).items()}
    return mean_of(ratios, int(setting.choose(LENGTHS, QUICK_LENGTHS)[1]))


def messages(setting: Setting) -> Measured:
    """Count messages of requests for a Wyner-Ziv frame."""
    counts = {clip: count for clip, (_, count, _) in _runs(setting).items()}
    return mean_of(counts, int(setting.choose(LENGTHS, QUICK_LENGTHS)[1]))


def differences(setting: Setting) -> Measured:
    """Count clips with different frames or bits in a live run and a file."""
    found = _runs(setting)
    different, frames = sum(not same for _, _, same in found.values()), setting.choose(LENGTHS, QUICK_LENGTHS)
    return Measured(float(different), {}, int(frames[1]), f"{len(found)} clips")
