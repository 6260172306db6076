"""Settings of stream and encoder: change of the rate at equal PSNR.

``python -m benchmarks.searches.settings SETTINGS ... [--clips box tree] [--qp 26 32 38] [--frames 65]``
codes and decodes clips by default, and with each of the settings, several of them joined by commas: values
of the configuration (``gop.length=4``, ``key.qp=-1`` relative to the usual) and constants of modules
(``dvc.keyframes.INTRA_QP_OFFSET=-2``, ``dvc.config.sections.LAMBDA_PERCENT=100:50:30``), and bounds that end
groups (``rule.lost_share=0.4``). With ``--colour`` chroma is coded, too, and PSNR is (6 Y + Cb + Cr) / 8. A
row has the change of rate minus the value of the change of PSNR on the clip's default curve, in percent: the
mean, its standard error, and that of each QP and clip. The last row is a cross-validation: the change of
each clip with the best settings for the remaining clips.
"""

import argparse
import io
import math
import multiprocessing
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from itertools import islice, product
from typing import Any, NamedTuple
from unittest import mock

import numpy as np

from benchmarks.results.harness import CLIPS, clip_source
from decoder.group import GroupDecoder
from decoder.session import stream_tasks
from dvc.cli import progress_bar
from dvc.config import (
    DEFAULT_CODEC,
    VARIANTS,
    Delivery,
    NoFeedback,
    ParityBuffer,
    Qp,
    VideoConfig,
    codec_config,
)
from dvc.environment import child_environment
from dvc.metrics import psnr_db, psnr_yuv_db
from dvc.stream import Form, StreamReader, StreamWriter
from dvc.video import Frame, VideoInfo, open_video
from encoder.encoder_session import EncoderSession

USUAL = ""


class Trial(NamedTuple):
    """A clip, and its coding."""

    clip: str
    qp: int
    settings: str


class Coded(NamedTuple):
    """Result of a trial."""

    num_bytes: int  # size of the punctured stream
    psnr_db: float  # mean over frames


def _value(text: str, usual: Any) -> Any:
    """Read a value of the type of the default one; with a sign it is relative to that."""
    if isinstance(usual, tuple):
        return tuple(int(number) for number in text.split(":"))
    value = type(usual)(text)
    return usual + value if text[0] in "+-" else value


def divided(settings: str) -> tuple[dict[str, str], dict[str, str]]:
    """Divide settings into those of the configuration and constants of modules."""
    given = dict(one.split("=") for one in settings.split(",") if one)
    constants = {name: text for name, text in given.items() if name.count(".") > 1}
    return {name: text for name, text in given.items() if name not in constants}, constants


def encoder_session(
    info: VideoInfo, qp: int, given: Mapping[str, str], delivery: Delivery, luma_only: bool = True
) -> EncoderSession:
    """Return an encoder of the default codec with some other values."""
    rate = info.frame_rate
    video = VideoConfig(info.width, info.height, rate.numerator, rate.denominator, luma_only)
    values: dict[str, dict[str, str]] = {}
    for name, text in given.items():
        section, field = name.split(".")
        values.setdefault(section, {})[field] = text
    rule = _changed(VARIANTS[DEFAULT_CODEC].groups().key_frames, values.pop("rule", {}))
    usual = codec_config(video, quality=Qp(qp))
    changed: dict[str, Any] = {name: _values(getattr(usual, name), of) for name, of in values.items()}
    return EncoderSession(codec_config(video, quality=Qp(qp), **changed), delivery, rule)


def _values(section: object, given: Mapping[str, str]) -> dict[str, Any]:
    return {field: _value(text, getattr(section, field)) for field, text in given.items()}


def _changed(section: Any, given: Mapping[str, str]) -> Any:
    return replace(section, **_values(section, given))


def _patched(name: str, text: str) -> Any:
    module, _, constant = name.rpartition(".")
    usual = getattr(__import__(module, fromlist=[constant]), constant)
    return mock.patch(name, _value(text, usual))


def frame_psnr_db(original: Frame, decoded: Frame) -> float:
    """Return the PSNR of luma, or of all planes if chroma is coded."""
    luma_db = psnr_db(original.luma, decoded.luma)
    if original.chroma is None or decoded.chroma is None:
        return luma_db
    return psnr_yuv_db(luma_db, *map(psnr_db, original.chroma, decoded.chroma))


def coded(trial: Trial, num_frames: int, delivery: Delivery, luma_only: bool = True) -> Coded:
    """Code a clip, and decode it."""
    of_config, constants = divided(trial.settings)
    with ExitStack() as stack, open_video(clip_source(trial.clip).path) as video:
        for name, text in constants.items():
            stack.enter_context(_patched(name, text))
        originals = list(islice(video, num_frames))
        session, stream = encoder_session(video.info, trial.qp, of_config, delivery, luma_only), io.BytesIO()
        session.write(originals, stream, lambda _: None)
        reader, punctured = StreamReader(io.BytesIO(stream.getvalue())), io.BytesIO()
        decoder = GroupDecoder(reader.config)  # in this process, because its constants are changed
        groups = [decoder.decode(task) for task in stream_tasks(reader.config, reader)]
    form = reader.form if isinstance(delivery, NoFeedback) else Form.PUNCTURED
    with StreamWriter(punctured, reader.config, form) as writer:
        for group in groups:
            writer.write_gop(group.record)
    found = [frame for group in groups for frame in group.frames]
    psnrs_db = [frame_psnr_db(*pair) for pair in zip(originals, found, strict=True)]
    return Coded(len(punctured.getvalue()), float(np.mean(psnrs_db)))


def net_percent(found: Mapping[Trial, Coded], trial: Trial) -> float:
    """Return the change of rate minus the value of the change of PSNR on the default curve."""
    usual = sorted(own for at, own in found.items() if at.clip == trial.clip and at.settings == USUAL)
    slope = math.log(usual[-1].num_bytes / usual[0].num_bytes) / (usual[-1].psnr_db - usual[0].psnr_db)
    before, after = found[trial._replace(settings=USUAL)], found[trial]
    return 100 * (math.log(after.num_bytes / before.num_bytes) - slope * (after.psnr_db - before.psnr_db))


def row(found: Mapping[Trial, Coded], settings: str) -> str:
    """Return a line for some settings."""
    net = {trial: net_percent(found, trial) for trial in found if trial.settings == settings}
    values = np.array(list(net.values()))
    error = values.std(ddof=1) / math.sqrt(values.size) if values.size > 1 else math.nan

    def means(field: str) -> str:
        kinds = dict.fromkeys(getattr(trial, field) for trial in net)
        own = {kind: [v for trial, v in net.items() if getattr(trial, field) == kind] for kind in kinds}
        return ", ".join(f"{kind} {np.mean(of):+.1f}" for kind, of in own.items())

    return f"{settings}: {values.mean():+.2f} +- {error:.2f} %; QP {means('qp')}; {means('clip')}"


def left_out(found: Mapping[Trial, Coded]) -> str:
    """Return the change of each clip with the best settings for the remaining clips."""
    clips, tried = (
        [*dict.fromkeys(getattr(trial, name) for trial in found)] for name in ("clip", "settings")
    )
    net = {
        clip: [
            np.mean([net_percent(found, at) for at in found if (at.clip, at.settings) == (clip, settings)])
            for settings in tried
        ]
        for clip in clips
    }
    best = {
        clip: int(np.argmin(np.sum([net[rest] for rest in clips if rest != clip], axis=0))) for clip in clips
    }
    values = [net[clip][best[clip]] for clip in clips]
    chosen = ", ".join(
        f"{clip} {net[clip][best[clip]]:+.1f} ({tried[best[clip]] or 'usual'})" for clip in clips
    )
    return f"each clip with the best settings for the remaining clips: {np.mean(values):+.2f} %; {chosen}"


def main(words: Sequence[str] | None = None) -> None:
    """Print a row for each of the settings."""
    parser = argparse.ArgumentParser("python -m benchmarks.searches.settings", description=__doc__)
    parser.add_argument("settings", nargs="+", metavar="SETTINGS")
    parser.add_argument("--clips", nargs="+", default=CLIPS)
    parser.add_argument("--qp", nargs="+", type=int, default=[32, 38], help="two or more, for the curve")
    parser.add_argument("--frames", type=int, default=65)
    parser.add_argument("--no-feedback", action="store_true")
    parser.add_argument("--colour", action="store_true")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args(words)
    delivery = NoFeedback() if arguments.no_feedback else ParityBuffer()
    if len(set(arguments.qp)) < 2:
        parser.error("--qp: a curve needs two of them")
    tried = (USUAL, *arguments.settings)
    trials = [Trial(*own) for own in product(arguments.clips, arguments.qp, tried)]
    found: dict[Trial, Coded] = {}
    spawning = multiprocessing.get_context("spawn")
    with (
        mock.patch.dict(os.environ, child_environment()),
        ProcessPoolExecutor(arguments.jobs, spawning) as pool,
        progress_bar("streams", len(trials)) as progress,
    ):
        options = {"num_frames": arguments.frames, "delivery": delivery, "luma_only": not arguments.colour}
        results = pool.map(partial(coded, **options), trials)
        for trial, own in zip(trials, results, strict=True):
            found[trial] = own
            progress(1)
    for settings in arguments.settings:
        print(row(found, settings), flush=True)
    if len(arguments.clips) > 1:
        print(left_out(found), flush=True)


if __name__ == "__main__":
    main()
