"""Live runs over a link with delay: how long they take, and whether memory stays flat."""

import json
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from benchmarks.figures.harness import Figure, Measured, Setting, clip_source, run_module, there_and_back
from benchmarks.slow_link import BITS_PER_SECOND, DELAY_S, slow_link
from dvc.errors import DvcError

NUM_FRAMES, QUICK_FRAMES = 500, 17
OPTION = "--long-delay"
MOST_RATIO = 1.3
MOST_GROWTH = 0.05
PATIENCE_S = 120
_SAMPLE_S = 1.0
_SETTLED = 1 / 3
"""Share of a run after which memory is expected to stay as it is: until then groups are taken in."""


def _resident_bytes(root: int) -> int:
    """Return the memory of a process and those that it has started, each page once."""
    total, parents = 0, {root}
    for folder in sorted((path for path in Path("/proc").iterdir() if path.name.isdigit()), key=_number):
        try:
            parent = int((folder / "stat").read_text().rsplit(")", 1)[1].split()[1])
            if _number(folder) == root or parent in parents:
                parents.add(_number(folder))
                total += int((folder / "smaps_rollup").read_text().split("Pss:")[1].split()[0]) * 1024
        except (OSError, IndexError):  # it has just ended
            continue
    return total


def _number(folder: Path) -> int:
    return int(folder.name)


@contextmanager
def _sampling(process: int) -> Iterator[list[int]]:
    """Take the memory of a process, again and again while a block runs."""
    samples: list[int] = []
    done = threading.Event()

    def _sample() -> None:
        while not done.wait(_SAMPLE_S):
            samples.append(_resident_bytes(process))

    thread = threading.Thread(target=_sample)
    thread.start()
    try:
        yield samples
    finally:
        done.set()
        thread.join()


def _growth(samples: list[int]) -> float:
    """Return by how much the peak of the last third exceeds that of the one before, as a share."""
    settled = [number for number in samples if number][int(_SETTLED * len(samples)) :]
    half = len(settled) // 2
    if not half:
        return 0.0
    return max(settled[half:]) / max(settled[:half]) - 1.0


class _LiveRun:
    """A live run of both programs over a link."""

    def __init__(self, video: Path, output: Path) -> None:
        started = [sys.executable, "-m", "encoder", str(video), OPTION, "--serve", "127.0.0.1:0"]
        command = [
            *started,
            "--quiet",
            "--timeout",
            str(PATIENCE_S),
            "--json",
            str(output.with_suffix(".encoder")),
        ]
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as encoder:
            assert encoder.stderr is not None
            try:
                host, _, port = encoder.stderr.readline().split()[-1].rpartition(":")
                self._decode(encoder, (host, int(port)), output)
                _, said = encoder.communicate(timeout=PATIENCE_S)
            except BaseException:
                encoder.kill()
                raise
        if encoder.returncode != 0:
            raise DvcError(f"the encoder ended with status {encoder.returncode}: {said.strip()[-300:]}")

    def _decode(self, encoder: "subprocess.Popen[str]", address: tuple[str, int], output: Path) -> None:
        with slow_link(*address) as self.link:
            outputs = [str(output), "--punctured", str(output.with_suffix(".dvc"))]
            command = [sys.executable, "-m", "decoder", "--connect", self.link.address, *outputs, "--quiet"]
            started = time.perf_counter()
            with subprocess.Popen([*command, "--timeout", str(PATIENCE_S)]) as decoder:
                try:
                    with _sampling(encoder.pid) as self.encoder_bytes, _sampling(decoder.pid) as own:
                        self.decoder_bytes = own
                        status = decoder.wait()
                except BaseException:
                    decoder.kill()
                    raise
            self.wall_s = time.perf_counter() - started
        if status != 0:
            raise DvcError(f"the decoder ended with status {status}")


def _forth_and_back(clip: str, path: Path, num_frames: int) -> None:
    """Write a long video that plays a sequence forwards, backwards, and so on: without a cut."""
    from dvc.video import create_video, open_video

    with open_video(clip_source(clip).path) as reader:
        frames, info = list(reader), reader.info
    with create_video(path, info.size, info.frame_rate) as writer:
        for frame in there_and_back(frames, num_frames):
            writer.write(frame)


def slow_live_run(setting: Setting, clip: str) -> Measured:
    """Decode live over a link with delay, and the same from a file."""
    folder = setting.folder / "live"
    folder.mkdir(parents=True, exist_ok=True)
    num_frames = setting.choose(NUM_FRAMES, QUICK_FRAMES)
    video, stream = folder / f"{clip}.mkv", folder / f"{clip}.dvc"
    _forth_and_back(clip, video, num_frames)
    live = _LiveRun(video, folder / "live.mkv")
    run_module("encoder", [video, stream, OPTION, "--quiet"])
    files = [folder / "file.mkv", "--punctured", folder / "punctured.dvc"]
    decoding_s = run_module("decoder", [stream, *files, "--quiet"]).wall_s
    same = all(
        (folder / one).read_bytes() == (folder / other).read_bytes()
        for one, other in (("live.mkv", "file.mkv"), ("live.dvc", "punctured.dvc"))
    )
    encoder = json.loads((folder / "live.encoder").read_text(encoding="utf-8"))
    bits_s = 8 * live.link.forth.num_bytes / BITS_PER_SECOND
    ratio = live.wall_s / (bits_s + decoding_s)
    growths = {"encoder": _growth(live.encoder_bytes), "decoder": _growth(live.decoder_bytes)}
    values = {
        "ratio": ratio,
        "live_s": live.wall_s,
        "bits_s": bits_s,
        "decoding_s": decoding_s,
        "bytes_to_decoder": live.link.forth.num_bytes,
        "bytes_to_encoder": live.link.back.num_bytes,
        "punctured_bytes": (folder / "punctured.dvc").stat().st_size,
        "num_frames": num_frames,
        "same_frames_and_bits": same,
        "growth": growths,
        "peak_mib": {
            "encoder": max(live.encoder_bytes, default=0) / 2**20,
            "decoder": max(live.decoder_bytes, default=0) / 2**20,
        },
        "most_frames_open": encoder["most_frames_open"],
        "decoder_behind_s": encoder["decoder_behind_s"],
    }
    text = (
        f"{ratio:.2f} ({live.wall_s:.0f} s; bits {bits_s:.0f} s, decoding the file {decoding_s:.0f} s);"
        f" {'the same' if same else 'not the same'} frames and bits; memory of the encoder"
        f" {growths['encoder']:+.1%}, of the decoder {growths['decoder']:+.1%}"
    )
    holds = same and ratio <= MOST_RATIO and max(growths.values()) <= MOST_GROWTH
    note = (
        f"{num_frames} frames, the clip forth and back; bandwidth counts what TCP carries;"
        f" {live.link.back.num_bytes / 1e6:.1f} MB went back, {live.link.forth.num_bytes / 1e6:.1f} MB forth;"
        " memory: the most in the last third of the run over the most in the third before"
    )
    return Measured(text, holds, values, note)


FIGURES = (
    Figure(
        "live",
        "slow-link",
        f"{NUM_FRAMES} frames live over a link of {1000 * DELAY_S:.0f} ms delay each way and"
        f" {BITS_PER_SECOND / 1e6:.0f} Mbit/s, one job, {OPTION}:"
        " time over that of the bits and of decoding the file",
        "≤ 1.3, the same frames and bits, memory of both flat within 5 %",
        slow_live_run,
        ("box",),
        slow=True,
        programs=("encoder", "decoder"),
    ),
)
"""The figures of this module."""
