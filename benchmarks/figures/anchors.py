"""Anchors: x264 as it is run here against the H.264 reference software, on the same frames."""

import os
import tempfile
from pathlib import Path

from benchmarks.figures.harness import FOREMAN, Figure, Measured, MissingClip, Setting, clip_source
from dvc.metrics import bd_rate
from dvc.rd.anchors.codecs import ANCHOR_CODECS
from dvc.rd.anchors.decoding import measure_file
from dvc.rd.anchors.encoding import encode_file
from dvc.rd.reference_rows import ROWS_VARIABLE, ReferenceRow, read_reference_rows

LIMIT_PERCENT = 5.0
QUICK_QPS = (28, 36)
_COUNTERPARTS = {"x264-intra": "jm95-intra", "x264-ippp-zero": "jm95-ippp-zero"}


def _reference(clip: str, codec: str, setting: Setting) -> list[ReferenceRow]:
    """Find the rows of the reference software; in a quick run two of them."""
    name = os.environ.get(ROWS_VARIABLE)
    if not name:
        raise MissingClip(f"the rows of the reference software: set {ROWS_VARIABLE} to the file")
    rows = [
        row
        for row in read_reference_rows(Path(name))
        if (row.clip, row.codec) == (clip, _COUNTERPARTS[codec])
    ]
    if not rows:
        raise MissingClip(f"the reference software has no rows of {clip}")
    return [row for row in rows if not setting.quick or row.qp in QUICK_QPS]


def _measure(clip: str, codec: str, rows: list[ReferenceRow]) -> list[dict[str, float]]:
    """Measure our anchor at the QPs of the rows."""
    source, anchor = clip_source(clip).path, ANCHOR_CODECS[codec]
    points = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"stream{anchor.suffix}"
        for row in rows:
            encode_file(source, path, anchor, row.qp, 0, row.frames)
            found = measure_file(path, source, zero_motion=anchor.zero_motion)
            point = {"qp": row.qp, "num_bits": 8 * found["totals"]["stream_bytes"]}
            point["psnr_y_db"] = found["totals"]["psnr_y_db"]
            vectors = ("num_vectors", "num_nonzero_vectors")
            points.append(point | {name: found[name] for name in vectors if name in found})
    return points


def _against_reference(setting: Setting, clip: str, codec: str) -> Measured:
    rows = _reference(clip, codec, setting)
    points = _measure(clip, codec, rows)
    difference = bd_rate(
        [row.num_bits for row in rows],
        [row.psnr_y_db for row in rows],
        [point["num_bits"] for point in points],
        [point["psnr_y_db"] for point in points],
    )
    low, high = difference.overlap
    text = f"{difference.value:+.2f} % ({low:.1f} to {high:.1f} dB)"
    values = {"bd_rate_percent": difference.value, "overlap_db": [low, high], "points": points}
    return Measured(text, abs(difference.value) <= LIMIT_PERCENT, values)


def intra(setting: Setting, clip: str) -> Measured:
    """Compare x264 intra with the reference software's."""
    return _against_reference(setting, clip, "x264-intra")


def zero_motion(setting: Setting, clip: str) -> Measured:
    """Compare x264 IPPP with motion vectors of zero with the reference software's."""
    return _against_reference(setting, clip, "x264-ippp-zero")


def moving_vectors(setting: Setting, clip: str) -> Measured:
    """Count the motion vectors that are not zero in the files of x264 without motion."""
    points = _measure(clip, "x264-ippp-zero", _reference(clip, "x264-ippp-zero", setting))
    moving, count = (
        sum(int(point[name]) for point in points) for name in ("num_nonzero_vectors", "num_vectors")
    )
    return Measured(f"{moving} of {count}", moving == 0 < count, {"num_vectors": count})


AREA = "anchors"
_CLIPS = ("box", "tree", "stone", FOREMAN)
_TITLE = "BD-rate of x264 {} against JM 9.5, luma only, CABAC, 51 frames, QP 20 to 40"
FIGURES = (
    Figure(AREA, "intra", _TITLE.format("intra"), "within ±5 %", intra, _CLIPS),
    Figure(AREA, "zero-motion", _TITLE.format("IPPP, zero motion,"), "within ±5 %", zero_motion, _CLIPS),
    Figure(
        AREA,
        "moving-vectors",
        "motion vectors of x264 IPPP, zero motion, that are not zero, QP 20 to 40",
        "0",
        moving_vectors,
        _CLIPS,
    ),
)
"""Figures of this area."""
