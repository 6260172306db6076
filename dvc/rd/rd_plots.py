"""Plots of rate-distortion curves, and of rate against cost, for documents."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dvc.rd.comparison import RateCost
from dvc.rd.rd_curves import ANCHOR_LABEL, Comparison, Curve, Experiment
from dvc.web.plotting import (
    COLOURS,
    DASHES,
    MARKERS,
    MATPLOTLIB_DASHES,
    SIZE_INCHES,
    SUFFIXES,
    contents,
    new_figure,
    plain,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ANCHOR_COLOURS = ("#333333", "#B87F00", "#3D93CC", "#CC79A7", "#777777", "#009E73")
ANCHOR_MARKERS = ("x", "o", "s", "^", "D", "v")
ANCHOR_DASHES = ("dash", "dot", "dashdot", "longdash", "longdashdot", "dash")
LABEL_ROOM_PX = 14


@dataclass(frozen=True)
class Style:
    """Style of a curve, the same in every plot of a report."""

    colour: str  # ``#rrggbb``
    marker: str  # marker of matplotlib
    dash: str  # dash of Plotly; a key of `MATPLOTLIB_DASHES`
    is_open: bool  # draw markers as outlines


def curve_styles(found: Sequence[Experiment]) -> dict[str, Style]:
    """Return the style of every label; curves with lossless key frames come last."""
    labels = {curve.label: curve.is_anchor for one in found for curve in one.curves}
    lossless = {curve.label for one in found for curve in one.curves if curve.has_lossless_keys}
    codecs = sorted((label for label in labels if not labels[label]), key=lambda one: (one in lossless, one))
    styles = {}
    for number, label in enumerate(codecs):
        round_, i = divmod(number, len(COLOURS))
        dash = DASHES[round_ % len(DASHES)]
        styles[label] = Style(COLOURS[i], MARKERS[(i + round_) % len(MARKERS)], dash, False)
    for number, label in enumerate(sorted(label for label in labels if labels[label])):
        round_, i = divmod(number, len(ANCHOR_COLOURS))
        marker = ANCHOR_MARKERS[(i + round_) % len(ANCHOR_MARKERS)]
        dash = ANCHOR_DASHES[(i + 2 * round_) % len(ANCHOR_DASHES)]
        styles[label] = Style(ANCHOR_COLOURS[i], marker, dash, True)
    return styles


def render_experiment(
    experiment: Experiment, styles: Mapping[str, Style], anchor: str = ANCHOR_LABEL
) -> dict[str, bytes]:
    """Draw the curves of an experiment; return the files by suffix."""
    reference = experiment.anchor(anchor)
    curves = [curve for curve in experiment.curves if not curve.has_lossless_keys] or experiment.curves
    codecs = [curve for curve in curves if not curve.is_anchor]
    with new_figure(SIZE_INCHES) as figure:
        axes = figure.add_subplot()
        for curve in curves:
            style = styles[curve.label]
            axes.plot(
                curve.rates_kbps,
                curve.psnrs_y_db,
                color=style.colour,
                marker=style.marker,
                markerfacecolor="none" if style.is_open else style.colour,
                linestyle=MATPLOTLIB_DASHES[style.dash],
                label=plain(_legend(curve, reference)),
            )
        if any(len(curve.points) > 1 for curve in codecs):
            _zoom_to(axes, codecs)
        if codecs:
            _name_points(axes, codecs[0], styles[codecs[0].label].colour)
        axes.set_title(plain(experiment.title), fontsize=10)
        axes.set_xlabel("rate [kbit/s]")
        axes.set_ylabel("luma PSNR [dB]")
        axes.grid(color="#dddddd", linewidth=0.8)
        axes.set_axisbelow(True)
        axes.legend(loc="best", frameon=True, fontsize=8 if len(curves) > 4 else 10)
        return {suffix: contents(figure, suffix) for suffix in SUFFIXES}


def _name_points(axes: "Axes", curve: Curve, colour: str) -> None:
    """Write the levels next to the points of a curve if they have room."""
    last = (float("-inf"), float("-inf"))
    for point in curve.points:
        x, y = axes.transData.transform((point.rate_kbps, point.psnr_y_db))
        if max(abs(x - last[0]), abs(y - last[1])) < LABEL_ROOM_PX:
            continue
        last = (x, y)
        axes.annotate(
            point.level,
            (point.rate_kbps, point.psnr_y_db),
            xytext=(-5, 6),
            textcoords="offset points",
            color=colour,
            fontsize=8,
            ha="right",
        )


def _zoom_to(axes: "Axes", curves: list[Curve]) -> None:
    """Show the range of some curves; anchors may leave it."""
    rates = [rate for curve in curves for rate in curve.rates_kbps]
    psnrs = [psnr for curve in curves for psnr in curve.psnrs_y_db]
    width, height = max(rates) - min(rates), max(max(psnrs) - min(psnrs), 1.0)
    axes.set_xlim(max(0.0, min(rates) - 0.2 * width), max(rates) + 0.3 * max(width, 0.1 * max(rates)))
    axes.set_ylim(min(psnrs) - 0.15 * height, max(psnrs) + 0.12 * height)


def _legend(curve: Curve, anchor: Curve | None) -> str:
    if anchor is None or anchor is curve:
        return curve.label
    rates = Comparison("", anchor, curve).rates
    luma, in_colour = rates["luma"], rates["colour"]
    if isinstance(luma, str):
        return curve.label
    against = "" if anchor.label == ANCHOR_LABEL else f" against {anchor.label}"
    colour = "" if isinstance(in_colour, str) else f", colour {in_colour.value:+.1f} %"
    return f"{curve.label} (BD-rate{against} {luma.value:+.1f} %{colour})"


def render_rate_cost(
    points: Sequence[RateCost], styles: Mapping[str, Style], reference: str = ANCHOR_LABEL
) -> dict[str, bytes]:
    """Draw rate against cost; return the files by suffix."""
    with new_figure(SIZE_INCHES) as figure:
        from matplotlib.ticker import FuncFormatter

        axes = figure.add_subplot()
        for point in points:
            style = styles[point.label]
            axes.plot(
                [point.cost_ms],
                [point.bd_rate_percent],
                color=style.colour,
                marker=style.marker,
                markersize=8,
                markerfacecolor="none" if style.is_open else style.colour,
                linestyle="none",
                label=plain(point.label),
            )
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.xaxis.set_minor_formatter(FuncFormatter(_minor_label))
        axes.set_xlabel("processor time of encoding a frame [ms]")
        axes.set_ylabel(plain(f"BD-rate against {reference} [%]"))
        axes.grid(color="#dddddd", linewidth=0.8, which="both")
        axes.set_axisbelow(True)
        axes.legend(loc="best", fontsize=8)
        return {suffix: contents(figure, suffix) for suffix in SUFFIXES}


def _minor_label(value: float, _: object) -> str:
    """Label only 2 and 5 times powers of ten between the powers themselves."""
    return f"{value:g}" if f"{value:e}"[0] in "25" else ""
