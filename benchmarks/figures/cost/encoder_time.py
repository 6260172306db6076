"""Processor time of the encoder over that of x264 with motion search, frames in memory for both."""

import hashlib
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import cast

from benchmarks.figures.cost.rate_cost import AREA, Material, Run, times_ms
from benchmarks.figures.harness import STATIC_CLIPS, Figure, Measured, Setting, run_module, there_and_back
from dvc.config import DEFAULT_QP
from dvc.errors import DvcError
from dvc.feedback import KEEP_ALIVE, Connection, listen
from dvc.rd.source_digest import Sources
from dvc.video import open_video
from encoder import options
from encoder.live import serve
from encoder.session import EncoderSession

CLIPS = (*STATIC_CLIPS, "cube")
LARGE_SCENES = ("statue", "street")
LARGE_SIZE = "1280x720"
PEERS = ("x264-superfast", "x264-ultrafast")
NUM_FRAMES, NUM_LARGE_FRAMES, QUICK_FRAMES = 49, 17, 5
NUM_LIVE_FRAMES, NUM_LARGE_LIVE_FRAMES = 241, 49
"""Live runs are so long that as many groups of pictures are in flight as in long ones."""
REPETITIONS = 9
LIMITS = {"one-way": 1.0, "live": 1.2, "live-long-delay": None, "frames": None}
"""Times the processor time of x264 superfast, by form; None: the true figure is asked for."""
LIVE_FORMS = ("live", "live-long-delay")
OPTIONS = {"live-long-delay": ("--long-delay",)}
"""Of `dvc-encode`, by form."""


class _Recorder:
    """A connection that keeps what it receives."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self.received: list[bytes] = []

    def receive(self) -> bytes:
        self.received.append(self._connection.receive())
        return self.received[-1]

    def has_received(self) -> bool:
        return self._connection.has_received()

    def send(self, data: bytes) -> None:
        self._connection.send(data)


class _Replay:
    """A connection that receives what another did."""

    def __init__(self, received: list[bytes]) -> None:
        self._received = iter(received)

    def receive(self) -> bytes:
        return next(self._received)

    def has_received(self) -> bool:
        return False

    def send(self, data: bytes) -> None:
        pass


@cache
def _large_scene(scene: str, num_frames: int) -> Material:
    """Render grey frames of a scene."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.mkv"
        run_module(
            "sequences", ["render", scene, "--out", path, "--size", LARGE_SIZE, "--frames", num_frames]
        )
        with open_video(path) as reader:
            return Material(reader.info, tuple(frame.without_chroma() for frame in reader))


def _session(material: Material, form: str) -> EncoderSession:
    arguments = ["video", "stream.dvc", "--luma-only", *OPTIONS.get(form, ())]
    return options.session(options.parser().parse_args(arguments), material.info)


def _no_progress(_num_frames: int) -> None:
    pass


def _requests(setting: Setting, material: Material, form: str) -> list[bytes]:
    """Return what a decoder sends, which is kept: it takes minutes to decode what is encoded in a second."""
    frames = hashlib.sha256(b"".join(frame.luma.tobytes() for frame in material.frames)).hexdigest()
    code = Sources().digest([(__name__, "_session"), ("encoder.live", "serve"), ("decoder", "")])
    path = setting.folder / "requests" / f"{form}-{frames[:8]}-{code[:8]}.txt"
    if not path.exists():
        lines = "\n".join(data.hex() for data in _record_requests(material, form))
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(lines, encoding="ascii")
    return [bytes.fromhex(line) for line in path.read_text(encoding="ascii").split()]


def _record_requests(material: Material, form: str) -> list[bytes]:
    """Serve a decoder once, and return what it sent."""
    with tempfile.TemporaryDirectory() as folder, listen() as listener:
        command = [sys.executable, "-m", "decoder", "--connect", listener.name, f"{folder}/v.y4m", "--quiet"]
        with subprocess.Popen(command) as decoder:
            with listener.accept(silence_timeout_s=600) as connection, connection.kept_alive(KEEP_ALIVE):
                recorder = _Recorder(connection)
                serve(_session(material, form), material.frames, cast(Connection, recorder), _no_progress)
            if decoder.wait() != 0:
                raise DvcError(f"the decoder ended with status {decoder.returncode}")
    return recorder.received


def _run_live(material: Material, form: str, received: list[bytes]) -> None:
    serve(_session(material, form), material.frames, cast(Connection, _Replay(received)), _no_progress)


def _run_frames(material: Material) -> None:
    session = _session(material, "frames")
    for group in session.groups(material.frames):
        session.encode(group)


def _run_of(setting: Setting, form: str, material: Material) -> Run:
    if form == "one-way":
        return material.one_way_run(DEFAULT_QP)
    if form in LIVE_FORMS:
        return partial(_run_live, material, form, _requests(setting, material, form))
    return partial(_run_frames, material)


def _compare(setting: Setting, material: Material, form: str, num_live_frames: int) -> Measured:
    """Compare a form with both presets."""
    if form in LIVE_FORMS and not setting.quick:
        material = replace(material, frames=tuple(there_and_back(material.frames, num_live_frames)))
    runs: dict[str, Sequence[Run]] = {"ours": [_run_of(setting, form, material)]}
    runs |= {peer: [material.anchor_run(peer, DEFAULT_QP)] for peer in PEERS}
    ms = times_ms(runs, len(material.frames), setting.choose(REPETITIONS, 1))
    ratios = {peer: ms["ours"] / ms[peer] for peer in PEERS}
    text = ", ".join(f"{ratio:.2f} of {peer.removeprefix('x264-')}'s" for peer, ratio in ratios.items())
    text += " (" + ", ".join(f"{value:.2f}" for value in ms.values()) + " ms a frame)"
    limit = LIMITS[form]
    holds = None if limit is None else ratios[PEERS[0]] <= limit
    return Measured(text, holds, {"ratios": ratios, "ms_per_frame": ms, "num_frames": len(material.frames)})


def encoder_cpu(setting: Setting, clip: str, form: str) -> Measured:
    """Compare the processor time of the encoder with that of x264 at the same QP, one thread each."""
    material = Material.read(clip, setting.choose(NUM_FRAMES, QUICK_FRAMES))
    return _compare(setting, material, form, NUM_LIVE_FRAMES)


def large_encoder_cpu(setting: Setting, scene: str, form: str) -> Measured:
    """Compare processor times as `encoder_cpu` does, on a scene rendered at 1280x720."""
    material = _large_scene(scene, setting.choose(NUM_LARGE_FRAMES, QUICK_FRAMES))
    return _compare(setting, material, form, NUM_LARGE_LIVE_FRAMES)


_TITLE = "processor time of the encoder over that of x264 superfast with motion search, {}"
_ASKED = {
    "one-way": "≤ 1.0; beyond: ≤ 1.0 of ultrafast's",
    "live": "≤ 1.2",
    "live-long-delay": "the true figure",
    "frames": "the true figure",
}
_WORDS = {
    "one-way": "--no-feedback",
    "live": "live, requests of a decoder included",
    "live-long-delay": "live, requests of a decoder included, --long-delay",
    "frames": "before anything is sent of WZ frames",
}


def _figures(form: str) -> tuple[Figure, Figure]:
    """Return the figures of a form, on clips and on large scenes."""
    small = Figure(
        AREA,
        f"{form}-cpu",
        _TITLE.format(_WORDS[form]),
        _ASKED[form],
        partial(encoder_cpu, form=form),
        CLIPS,
        slow=form in LIVE_FORMS,
        programs=("decoder",) if form in LIVE_FORMS else (),
    )
    large = replace(
        small,
        name=f"{form}-cpu-720p",
        title=f"{small.title}, {LARGE_SIZE}",
        measure=partial(large_encoder_cpu, form=form),
        clips=LARGE_SCENES,
        slow=True,
        programs=("sequences", *small.programs),
    )
    return small, large


FIGURES = tuple(figure for form in _ASKED for figure in _figures(form))
"""The figures of this module."""
