"""Time of decoding by stage: `python -m benchmarks.stages [CLIP ...]`.

Clips are coded with the default codec and decoded in one process, one frame after the other. What a stage
calls of another stage is counted there.
"""

import argparse
import io
import os
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

from dvc import cli
from dvc.environment import baseline_environment, python_module

if TYPE_CHECKING:
    from decoder.group_tasks import DecodedGroup

STAGES = {
    "geometry: structure from motion": ("sfm.pipeline.reconstruct",),
    "geometry: cameras from tracks": ("decoder.side_information.methods.estimate_geometry",),
    "depth: plane sweep": ("dvc.geometry.depth_maps._swept",),
    "depth: consistency, continuation, edges": (
        "dvc.geometry.depth_maps.checked_depth",
        "dvc.geometry.depth_maps._with_points",
        "dvc.geometry.depth_maps._continued",
        "dvc.geometry.depth_maps._aligned",
    ),
    "rendering": ("decoder.side_information.scene_interpolators.render_between",),
    "corrections by tracks": ("decoder.side_information.methods.corrected",),
    "prediction only by tracks": ("decoder.side_information.methods.interpolate_by_tracks",),
    "rest of the prediction": ("decoder.group.GroupDecoder._predict",),
    "refinement: block search": ("decoder.side_information.block_motion._search",),
    "refinement: rest": ("decoder.side_information.block_motion.BlockRefiner.refine",),
    "fusion of predictions": ("decoder.frame_state.FrameState.use",),
    "noise scales": ("decoder.frame_state.FrameState.scale", "dvc.wynerziv.noise.fit_gain"),
    "expected worth of planes": ("decoder.frame_state.expected_refinement",),
    "priors of planes": (
        "dvc.wynerziv.priors.LearnedPriors.plane",
        "dvc.wynerziv.priors.LearnedPriors.learn",
    ),
    "planes: passing beliefs": ("dvc.slepian_wolf.cascade.posterior.RangePosterior.propagate",),
    "planes: neighbours": ("dvc.slepian_wolf.cascade.posterior.RangePosterior.couple",),
    "planes: next question": ("dvc.slepian_wolf.cascade.posterior.RangePosterior.batch",),
    "key frames": ("decoder.session._Tasks.add",),
}
REST = "all else"


class Clock:
    """Processor time by stage, of the innermost one that is at work."""

    def __init__(self) -> None:
        self.spent_s: dict[str, float] = defaultdict(float)
        self._running = [REST]
        self._since_s = time.process_time()

    def turn(self) -> None:
        """Charge the time since the last turn to the stage that is at work."""
        now_s = time.process_time()
        self.spent_s[self._running[-1]] += now_s - self._since_s
        self._since_s = now_s

    def timed(self, stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function that adds its time to a stage."""

        def call(*arguments: Any, **named: Any) -> Any:
            self.turn()
            self._running.append(stage)
            try:
                return function(*arguments, **named)
            finally:
                self.turn()
                self._running.pop()

        return call


def watch(clock: Clock) -> None:
    """Put clocks around the functions of all stages."""
    for stage, names in STAGES.items():
        for name in names:
            owner, _, function = name.rpartition(".")
            setattr(resolve_name(owner), function, clock.timed(stage, resolve_name(name)))


def decoded_groups(stream: bytes) -> "Iterator[DecodedGroup]":
    """Decode a stream in this process."""
    from decoder.group import GroupDecoder
    from decoder.session import stream_tasks
    from dvc.stream import StreamReader

    with StreamReader(io.BytesIO(stream)) as reader:
        decoder = GroupDecoder(reader.config)
        yield from map(decoder.decode, stream_tasks(reader.config, reader))


def decoded(stream: bytes) -> int:
    """Decode a stream; return the number of its frames."""
    return sum(len(group.frames) for group in decoded_groups(stream))


def coded(clip: str, qp: int, frames: int, folder: Path) -> bytes:
    """Code a clip as `dvc-encode` does."""
    from benchmarks.results.harness import clip_source
    from encoder.__main__ import main as encode

    made = folder / f"{clip}-{qp}-{frames}.dvc"
    words = [str(clip_source(clip).path), str(made), "--qp", str(qp), "--frames", str(frames), "--quiet"]
    if encode(words):
        raise SystemExit(f"{clip} cannot be coded")
    return made.read_bytes()


def table(spent_s: dict[str, float], num_frames: int) -> str:
    """Return a table of times a frame, and shares."""
    total_s = sum(spent_s.values())
    lines = [f"{'stage':<42} ms a frame  share"]
    for stage, seconds in sorted(spent_s.items(), key=lambda item: -item[1]):
        lines.append(f"{stage:<42} {1e3 * seconds / num_frames:10.1f} {100 * seconds / total_s:5.1f} %")
    return "\n".join([*lines, f"{'all':<42} {1e3 * total_s / num_frames:10.1f} 100.0 %"])


def main(words: Sequence[str] | None = None) -> int:
    """Decode, and print the table."""
    parser = argparse.ArgumentParser("python -m benchmarks.stages", description=__doc__)
    parser.add_argument("clips", nargs="*", metavar="CLIP", help="default: all nine")
    parser.add_argument("--qp", type=int, default=30)
    parser.add_argument("--frames", type=int, default=33)
    parser.add_argument("--out", type=Path, default=Path("out/stages"), help="folder of streams")
    arguments = parser.parse_args(words)
    from benchmarks.results.harness import CLIPS

    arguments.out.mkdir(parents=True, exist_ok=True)
    clips = arguments.clips or list(CLIPS)
    streams = [coded(clip, arguments.qp, arguments.frames, arguments.out) for clip in clips]
    decoded(streams[0])  # loads code
    clock = Clock()
    watch(clock)
    with cli.progress_bar("streams", len(streams)) as progress:
        num_frames = 0
        for stream in streams:
            num_frames += decoded(stream)
            progress(1)
    clock.turn()
    print(f"{', '.join(clips)}; {arguments.frames} frames, QP {arguments.qp}\n")
    print(table(clock.spent_s, num_frames))
    return 0


def enter_baseline_environment(module: str) -> None:
    """Restart a module in the environment of decoding, unless it already has it."""
    wanted = baseline_environment()
    if os.environ.get("OPENCV_CPU_DISABLE") != wanted.get("OPENCV_CPU_DISABLE"):
        command = python_module(module, *sys.argv[1:])
        os.execve(command[0], command, wanted)


if __name__ == "__main__":
    enter_baseline_environment("benchmarks.stages")
    sys.exit(main())
