"""The plot of rate and PSNR: the default codec and the anchors, from the folder of the sweep."""

from pathlib import Path

from benchmarks.results import curves
from benchmarks.results.code import ROOT
from benchmarks.results.harness import Setting
from dvc.errors import DvcError
from dvc.files import atomic_output
from dvc.rd.anchors import ANCHOR_CODECS
from dvc.rd.rd_curves import Curve
from dvc.rd.specification import ANCHORS
from dvc.web.plotting import new_figure

PLOT = ROOT / "docs" / "rd.svg"
CLIPS = ("box", "street")
SHOWN = ("intra", "x264-ippp", "x264-medium", "x265-medium", "svtav1-6")
TITLE = "3D-DVC-TE (default)"


def draw(setting: Setting, path: Path = PLOT) -> bool:
    """Draw the results of the sweeps, and return whether they are complete."""
    try:
        found = {clip: curves_of(setting, clip) for clip in CLIPS}
    except (DvcError, OSError):
        return False
    with atomic_output(path) as temporary:
        temporary.write_bytes(_drawn(found))
    return True


def curves_of(setting: Setting, clip: str) -> dict[str, Curve]:
    """Return the curves of a clip, by the names that the plot has for them."""
    count = curves.frames(setting)
    found = {TITLE: curves.curves_in(setting, curves.DEFAULT, [clip], count)[clip]}
    for anchor in SHOWN:
        label = "H.264 intra" if anchor == "intra" else ANCHOR_CODECS[ANCHORS[anchor]].label
        found[label] = curves.curves_in(setting, curves.DEFAULT, [clip], count, anchor)[clip]
    return found


def _drawn(found: dict[str, dict[str, Curve]]) -> bytes:
    from io import BytesIO

    settings = {"svg.hashsalt": "rd", "svg.fonttype": "path", "font.size": 8}
    with new_figure((4.2 * len(found), 3.4), settings) as figure:
        axes = figure.subplots(1, len(found))
        for place, (clip, by_name) in zip(axes, found.items(), strict=True):
            own = by_name[TITLE]
            for name, curve in by_name.items():
                style = (
                    {"linewidth": 2.2, "marker": "o"} if name == TITLE else {"linewidth": 1.0, "marker": "."}
                )
                place.plot(curve.rates_kbps, curve.psnrs_y_db, label=name, **style)
            place.set(xscale="log", xlabel="rate, kbit/s", ylabel="luma PSNR, dB", title=clip)
            place.set_ylim(min(own.psnrs_y_db) - 1.0, max(own.psnrs_y_db) + 1.0)
            place.grid(alpha=0.3)
        axes[0].legend(fontsize=6)
        buffer = BytesIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()
