"""Quality of chroma at equal luma."""

import numpy as np

from benchmarks.figures import rates as rd_figures
from benchmarks.figures.allocation.curves import AREA
from benchmarks.figures.harness import Figure, Measured, Setting
from dvc.errors import DvcError, RdCurveError
from dvc.rd.curves import Curve, experiments
from dvc.rd.specification import Sweep, expand

FRAMES = 17
QPS = (28, 36)
INTRA_QPS = (22, 26, 30, 34, 38, 42)
MOST_BELOW_DB = 1.0


def _chroma_db(curve: Curve) -> tuple[list[float], list[float]]:
    """Return PSNRs of luma in increasing order, and means of those of Cb and Cr."""
    found = []
    for point in curve.points:
        cb_db, cr_db = point.total("psnr_cb_db"), point.total("psnr_cr_db")
        if cb_db is None or cr_db is None:
            raise DvcError(f"{point.name}: no PSNR of chroma")
        found.append((point.psnr_y_db, (cb_db + cr_db) / 2))
    found.sort()
    return [luma for luma, _ in found], [chroma for _, chroma in found]


def chroma(setting: Setting, clip: str) -> Measured:
    """Compare chroma with that of H.264 intra at equal PSNR of luma, in colour."""
    frames = setting.choose(FRAMES, rd_figures.QUICK_FRAMES)
    sweep = Sweep((clip,), frames=frames, qp=QPS, luma_only=False, anchors=("intra",), anchor_qp=INTRA_QPS)
    [found] = experiments(rd_figures.measured(setting, clip, expand([sweep])))
    anchor = found.anchor()
    assert anchor is not None
    luma_db, chroma_db = _chroma_db(next(one for one in found.curves if not one.is_anchor))
    intra_luma_db, intra_chroma_db = _chroma_db(anchor)
    if not intra_luma_db[0] <= luma_db[0] <= luma_db[-1] <= intra_luma_db[-1]:
        raise RdCurveError(f"luma of {luma_db} dB, of H.264 intra {intra_luma_db} dB")
    gains_db = (np.array(chroma_db) - np.interp(luma_db, intra_luma_db, intra_chroma_db)).tolist()
    mean_db = sum(gains_db) / len(gains_db)
    values = {"luma_db": luma_db, "chroma_db": chroma_db, "difference_db": gains_db, "mean_db": mean_db}
    each = ", ".join(f"{gain:+.2f} at {luma:.1f} dB" for gain, luma in zip(gains_db, luma_db, strict=True))
    return Measured(f"{mean_db:+.2f} dB ({each})", mean_db >= -MOST_BELOW_DB, values)


FIGURES = (
    Figure(
        AREA,
        "te-qp-chroma",
        "TE (--qp) in colour, 17 frames, mean PSNR of Cb and Cr over H.264 intra's at equal luma",
        "≥ −1 dB",
        chroma,
        ("box", "tree"),
    ),
)
"""The figures of this module."""
