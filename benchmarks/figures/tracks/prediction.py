"""Side information as a decoder makes it from what an encoder sent: tracks or points through their payloads.

What figures and pictures of tracked coding have in common. The encoder chooses the key frames and follows or
finds the points on original frames; the decoder gets decoded key frames and what the payload says.
"""

import json
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.figures.harness import clip_source
from benchmarks.figures.tracks.runs import GOP, Run, Way
from decoder.side_information.methods import METHODS
from decoder.side_information.protocol import Prediction, ReferenceFrame
from dvc import cli
from dvc.config import (
    VARIANTS,
    CodecConfig,
    GeometryConfig,
    GopConfig,
    KeyFrameConfig,
    KeyFrameRule,
    VideoConfig,
)
from dvc.keyframes import KeyFrameDecoder
from dvc.metrics import psnr_db
from dvc.rd.provenance import code_version
from dvc.tracks import FeaturePoints, PointTracks, decode_points, decode_tracks
from dvc.video import Frame, open_video
from dvc.wynerziv.transform import to_uint8
from encoder.session import EncoderSession

FOLDER = "tracks"


@dataclass(frozen=True, eq=False)
class ReceivedGroup:
    """A group of pictures at the decoder, and the originals to compare with."""

    keys: tuple[ReferenceFrame, ReferenceFrame]  # decoded key frames around it
    originals: tuple[Frame, ...]  # its Wyner-Ziv frames
    points: PointTracks | FeaturePoints | None  # as decoded from the payload; None if there is none
    tracks_bits: int  # length of the payload

    @property
    def num_points(self) -> list[int]:
        """Number of points that are known of each Wyner-Ziv frame."""
        if self.points is None:
            return [0] * len(self.originals)
        if isinstance(self.points, FeaturePoints):
            return [len(points) for points in self.points.frames]
        known = np.isfinite(self.points.positions[:, 1:-1, 0])
        return [int(count) for count in known.sum(axis=0)]


@dataclass(frozen=True)
class FrameResult:
    """What the side information of a frame was worth."""

    index: int  # display position
    psnr_db: float  # of its luma
    success: bool  # false where the method fell back


def configuration(run: Run, video: VideoConfig) -> CodecConfig:
    """Return the configuration that the key frames and points of a run are coded with."""
    codec, bits = run.coding, run.way.subpixel_bits
    tracks = VARIANTS[codec].tracks
    return CodecConfig.preset(
        codec,
        video,
        gop=GopConfig(run.gop or GOP[codec]),
        key=KeyFrameConfig(lossless=True) if run.key_qp is None else KeyFrameConfig(run.key_qp),
        tracks=tracks if bits is None else replace(tracks, subpixel_bits=bits),
    )


def key_frame_rule(gop: int | None) -> KeyFrameRule:
    """Return the rule that the tracks choose key frames by."""
    if gop is None:
        return KeyFrameRule()
    return KeyFrameRule(longest_track_px=math.inf, lost_share=1.0, min_length=gop, cut_share=1.0)


def received_groups(run: Run) -> Iterator[ReceivedGroup]:
    """Encode a sequence, and decode key frames and points."""
    with open_video(clip_source(run.clip).path, num_frames=run.num_frames) as reader:
        rate = reader.info.frame_rate
        video = VideoConfig(
            reader.info.width, reader.info.height, rate.numerator, rate.denominator, luma_only=True
        )
        session = EncoderSession(configuration(run, video), key_frame_rule(run.gop))
        config = session.config
        decoder = KeyFrameDecoder(video.width, video.height, config.key.parameter_sets, luma_only=True)
        before: ReferenceFrame | None = None
        for group in session.groups(frame.without_chroma() for frame in reader):
            encoded = session.encode(group)
            index = 0 if before is None else before.index + len(group.wyner_ziv) + 1
            key = ReferenceFrame(index, decoder.decode(encoded.key))
            if before is not None and group.wyner_ziv:
                points = _received(encoded.tracks, len(group.wyner_ziv), config)
                yield ReceivedGroup((before, key), group.wyner_ziv, points, 8 * len(encoded.tracks))
            before = key


def _received(payload: bytes, num_frames: int, config: CodecConfig) -> PointTracks | FeaturePoints | None:
    if not payload:
        return None
    if config.tracks.kind == "encoder":
        return decode_tracks(payload, num_frames + 2, config)
    return decode_points(payload, num_frames, config)


def predictions(run: Run) -> Iterator[tuple[ReceivedGroup, list[tuple[int, Prediction]]]]:
    """Predict the frames of a sequence from key frames alone."""
    method = None
    for group in received_groups(run):
        if method is None:
            luma = group.keys[0].frame.luma
            video = VideoConfig(luma.shape[1], luma.shape[0], 25, 1, luma_only=True)
            method = METHODS[run.way.method](_prediction_configuration(run.way, video))
        points = group.points if run.way.codec == run.coding else None
        instants = list(range(group.keys[0].index + 1, group.keys[1].index, run.every))
        yield group, list(zip(instants, method.predict(group.keys, points, instants), strict=True))


def _prediction_configuration(way: Way, video: VideoConfig) -> CodecConfig:
    """Return the configuration that frames are predicted with."""
    variant = VARIANTS[way.codec]
    side_information = replace(
        variant.side_information, method=way.method, track_corrections=way.track_corrections
    )
    geometry = GeometryConfig(path_regularity=way.path_regularity)
    return CodecConfig.preset(
        way.codec, video, gop=GopConfig(), side_information=side_information, geometry=geometry
    )


def frame_results(run: Run, folder: Path) -> tuple[FrameResult, ...]:
    """Measure the side information of every frame of a run, unless this version of the code has done so."""
    return _frame_results(run, folder / FOLDER / f"{run.stem}.json")


@cache
def _frame_results(run: Run, path: Path) -> tuple[FrameResult, ...]:
    identity = {"run": asdict(run), "code": code_version().digest}
    if path.exists():
        known = json.loads(path.read_text(encoding="utf-8"))
        if all(known[name] == value for name, value in identity.items()):
            return tuple(FrameResult(**frame) for frame in known["frames"])
    found = []
    for group, predicted in predictions(run):
        for index, prediction in predicted:
            original = group.originals[index - group.keys[0].index - 1]
            quality_db = psnr_db(original.luma, to_uint8(prediction.luma))
            found.append(FrameResult(index, quality_db, prediction.success))
    path.parent.mkdir(parents=True, exist_ok=True)
    cli.write_json(path, {**identity, "frames": [asdict(frame) for frame in found]})
    return tuple(found)


def mean_db(run: Run, folder: Path) -> float:
    """Return the mean PSNR of the side information of a run."""
    return float(np.mean([frame.psnr_db for frame in frame_results(run, folder)]))
