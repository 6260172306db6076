"""Which codec is better: every curve against every other, on every sequence."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dvc.rd.curves import Curve, Experiment
from dvc.rd.differences import NO_CHROMA, Measure, compare_curves, crossing_text, told_measures
from dvc.rd.point_result import mean
from dvc.rd.tables import NOTHING

if TYPE_CHECKING:
    from dvc.metrics import BdResult

MIN_PERCENT = 0.05
"""Smaller differences in rate are rounded to none."""


@dataclass(frozen=True)
class Row:
    """One curve against the anchor on one sequence, as text."""

    sequence: str  # what is compared
    codec: str
    rate: str  # BD-rate and BD-PSNR of luma, or why there is none
    psnr: str
    rate_yuv: str  # the same in colour
    psnr_yuv: str
    overlap: str  # what the figure rests on
    points: str
    where: str  # at which rates the codec is better
    verdict: str  # ``better``, ``worse`` or ``none``


@dataclass(frozen=True)
class Cell:
    """A cell of the matrix of BD-rates."""

    text: str  # such as ``−12.3 %``
    verdict: str  # as in `Row`


@dataclass(frozen=True)
class Verdict:
    """All curves against one."""

    anchor: str  # its label
    codecs: tuple[str, ...]  # labels of the others
    measures: tuple[Measure, ...]  # which BD-rates the matrix has a column for, of each codec
    # name and cells of each sequence; the means last, where there are several sequences
    matrix: tuple[tuple[str, tuple[Cell, ...]], ...]
    rows: tuple[Row, ...]  # the same with everything that it rests on

    @property
    def columns(self) -> list[str]:
        """Titles of the columns of the matrix."""
        if len(self.measures) == 1:
            return list(self.codecs)
        return [f"{label}: {measure}" for label in self.codecs for measure in self.measures]


def verdicts(found: Sequence[Experiment]) -> list[Verdict]:
    """Compare every curve with every other of the same frames."""
    labels = {
        curve.label: curve.is_anchor for one in found for curve in one.curves if not curve.has_lossless_keys
    }
    ordered = sorted(labels, key=lambda label: (labels[label], label))
    built = [_verdict(found, anchor, [label for label in ordered if label != anchor]) for anchor in ordered]
    return [verdict for verdict in built if verdict.rows]


def signed(value: float, decimals: int, unit: str) -> str:
    """Write a difference with its sign."""
    return f"{value:+.{decimals}f} {unit}".replace("-", "−")


def _verdict(found: Sequence[Experiment], anchor: str, labels: Sequence[str]) -> Verdict:
    measures = told_measures(any(one.in_colour for one in found))
    pairs = [
        (one.name, reference, {label: curve for label in labels if (curve := one.anchor(label)) is not None})
        for one in found
        if (reference := one.anchor(anchor)) is not None
    ]
    kept = [label for label in labels if any(label in curves for _, _, curves in pairs)]
    matrix = []
    rates: list[list[float | None]] = []
    for name, reference, curves in pairs:
        differences = [
            compare_curves(reference, curves[label], "rate", measure) if label in curves else None
            for label in kept
            for measure in measures
        ]
        rates.append([getattr(difference, "value", None) for difference in differences])
        matrix.append((name, tuple(_cell(difference) for difference in differences)))
    matrix += _mean_line([list(column) for column in zip(*rates, strict=True)])
    rows = [
        _compare(name, reference, curve) for name, reference, curves in pairs for curve in curves.values()
    ]
    return Verdict(anchor, tuple(kept), measures, tuple(matrix), tuple(rows))


def _compare(name: str, reference: Curve, curve: Curve) -> Row:
    difference = compare_curves(reference, curve)
    overlap, points = NOTHING, f"{len(curve.points)} and {len(reference.points)}"
    psnr, verdict = NOTHING, "none"
    if not isinstance(difference, str):
        low, high = difference.overlap
        overlap = f"{low:.1f} to {high:.1f} dB ({100 * difference.overlap_share:.0f} %)"
        points = f"{difference.num_points[1]} and {difference.num_points[0]}"
        psnr, verdict = (
            _text(compare_curves(reference, curve, "psnr"), 2, "dB"),
            _verdict_of(difference.value),
        )
    return Row(
        sequence=name,
        codec=curve.label,
        rate=_text(difference, 1, "%"),
        psnr=psnr,
        rate_yuv=_text(compare_curves(reference, curve, "rate", "colour"), 1, "%"),
        psnr_yuv=_text(compare_curves(reference, curve, "psnr", "colour"), 2, "dB"),
        overlap=overlap,
        points=points,
        where=crossing_text(reference, curve),
        verdict=verdict,
    )


def _text(difference: "BdResult | str", decimals: int, unit: str) -> str:
    if difference == NO_CHROMA:
        return NOTHING
    if isinstance(difference, str):
        return f"not comparable: {difference}"
    return signed(difference.value, decimals, unit)


def _cell(difference: "BdResult | str | None") -> Cell:
    if difference is None or difference == NO_CHROMA:
        return Cell(NOTHING, "none")
    if isinstance(difference, str):
        return Cell("not comparable", "none")
    return Cell(signed(difference.value, 1, "%"), _verdict_of(difference.value))


def _verdict_of(rate: float) -> str:
    """Judge a difference in per cent; what is shown as nothing is nothing."""
    if abs(rate) < MIN_PERCENT:
        return "none"
    return "better" if rate < 0 else "worse"


def _mean_line(columns: Sequence[list[float | None]]) -> list[tuple[str, tuple[Cell, ...]]]:
    """Return the mean of every column over the sequences on which it has a figure, if these are several."""
    cells = []
    for rates in columns:
        count, value = sum(rate is not None for rate in rates), mean(rates)
        if count < 2 or value is None:
            cells.append(Cell(NOTHING, "none"))
        else:
            cells.append(Cell(f"{signed(value, 1, '%')} ({count})", _verdict_of(value)))
    return [("mean (sequences)", tuple(cells))] if any(cell.text != NOTHING for cell in cells) else []
