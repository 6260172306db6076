"""Which codec is better: every curve against every other, on every sequence."""

from collections.abc import Sequence
from dataclasses import dataclass

from dvc.rd.curves import Curve, Experiment
from dvc.rd.differences import compare_curves, crossing_text
from dvc.rd.point_result import mean
from dvc.rd.tables import NOTHING

MIN_PERCENT = 0.05
"""Smaller differences in rate are rounded to none."""


@dataclass(frozen=True)
class Row:
    """One curve against the anchor on one sequence, as text."""

    sequence: str  # what is compared
    codec: str
    rate: str  # BD-rate and BD-PSNR, or why there is none
    psnr: str
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
    codecs: tuple[str, ...]  # labels of the others, columns of the matrix
    # name and cells of each sequence; the means last, where there are several sequences
    matrix: tuple[tuple[str, tuple[Cell, ...]], ...]
    rows: tuple[Row, ...]  # the same with everything that it rests on


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
    rows: list[Row] = []
    rates: dict[str, list[float | None]] = {label: [] for label in labels}
    matrix = []
    for one in found:
        reference = one.anchor(anchor)
        if reference is None:
            continue
        cells = []
        for label in labels:
            curve = one.anchor(label)
            row, rate = (None, None) if curve is None else _compare(one.name, reference, curve)
            rates[label].append(rate)
            cells.append(_cell(rate, row))
            rows += [] if row is None else [row]
        matrix.append((one.name, tuple(cells)))
    kept = [i for i, label in enumerate(labels) if any(row.codec == label for row in rows)]
    lines = [(name, tuple(cells[i] for i in kept)) for name, cells in matrix]
    lines += _mean_line(rates, [labels[i] for i in kept])
    return Verdict(anchor, tuple(labels[i] for i in kept), tuple(lines), tuple(rows))


def _compare(name: str, reference: Curve, curve: Curve) -> tuple[Row, float | None]:
    difference = compare_curves(reference, curve)
    if isinstance(difference, str):
        where = crossing_text(reference, curve)
        reason = f"not comparable: {difference}"
        return Row(
            name, curve.label, reason, NOTHING, NOTHING, _points(reference, curve), where, "none"
        ), None
    low, high = difference.overlap
    share = f"{100 * difference.overlap_share:.0f} %"
    other, num_reference = difference.num_points[1], difference.num_points[0]
    row = Row(
        sequence=name,
        codec=curve.label,
        rate=signed(difference.value, 1, "%"),
        psnr=_psnr_text(reference, curve),
        overlap=f"{low:.1f} to {high:.1f} dB ({share})",
        points=f"{other} and {num_reference}",
        where=crossing_text(reference, curve),
        verdict=_verdict_of(difference.value),
    )
    return row, difference.value


def _points(reference: Curve, curve: Curve) -> str:
    return f"{len(curve.points)} and {len(reference.points)}"


def _psnr_text(reference: Curve, curve: Curve) -> str:
    difference = compare_curves(reference, curve, "psnr")
    if isinstance(difference, str):
        return f"not comparable: {difference}"
    return signed(difference.value, 2, "dB")


def _cell(rate: float | None, row: Row | None) -> Cell:
    if rate is None:
        return Cell(NOTHING if row is None else "not comparable", "none")
    return Cell(signed(rate, 1, "%"), _verdict_of(rate))


def _verdict_of(rate: float) -> str:
    """Judge a difference in per cent; what is shown as nothing is nothing."""
    if abs(rate) < MIN_PERCENT:
        return "none"
    return "better" if rate < 0 else "worse"


def _mean_line(
    rates: dict[str, list[float | None]], labels: Sequence[str]
) -> list[tuple[str, tuple[Cell, ...]]]:
    """Return the mean of every codec over the sequences on which it has a figure, if these are several."""
    cells = []
    for label in labels:
        count = sum(rate is not None for rate in rates[label])
        cell = _cell(mean(rates[label]) if count > 1 else None, None)
        cells.append(Cell(f"{cell.text} ({count})", cell.verdict) if count > 1 else cell)
    return [("mean (sequences)", tuple(cells))] if any(cell.text != NOTHING for cell in cells) else []
