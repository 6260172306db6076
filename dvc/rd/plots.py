"""Plots of rate-distortion curves."""

from pathlib import Path
from typing import TYPE_CHECKING

from dvc.files import atomic_output
from dvc.rd.curves import Curve, Experiment, compare_curves

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# The palette of Okabe and Ito, which the colour-blind can tell apart; markers and dashes differ as well.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
MARKERS = ("o", "s", "^", "D", "v", "P")
ANCHOR_COLOUR = "#333333"
SIZE_INCHES = (7.0, 4.8)
DPI = 150
LABEL_ROOM_PX = 14
SUFFIXES = (".png", ".svg")


def plot_experiment(experiment: Experiment, stem: Path) -> list[Path]:
    """Draw the curves of an experiment.

    Parameters
    ----------
    experiment : Experiment
        What was measured on one sequence.
    stem : Path
        Files to write, without suffix.

    Returns
    -------
    list of Path
        The picture as PNG and as SVG.

    Raises
    ------
    DvcError
        If they cannot be written.
    """
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    # A fixed salt and no date: the same results give the same bytes.
    with mpl.rc_context({"svg.hashsalt": "dvc3d", "svg.fonttype": "none", "font.size": 10}):
        figure = Figure(figsize=SIZE_INCHES, layout="constrained")
        FigureCanvasAgg(figure)
        _draw(figure.add_subplot(), experiment)
        paths = [stem.with_name(stem.name + suffix) for suffix in SUFFIXES]
        for path in paths:
            metadata = {"Date": None} if path.suffix == ".svg" else {}
            with atomic_output(path) as temporary:
                figure.savefig(temporary, format=path.suffix[1:], dpi=DPI, metadata=metadata)
    return paths


def _draw(axes: "Axes", experiment: Experiment) -> None:
    anchor = experiment.anchor()
    others = [curve for curve in experiment.curves if not curve.is_anchor]
    for number, curve in enumerate(others):
        colour, marker = COLOURS[number % len(COLOURS)], MARKERS[number % len(MARKERS)]
        axes.plot(
            curve.rates_kbps, curve.psnrs_y_db, color=colour, marker=marker, label=_legend(curve, anchor)
        )
    if anchor is not None:
        style = {"color": ANCHOR_COLOUR, "linestyle": "--", "marker": "x"}
        axes.plot(anchor.rates_kbps, anchor.psnrs_y_db, label=anchor.label, **style)  # type: ignore[arg-type]
    if others:
        _focus(axes, others)
        _name_points(axes, others[0], COLOURS[0])
    axes.set_title(experiment.title, fontsize=10)
    axes.set_xlabel("rate [kbit/s]")
    axes.set_ylabel("luma PSNR [dB]")
    axes.grid(color="#dddddd", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.legend(loc="best", frameon=True)


def _name_points(axes: "Axes", curve: Curve, colour: str) -> None:
    """Write the presets beside the points of a curve, as far as there is room."""
    last = (float("-inf"), float("-inf"))
    for point in curve.points:
        x, y = axes.transData.transform((point.rate_kbps, point.psnr_y_db))
        if max(abs(x - last[0]), abs(y - last[1])) < LABEL_ROOM_PX:
            continue
        last = (x, y)
        preset = point.data["options"].get("wz_q")
        axes.annotate(
            f"QP {point.data['key']['qp']}" if preset is None else f"Q{preset}",
            (point.rate_kbps, point.psnr_y_db),
            xytext=(-5, 6),
            textcoords="offset points",
            color=colour,
            fontsize=8,
            ha="right",
        )


def _focus(axes: "Axes", curves: list[Curve]) -> None:
    """Show the range of the codecs; the anchor may leave it."""
    rates = [rate for curve in curves for rate in curve.rates_kbps]
    psnrs = [psnr for curve in curves for psnr in curve.psnrs_y_db]
    width, height = max(rates) - min(rates), max(max(psnrs) - min(psnrs), 1.0)
    axes.set_xlim(max(0.0, min(rates) - 0.2 * width), max(rates) + 0.3 * max(width, 0.1 * max(rates)))
    axes.set_ylim(min(psnrs) - 0.15 * height, max(psnrs) + 0.12 * height)


def _legend(curve: Curve, anchor: Curve | None) -> str:
    difference = None if anchor is None else compare_curves(anchor, curve)
    if difference is None or isinstance(difference, str):
        return curve.label
    return f"{curve.label} (BD-rate {difference.value:+.1f} %)"
