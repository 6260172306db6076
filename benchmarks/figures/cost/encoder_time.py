"""Processor time of the encoder over that of x264 with motion search, frames in memory for both."""

import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import cast

import av

from benchmarks.figures.harness import STATIC_CLIPS, Figure, Measured, Setting, clip_source, run_module
from dvc.config import DEFAULT_QP
from dvc.errors import DvcError
from dvc.feedback import Connection, listen
from dvc.rd.anchors.codecs import ANCHOR_CODECS
from dvc.video import Frame, VideoInfo, open_video
from dvc.video.pixels import picture_from_frame
from encoder import options
from encoder.live import serve
from encoder.session import EncoderSession

AREA = "cost"
CLIPS = (*STATIC_CLIPS, "cube")
LARGE_SCENES = ("statue", "street")
LARGE_SIZE = "1280x720"
PRESETS = ("superfast", "ultrafast")
NUM_FRAMES, NUM_LARGE_FRAMES, QUICK_FRAMES = 49, 33, 5
REPETITIONS = 9
LIMITS = {"one-way": 1.0, "live": 1.2, "frames": None}
"""Times the processor time of x264 superfast, by form; None: the true figure is asked for."""
_X264 = ANCHOR_CODECS["x264-ippp"]


@dataclass(frozen=True)
class _Material:
    """Frames in memory, and the session that the program would set up for them."""

    info: VideoInfo
    frames: list[Frame]
    path: Path

    def session(self, *arguments: str) -> EncoderSession:
        parsed = options.parser().parse_args([str(self.path), "stream.dvc", *arguments])
        return options.session(parsed, self.info)


class _Recorder:
    """A connection that keeps what it receives."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self.received: list[bytes] = []

    def receive(self) -> bytes:
        self.received.append(self._connection.receive())
        return self.received[-1]

    def send(self, data: bytes) -> None:
        self._connection.send(data)


class _Replay:
    """A connection that receives what another did."""

    def __init__(self, received: list[bytes]) -> None:
        self._received = iter(received)

    def receive(self) -> bytes:
        return next(self._received)

    def send(self, data: bytes) -> None:
        pass


def _material(path: Path, num_frames: int) -> _Material:
    with open_video(path, num_frames=num_frames) as reader:
        return _Material(reader.info, list(reader), path)


def _large_scene(scene: str, num_frames: int, folder: Path) -> _Material:
    path = folder / f"{scene}.mkv"
    run_module("sequences", ["render", scene, "--out", path, "--size", LARGE_SIZE, "--frames", num_frames])
    return _material(path, num_frames)


def _no_progress(_num_frames: int) -> None:
    pass


def _record_requests(material: _Material) -> list[bytes]:
    """Serve a decoder once, and return what it sent."""
    with tempfile.TemporaryDirectory() as folder, listen() as listener:
        host, _, port = listener.name.rpartition(":")
        command = [
            sys.executable,
            "-m",
            "decoder",
            "--connect",
            f"{host}:{port}",
            f"{folder}/v.y4m",
            "--quiet",
        ]
        with subprocess.Popen(command) as decoder:
            with listener.accept(silence_timeout_s=600) as connection:
                recorder = _Recorder(connection)
                serve(material.session(), material.frames, cast(Connection, recorder), _no_progress)
            if decoder.wait() != 0:
                raise DvcError(f"the decoder ended with status {decoder.returncode}")
    return recorder.received


def _run_live(material: _Material, received: list[bytes]) -> EncoderSession:
    session = material.session()
    serve(session, material.frames, cast(Connection, _Replay(received)), _no_progress)
    return session


def _run_one_way(material: _Material) -> EncoderSession:
    session = material.session("--no-feedback")
    session.write(material.frames, BytesIO(), _no_progress)
    return session


def _run_frames(material: _Material) -> EncoderSession:
    session = material.session()
    with session.statistics.coding():
        for group in session.groups(material.frames):
            session.encode(group)
    return session


def _run_x264(info: VideoInfo, pictures: list[av.VideoFrame], preset: str) -> None:
    codec = replace(_X264, preset=preset)
    context = av.CodecContext.create(codec.library, "w")
    context.width, context.height, context.pix_fmt = info.width, info.height, "yuv420p"
    context.framerate, context.time_base = Fraction(25), Fraction(1, 25)
    context.thread_count = 1
    parameters = codec.encoder_parameters(DEFAULT_QP)
    context.options = {
        "preset": preset,
        "x264-params": ":".join(f"{name}={value}" for name, value in parameters.items()),
    }
    for number, picture in enumerate(pictures):
        picture.pts = number
        for packet in context.encode(picture):
            bytes(packet)
    for packet in context.encode(None):
        bytes(packet)


def _cpu_s(run: Callable[[], object]) -> float:
    started = time.process_time()
    run()
    return time.process_time() - started


def _times_s(runs: dict[str, Callable[[], object]], repetitions: int) -> Iterator[dict[str, float]]:
    """Time runs in turn, again and again, after each has been run once."""
    for run in runs.values():
        run()
    for _ in range(repetitions):
        yield {name: _cpu_s(run) for name, run in runs.items()}


def _compare(setting: Setting, material: _Material, form: str) -> Measured:
    """Compare a form with both presets."""
    ours: Callable[[], EncoderSession] = partial(_run_one_way if form == "one-way" else _run_frames, material)
    if form == "live":
        ours = partial(_run_live, material, _record_requests(material))
    runs: dict[str, Callable[[], object]] = {"ours": ours}
    pictures = [picture_from_frame(frame, "yuv420p") for frame in material.frames]
    runs |= {preset: partial(_run_x264, material.info, pictures, preset) for preset in PRESETS}
    times = list(_times_s(runs, setting.choose(REPETITIONS, 1)))
    count = len(material.frames)
    ms = {name: 1000 * statistics.median(found[name] for found in times) / count for name in runs}
    ratios = {
        preset: statistics.median(found["ours"] / found[preset] for found in times) for preset in PRESETS
    }
    counted = ours().statistics
    parts = {
        name.replace("_cpu_s", "_ms"): 1000 * value / count
        for name, value in counted.to_dict().items()
        if name.endswith("_cpu_s")
    }
    text = ", ".join(f"{ratio:.2f} of {preset}'s" for preset, ratio in ratios.items())
    text += " (" + ", ".join(f"{value:.2f}" for value in ms.values()) + " ms a frame)"
    values = {"ratios": ratios, "ms_per_frame": ms, "parts_of_one_run": parts, "num_frames": count}
    values["key_frames"] = counted.num_key_frames
    limit = LIMITS[form]
    return Measured(text, None if limit is None else ratios[PRESETS[0]] <= limit, values)


def encoder_cpu(setting: Setting, clip: str, form: str) -> Measured:
    """Compare the processor time of the encoder with that of x264 at the same QP, one thread each.

    Both take the same frames, in colour, from memory, in turn, in this process; the median of nine turns
    counts. All that the program does for a frame is in it: for a file without feedback, which is written;
    live, with the requests of a decoder that was served before; or without what either adds. x264 codes
    each frame from the one before it, with the motion search of its preset, and no B frames.

    Gives the share of the time of two presets.

    Parameters
    ----------
    form : {"one-way", "live", "frames"}
        What is encoded for.
    """
    return _compare(
        setting, _material(clip_source(clip).path, setting.choose(NUM_FRAMES, QUICK_FRAMES)), form
    )


def large_encoder_cpu(setting: Setting, scene: str, form: str) -> Measured:
    """Compare processor times as `encoder_cpu` does, on a scene rendered at 1280x720.

    Gives the share of the time of two presets.

    Parameters
    ----------
    form : {"one-way", "live", "frames"}
        What is encoded for.
    """
    with tempfile.TemporaryDirectory() as folder:
        count = setting.choose(NUM_LARGE_FRAMES, QUICK_FRAMES)
        return _compare(setting, _large_scene(scene, count, Path(folder)), form)


_TITLE = "processor time of the encoder over that of x264 superfast with motion search, {}"
_ASKED = {"one-way": "≤ 1.0; beyond: ≤ 1.0 of ultrafast's", "live": "≤ 1.2", "frames": "the true figure"}
_WORDS = {
    "one-way": "--no-feedback",
    "live": "live, requests of a decoder included",
    "frames": "without what is sent of WZ frames",
}


def _figures(form: str) -> tuple[Figure, Figure]:
    """Return the figures of a form, on clips and on large scenes."""
    title, asked = _TITLE.format(_WORDS[form]), _ASKED[form]
    programs = ("decoder",) if form == "live" else ()
    small = Figure(
        AREA,
        f"{form}-cpu",
        title,
        asked,
        partial(encoder_cpu, form=form),
        CLIPS,
        slow=form == "live",
        programs=programs,
    )
    large = replace(
        small,
        name=f"{form}-cpu-720p",
        title=f"{title}, 1280x720",
        measure=partial(large_encoder_cpu, form=form),
        clips=LARGE_SCENES,
        slow=True,
        programs=("sequences", *programs),
    )
    return small, large


FIGURES = tuple(figure for form in _ASKED for figure in _figures(form))
"""The figures of this module."""
