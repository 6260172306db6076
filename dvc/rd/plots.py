"""Plots of rate-distortion curves and of the frames behind their points."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dvc.rd.curves import ANCHOR_LABEL, Curve, Experiment
from dvc.rd.differences import compare_curves
from dvc.rd.point_result import PointResult
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
FRAME_LINES = {
    "psnr": ("decoded", "-o", ""),
    "refined": ("side information, refined", "--", "#777777"),
    "initial": ("side information, initial", ":", "#333333"),
}
"""Title, line and colour (that of the curve where there is none) of what is drawn of each frame."""
FRAMES_INCHES = (7.0, 3.2)
LABEL_ROOM_PX = 14


@dataclass(frozen=True)
class Style:
    """How a curve is drawn, the same in every plot of a report."""

    colour: str  # of the line, as ``#rrggbb``
    marker: str  # of matplotlib
    dash: str  # of Plotly; a key of `MATPLOTLIB_DASHES`
    is_open: bool  # whether markers are drawn as outlines


def curve_styles(found: Sequence[Experiment]) -> dict[str, Style]:
    """Give every label its style."""
    labels = {curve.label: curve.is_anchor for one in found for curve in one.curves}
    last = {curve.label for one in found for curve in one.curves if curve.has_lossless_keys}
    codecs = [label for label, is_anchor in labels.items() if not is_anchor]
    own = sorted(codecs, key=lambda label: (label in last, label))
    return label_styles(own, sorted(label for label, is_anchor in labels.items() if is_anchor))


def label_styles(codecs: Sequence[str], anchors: Sequence[str]) -> dict[str, Style]:
    """Give every label its style."""
    styles = {}
    for number, label in enumerate(codecs):
        round_, i = divmod(number, len(COLOURS))
        dash = DASHES[round_ % len(DASHES)]
        styles[label] = Style(COLOURS[i], MARKERS[(i + round_) % len(MARKERS)], dash, False)
    for number, label in enumerate(anchors):
        round_, i = divmod(number, len(ANCHOR_COLOURS))
        marker = ANCHOR_MARKERS[(i + round_) % len(ANCHOR_MARKERS)]
        dash = ANCHOR_DASHES[(i + 2 * round_) % len(ANCHOR_DASHES)]
        styles[label] = Style(ANCHOR_COLOURS[i], marker, dash, True)
    return styles


def render_experiment(
    experiment: Experiment,
    styles: Mapping[str, Style],
    suffixes: Sequence[str] = SUFFIXES,
    anchor: str = ANCHOR_LABEL,
) -> dict[str, bytes]:
    """Draw the curves of an experiment, without a file."""
    with new_figure(SIZE_INCHES) as figure:
        _draw(figure.add_subplot(), experiment, styles, experiment.anchor(anchor))
        return {suffix: contents(figure, suffix) for suffix in suffixes}


def render_frames(curve: Curve, point: PointResult, style: Style) -> bytes | None:
    """Draw the PSNR of the frames of a point: decoded, and of the side information where there is any."""
    columns = point.frame_columns
    if "psnr" not in columns:
        return None
    with new_figure(FRAMES_INCHES) as figure:
        axes = figure.add_subplot()
        for name, (title, line, colour) in FRAME_LINES.items():
            values = columns.get(name, [])
            there = [(columns["first"] + i, value) for i, value in enumerate(values) if value is not None]
            if there:
                axes.plot(*zip(*there, strict=True), line, color=colour or style.colour, label=title, ms=3)
        axes.set_title(plain(f"{curve.label}, {point.label}"), fontsize=9)
        axes.set_xlabel("frame")
        axes.set_ylabel("luma PSNR [dB]")
        axes.grid(color="#dddddd", linewidth=0.8)
        axes.legend(loc="best", fontsize=8)
        return contents(figure, ".svg")


def _draw(axes: "Axes", experiment: Experiment, styles: Mapping[str, Style], anchor: Curve | None) -> None:
    curves = [curve for curve in experiment.curves if not curve.has_lossless_keys] or experiment.curves
    codecs = [curve for curve in curves if not curve.is_anchor]
    for curve in curves:
        style = styles[curve.label]
        axes.plot(
            curve.rates_kbps,
            curve.psnrs_y_db,
            color=style.colour,
            marker=style.marker,
            markerfacecolor="none" if style.is_open else style.colour,
            linestyle=MATPLOTLIB_DASHES[style.dash],
            label=plain(_legend(curve, anchor)),
        )
    if any(len(curve.points) > 1 for curve in codecs):
        _focus(axes, codecs)
    if codecs:
        _name_points(axes, codecs[0], styles[codecs[0].label].colour)
    axes.set_title(plain(experiment.title), fontsize=10)
    axes.set_xlabel("rate [kbit/s]")
    axes.set_ylabel("luma PSNR [dB]")
    axes.grid(color="#dddddd", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.legend(loc="best", frameon=True, fontsize=8 if len(curves) > 4 else 10)


def _name_points(axes: "Axes", curve: Curve, colour: str) -> None:
    """Write the presets beside the points of a curve, as far as there is room."""
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


def _focus(axes: "Axes", curves: list[Curve]) -> None:
    """Show the range of the codecs; the anchor may leave it."""
    rates = [rate for curve in curves for rate in curve.rates_kbps]
    psnrs = [psnr for curve in curves for psnr in curve.psnrs_y_db]
    width, height = max(rates) - min(rates), max(max(psnrs) - min(psnrs), 1.0)
    axes.set_xlim(max(0.0, min(rates) - 0.2 * width), max(rates) + 0.3 * max(width, 0.1 * max(rates)))
    axes.set_ylim(min(psnrs) - 0.15 * height, max(psnrs) + 0.12 * height)


def _legend(curve: Curve, anchor: Curve | None) -> str:
    if anchor in (None, curve) or isinstance(difference := compare_curves(anchor, curve), str):
        return curve.label
    against = "" if anchor.label == ANCHOR_LABEL else f" against {anchor.label}"
    in_colour = compare_curves(anchor, curve, "rate", "colour")
    colour = "" if isinstance(in_colour, str) else f", colour {in_colour.value:+.1f} %"
    return f"{curve.label} (BD-rate{against} {difference.value:+.1f} %{colour})"
