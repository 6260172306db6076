"""Rate against cost: how much rate a codec needs, and how much processor time its encoder takes for that."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dvc.rd.curves import ANCHOR_LABEL, Curve, Experiment
from dvc.rd.differences import Measure, compare_curves
from dvc.rd.point_result import mean
from dvc.rd.tables import NOTHING
from dvc.web.plotting import SIZE_INCHES, SUFFIXES, contents, new_figure, plain

if TYPE_CHECKING:
    from dvc.rd.plots import Style

CAPTION = (
    "Mean difference in rate at equal PSNR, and processor time of encoding a frame, reading of the input and "
    "loading of code left out: means over the sequences that have both of a codec and of the one it is "
    "compared with; nearer to the lower left is better"
)


@dataclass(frozen=True)
class RateCost:
    """What a codec needs."""

    label: str  # codec
    cost_ms: float  # processor time of encoding a frame, in milliseconds
    bd_rate_percent: float  # difference in rate at equal PSNR to the codec that all are compared with
    num_sequences: int  # over how many sequences these are means
    bd_rate_yuv_percent: float | None = None  # the same in colour, if all of them have that


def rate_costs(found: Sequence[Experiment], reference: str = ANCHOR_LABEL) -> list[RateCost]:
    """Put rate and cost of all codecs side by side."""
    costs: dict[str, list[float]] = {}
    rates: dict[str, list[float]] = {}
    in_colour: dict[str, list[float | None]] = {}
    for one in found:
        anchor = one.anchor(reference)
        for curve in one.curves:
            cost = mean([point.coding_ms for point in curve.points])
            rate = _bd_rate_percent(anchor, curve, "luma")
            if cost and rate is not None:
                costs.setdefault(curve.label, []).append(cost)
                rates.setdefault(curve.label, []).append(rate)
                in_colour.setdefault(curve.label, []).append(_bd_rate_percent(anchor, curve, "colour"))
    points = [
        RateCost(
            label,
            sum(times) / len(times),
            sum(rates[label]) / len(times),
            len(times),
            None if None in in_colour[label] else mean(in_colour[label]),
        )
        for label, times in costs.items()
    ]
    return sorted(points, key=lambda point: (point.cost_ms, point.label))


def _bd_rate_percent(anchor: Curve | None, curve: Curve, measure: Measure) -> float | None:
    """Return the difference in rate of a curve to another, none where they cannot be compared."""
    if anchor is None or curve.has_lossless_keys:
        return None
    if curve is anchor:
        return 0.0 if measure == "luma" or curve.psnrs_yuv_db else None
    difference = compare_curves(anchor, curve, "rate", measure)
    return None if isinstance(difference, str) else difference.value


def rate_cost_cells(points: Sequence[RateCost], reference: str) -> tuple[list[str], list[list[str]]]:
    """Return the table of rate against cost."""
    rows = [[point.label, f"{point.cost_ms:.2f}", f"{point.bd_rate_percent:+.1f} %"] for point in points]
    head = ["codec", "encoder CPU a frame [ms]", f"BD-rate against {reference}"]
    rates_yuv = [point.bd_rate_yuv_percent for point in points]
    if any(rate is not None for rate in rates_yuv):
        head[-1:] = [f"{head[-1]}, luma", f"{head[-1]}, colour"]
        for row, rate in zip(rows, rates_yuv, strict=True):
            row.append(NOTHING if rate is None else f"{rate:+.1f} %")
    rows = [[*row, str(point.num_sequences)] for row, point in zip(rows, points, strict=True)]
    return [*head, "sequences"], rows


def render_rate_cost(
    points: Sequence[RateCost],
    styles: Mapping[str, "Style"],
    reference: str = ANCHOR_LABEL,
    suffixes: Sequence[str] = SUFFIXES,
) -> dict[str, bytes]:
    """Draw rate against cost."""
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
        return {suffix: contents(figure, suffix) for suffix in suffixes}


def _minor_label(value: float, _: object) -> str:
    """Write 2 and 5 times powers of ten, between those powers themselves."""
    return f"{value:g}" if f"{value:e}"[0] in "25" else ""
