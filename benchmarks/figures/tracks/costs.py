"""Tracked points: bits, operations and processor time at the encoder, and the time of a whole decoding."""

import statistics
import tempfile
import time
from functools import partial
from pathlib import Path

from benchmarks.figures.codec import FINEST, encode
from benchmarks.figures.harness import (
    SCENES,
    Figure,
    Measured,
    Setting,
    clip_source,
    run_module,
)
from benchmarks.figures.tracks.prediction import received_groups
from benchmarks.figures.tracks.quality import AREA, QUICK_FRAMES, REAL_CLIPS
from benchmarks.figures.tracks.runs import GOP, TD_DEPTH, TE_DEPTH, Run, Way
from dvc.config import (
    CodecConfig,
    KeyFrameConfig,
    VideoConfig,
    WynerZivConfig,
    key_qp_for,
)
from dvc.errors import DvcError
from dvc.keyframes import KeyFrameEncoder
from dvc.video import Frame, open_video
from encoder.session import EncoderSession

SEARCH_REACHES_PX = (16, 7)
"""Reaches of a full search to compare with: that of most block-motion coders, and a small one."""
MOST_SHARE = 0.08
MOST_DECODING_S = 90.0


def overhead(setting: Setting, clip: str, way: Way, most_bpp: float) -> Measured:
    """Count the bits of tracks or points."""
    gop = None if way.codec == "3d-te" else GOP[way.codec]
    bits, num_frames, num_pixels = 0, 0, 0
    num_points: list[int] = []
    for group in received_groups(Run(clip, way, setting.choose(setting.frames, QUICK_FRAMES), gop)):
        bits += group.tracks_bits
        num_frames += len(group.originals)
        num_pixels = group.originals[0].luma.size
        num_points += group.num_points
    if not num_frames:
        raise DvcError("no Wyner-Ziv frames")
    bpp, points = bits / (num_frames * num_pixels), statistics.fmean(num_points)
    values = {"tracks_bpp": bpp, "mean_points": points, "num_frames": num_frames}
    return Measured(f"{bpp:.4f} b/px ({points:.0f} points a frame)", bpp < most_bpp, values)


def encoder_session(frames: list[Frame]) -> EncoderSession:
    """Prepare an encoder of 3d-te at the finest quantiser with the settings that it has by itself."""
    video = VideoConfig(frames[0].width, frames[0].height, 25, 1, luma_only=True)
    return EncoderSession(
        CodecConfig.preset(
            "3d-te",
            video,
            key=KeyFrameConfig(key_qp_for(FINEST)),
            wyner_ziv=WynerZivConfig.preset(FINEST),
        )
    )


def _grey_frames(clip: str, num_frames: int) -> list[Frame]:
    with open_video(clip_source(clip).path, num_frames=num_frames) as reader:
        return [frame.without_chroma() for frame in reader]


def _encoding_times_s(
    session: EncoderSession, intra: KeyFrameEncoder, frames: list[Frame]
) -> tuple[float, float]:
    """Encode group by group with both in turn; return the processor time of each."""
    ours_s, intra_s = 0.0, 0.0
    groups = session.groups(frames)
    while True:
        started = time.process_time()
        group = next(groups, None)
        if group is None:
            return ours_s, intra_s
        for encoded in session.encode(group).frames:
            encoded.buffered_payload()
        between = time.process_time()
        for frame in (*group.wyner_ziv, group.key):
            intra.encode(frame)
        ours_s += between - started
        intra_s += time.process_time() - between


def operations(setting: Setting, clip: str) -> Measured:
    """Count samples that the tracker compares, against those of a full search of all 8x8 blocks."""
    frames = _grey_frames(clip, setting.choose(setting.frames, QUICK_FRAMES))
    session = encoder_session(frames)
    for group in session.groups(frames):
        session.encode(group)
    found = session.statistics
    compared = found.num_sad_samples / max(found.num_tracked_frames, 1)
    shares = {reach: compared / (frames[0].luma.size * (2 * reach + 1) ** 2) for reach in SEARCH_REACHES_PX}
    parts = [f"{100 * share:.2f} % of a search of ±{reach} px" for reach, share in shares.items()]
    values = {"samples_per_frame": compared, "share_by_reach_px": list(shares.items())}
    values["blocks_per_frame"] = found.num_sad_blocks / max(found.num_tracked_frames, 1)
    return Measured(", ".join(parts), shares[SEARCH_REACHES_PX[0]] <= MOST_SHARE, values)


def encoder_cpu(setting: Setting, clip: str) -> Measured:
    """Compare the processor time of the encoder, tracking included, with that of H.264 intra of all frames.
    Compare the processor time of the encoder, tracking included, with that of H.264 intra of all frames.
    """
    frames = _grey_frames(clip, setting.choose(41, QUICK_FRAMES))
    intra = KeyFrameEncoder(frames[0].width, frames[0].height, key_qp_for(FINEST), luma_only=True)
    _encoding_times_s(encoder_session(frames), intra, frames[:5])
    session = encoder_session(frames)
    ours_s, intra_s = _encoding_times_s(session, intra, frames)
    ours_ms, intra_ms = 1000 * ours_s / len(frames), 1000 * intra_s / len(frames)
    tracking_ms = 1000 * session.statistics.tracking_cpu_s / len(frames)
    values = {"ours_ms": ours_ms, "tracking_ms": tracking_ms, "intra_ms": intra_ms, "num_frames": len(frames)}
    text = f"{ours_ms:.1f} ms (tracking {tracking_ms:.1f} ms), H.264 intra {intra_ms:.1f} ms"
    return Measured(text, ours_ms <= intra_ms, values)


def decoding_time(setting: Setting, clip: str) -> Measured:
    """Time the decoding of 50 frames with two jobs, start-up included."""
    frames = setting.choose(50, QUICK_FRAMES)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        encode(clip, folder / "s.dvc", "--codec", "3d-te", "--wz-q", 4, "--frames", frames)
        usage = run_module("decoder", [folder / "s.dvc", folder / "v.y4m", "--quiet", "--jobs", 2])
    values = {"wall_s": usage.wall_s, "cpu_s": usage.cpu_s, "num_frames": frames}
    text = f"{usage.wall_s:.0f} s (processor time {usage.cpu_s:.0f} s)"
    return Measured(text, usage.wall_s <= MOST_DECODING_S, values)


_CLIPS = (*REAL_CLIPS, *SCENES)
FIGURES = (
    Figure(
        AREA,
        "te-overhead",
        "bits of tracks per pixel of the WZ frames, TE, 128 points, key frames as the tracks choose them",
        "< 0.01 b/px",
        partial(overhead, way=TE_DEPTH, most_bpp=0.01),
        _CLIPS,
        "< 0.01 b/px",
    ),
    Figure(
        AREA,
        "td-overhead",
        "bits of points per pixel of the WZ frames, TD, 176 points, GOP 10",
        "< 0.02 b/px",
        partial(overhead, way=TD_DEPTH, most_bpp=0.02),
        _CLIPS,
        "0.02 b/px",
    ),
    Figure(
        AREA,
        "te-operations",
        "samples compared by the tracker against full-search 8x8 block motion of the same frame",
        "≤ 8 %",
        operations,
        _CLIPS,
        "8 %",
    ),
    Figure(
        AREA,
        "te-encoder-cpu",
        "processor time of the TE encoder per frame, tracking and key frames included, Q8",
        "≤ x264 intra (medium, one thread)",
        encoder_cpu,
        _CLIPS,
    ),
    Figure(
        AREA,
        "te-decoding-time",
        "full TE decoding of 50 CIF frames, Q4, two jobs",
        "≤ 90 s",
        decoding_time,
        ("box", "tree", "street"),
    ),
)
"""The figures of this module."""
