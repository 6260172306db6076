"""How long decoding takes, beside the presets at equal quality."""

import numpy as np
from numpy.typing import NDArray

from benchmarks.figures.allocation.curves import AREA, TRACKED, curve
from benchmarks.figures.harness import Figure, Measured, Setting
from dvc.errors import DvcError, RdCurveError
from dvc.rd.curves import Curve

NUM_SAMPLES = 201
MOST_RATIO = 1.0


def _seconds(curve: Curve) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return PSNRs in increasing order, and seconds for a Wyner-Ziv frame."""
    found = []
    for point in curve.points:
        decode_s, num_frames = point.total("decode_s"), point.num_frames("wz")
        if decode_s is None or not num_frames:
            raise DvcError(f"{point.name}: no time of Wyner-Ziv frames")
        found.append((point.psnr_y_db, decode_s / num_frames))
    both = np.array(sorted(found), dtype=np.float64)
    return both[:, 0], both[:, 1]


def decoding_time(setting: Setting, clip: str) -> Measured:
    """Compare the mean decoding time of a Wyner-Ziv frame with that of presets."""
    presets, tracked = (_seconds(curve(setting, clip, name)) for name in ("presets", TRACKED))
    low, high = max(presets[0][0], tracked[0][0]), min(presets[0][-1], tracked[0][-1])
    if low >= high:
        raise RdCurveError("no PSNR in common")
    samples = np.linspace(low, high, NUM_SAMPLES)
    presets_s, tracked_s = (float(np.interp(samples, *times).mean()) for times in (presets, tracked))
    ratio = tracked_s / presets_s
    text = f"{ratio:.2f} ({tracked_s:.1f} s against {presets_s:.1f} s, {low:.1f} to {high:.1f} dB)"
    values = {"ratio": ratio, "qp_s": tracked_s, "presets_s": presets_s, "overlap_db": [low, high]}
    return Measured(text, ratio <= MOST_RATIO, values, "times of the points, measured in the same way")


FIGURES = (
    Figure(
        AREA,
        "te-qp-decoding-time",
        "TE (--qp) over TE with presets, at equal PSNR: mean decoding time of a Wyner-Ziv frame",
        "≤ 1.0",
        decoding_time,
        ("box", "tree"),
    ),
)
"""The figures of this module."""
