"""Comparison of curves: differences of rate and PSNR, crossings, cost, and all pairs of curves."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from dvc.errors import ConfigError, DvcError
from dvc.metrics import BdResult, psnr_of_mean_error_db
from dvc.rd.points_csv import csv_text
from dvc.rd.rd_curves import (
    ANCHOR_LABEL,
    NO_CHROMA,
    Comparison,
    Curve,
    Experiment,
    Measure,
    compare_curves,
    crossing_text,
    crossings_kbps,
    experiments,
    table_measures,
)
from dvc.rd.rd_results import PointResult, mean

NOTHING = "–"
"""Text of a cell without a value."""
CSV_COLUMNS = (
    *("sequence", "codec", "against", "bd_rate_percent", "overlap_low_db", "overlap_high_db"),
    *("overlap_share", "num_points", "num_points_against", "bd_psnr_db", "overlap_low_kbps"),
    *("overlap_high_kbps", "crossings_kbps", "refused", "first_frame", "frames", "bd_rate_yuv_percent"),
    "bd_psnr_yuv_db",
)
"""Columns of the table for machines, in this order."""


def at_equal(results: Sequence[PointResult], quality: str) -> list[PointResult]:
    """Return points that have a measure of quality (luma, mse or colour) as their only PSNR."""
    changed = []
    for result in results:
        psnr_db: float | None = result.psnr_y_db
        if quality == "mse":
            psnrs_db = [frame.psnr_y_db for frame in result.per_frame if frame.psnr_y_db is not None]
            if not psnrs_db or len(psnrs_db) < len(result.per_frame):
                reason = "a frame without PSNR" if result.per_frame else "no frames"
                raise ConfigError(f"{result.name} has {reason}")
            psnr_db = psnr_of_mean_error_db(psnrs_db)
        elif quality == "colour":
            psnr_db = result.totals.psnr_yuv_db
        if psnr_db is None:
            raise ConfigError(f"{result.name} has no chroma: `dvc-rd run` measures it without --luma-only")
        changed.append(replace(result, totals=replace(result.totals, psnr_y_db=psnr_db, psnr_yuv_db=None)))
    return changed


def compare(
    before: Sequence[PointResult],
    after: Sequence[PointResult] | None = None,
    against: str | None = None,
    curves: tuple[str, str] | None = None,
) -> list[Comparison]:
    """Compare every curve with the one of its label in another experiment, or with one curve."""
    if curves is not None and after is not None:
        raise ConfigError("--curves compares within one experiment; give one folder")
    label = only = None
    reason = "the two experiments have no codec and sequence in common"
    if curves is not None:
        label, only = (find_label(before, text) for text in curves)
        reason = f"no sequence has both {curves[0]!r} and {curves[1]!r}"
        if label == only:
            raise ConfigError(f"{curves[0]!r} and {curves[1]!r} are the same curve, {label!r}")
    elif after is None or against is not None:
        label = find_label(before, against or ANCHOR_LABEL)
        reason = f"no curve on the same frames can be compared with {label!r}"
    references = {(one.key, curve.label): curve for one in experiments(before) for curve in one.curves}
    rows = []
    for one in experiments(before if after is None else after):
        for curve in one.curves:
            reference = references.get((one.key, label or curve.label))
            if label is not None and (curve.has_lossless_keys or (after is None and curve.label == label)):
                continue
            if reference is not None and only in (None, curve.label):
                rows.append(Comparison(one.name, reference, curve))
    if not rows:
        raise DvcError(reason)
    return rows


def find_label(results: Sequence[PointResult], text: str) -> str:
    """Return the label of the only curve that has a text in its label."""
    labels = list(dict.fromkeys(curve.label for one in experiments(results) for curve in one.curves))
    if text in labels:
        return text
    matches = [label for label in labels if text.casefold() in label.casefold()]
    if len(matches) != 1:
        problem = "several curves" if matches else "no curve"
        raise ConfigError(f"{problem} with {text!r}; expected one of: {'; '.join(matches or labels)}")
    return matches[0]


def bd_rate_text(difference: BdResult | str) -> str:
    """Write a difference in rate with its overlap."""
    if isinstance(difference, str):
        return _difference_text(difference, 1, "%")
    low, high = difference.overlap
    reference, other = difference.num_points
    return f"{difference.value:+.1f} % ({low:.1f} to {high:.1f} dB, {other} and {reference} points)"


def measure_titles(measures: Sequence[Measure]) -> list[str]:
    """Return endings of the titles of columns: nothing if there is only one measure."""
    return [f", {measure}" for measure in measures] if len(measures) > 1 else [""]


def comparison_table(comparisons: Sequence[Comparison]) -> tuple[list[str], list[list[str]]]:
    """Return head and rows of a table of comparisons, with means over the sequences."""
    measures = table_measures(any(one.in_colour for one in comparisons))
    titles = measure_titles(measures)
    head = [
        *("sequence", "codec", "against"),
        *(f"BD-rate{one} (overlap, points)" for one in titles),
        *(f"BD-PSNR{one}" for one in titles),
        f"{'luma ' if len(measures) > 1 else ''}PSNR at equal rate",
    ]
    rows = [
        [
            *(one.sequence, one.other.label, one.reference.label),
            *(bd_rate_text(one.rates[measure]) for measure in measures),
            *(
                NOTHING if isinstance(psnr, str) else f"{psnr.value:+.2f} dB"
                for psnr in (one.psnrs[measure] for measure in measures)
            ),
            crossing_text(one.reference, one.other),
        ]
        for one in comparisons
    ]
    groups: dict[tuple[str, str], list[Comparison]] = {}
    for one in comparisons:
        groups.setdefault((one.other.label, one.reference.label), []).append(one)
    for labels, members in groups.items():
        cells = [_mean_cells(members, measure) for measure in measures]
        if any(rate != NOTHING for rate, _ in cells):
            rates, gains = zip(*cells, strict=True)
            rows.append(["*mean*", *labels, *rates, *gains, NOTHING])
    return head, rows


def _mean_cells(members: Sequence[Comparison], measure: Measure) -> tuple[str, str]:
    """Return means of BD-rate and BD-PSNR over the sequences that can be compared, if at least two."""
    pairs = [(one.rates[measure], one.psnrs[measure]) for one in members]
    rates = [rate.value for rate, _ in pairs if not isinstance(rate, str)]
    gains = [psnr.value for rate, psnr in pairs if not isinstance(rate, str) and not isinstance(psnr, str)]
    if len(rates) < 2:
        return NOTHING, NOTHING
    count = f"{len(rates)} of {len(members)} sequences"
    text = f"{np.mean(rates):+.1f} % ({count}, {min(rates):+.1f} to {max(rates):+.1f} %)"
    return text, f"{np.mean(gains):+.2f} dB" if len(gains) == len(rates) else NOTHING


def comparison_csv(comparisons: Iterable[Comparison]) -> str:
    """Write comparisons as comma-separated values."""
    rows = []
    for one in comparisons:
        rate, psnr, result = one.rates["luma"], one.psnrs["luma"], one.other.points[0]
        rates: list[object] = [None] * 6
        psnrs: list[object] = [None] * 3
        if isinstance(rate, BdResult):
            rates = [rate.value, *rate.overlap, rate.overlap_share, *reversed(rate.num_points)]
        if isinstance(psnr, BdResult):
            psnrs = [psnr.value, *psnr.overlap]
        rows.append(
            [
                *(one.sequence, one.other.label, one.reference.label),
                *rates,
                *psnrs,
                " ".join(f"{rate:.1f}" for rate, _ in crossings_kbps(one.reference, one.other)[1:]),
                rate if isinstance(rate, str) else None,
                *(result.options.start, result.totals.frames),
                *(getattr(differences["colour"], "value", None) for differences in (one.rates, one.psnrs)),
            ]
        )
    return csv_text(CSV_COLUMNS, rows)


@dataclass(frozen=True)
class RateCost:
    """Rate that a codec needs, and processor time of its encoder: means over sequences."""

    label: str  # codec
    cost_ms: float  # processor time of encoding a frame
    bd_rate_percent: float  # difference in rate at equal PSNR to the reference
    num_sequences: int
    bd_rate_yuv_percent: float | None = None  # the same in colour, if all sequences have it


def rate_costs(found: Sequence[Experiment], reference: str = ANCHOR_LABEL) -> list[RateCost]:
    """Return rate and cost of all codecs, on the sequences that have both of these and the reference."""
    values: dict[str, list[tuple[float, float, float | None]]] = {}
    for one in found:
        anchor = one.anchor(reference)
        for curve in one.curves:
            cost = mean(point.cpu_ms("coding") for point in curve.points)
            rate = _bd_rate_percent(anchor, curve, "luma")
            if cost and rate is not None:
                row = cost, rate, _bd_rate_percent(anchor, curve, "colour")
                values.setdefault(curve.label, []).append(row)
    points = []
    for label, rows in values.items():
        costs, rates, in_colour = zip(*rows, strict=True)
        yuv = None if None in in_colour else mean(in_colour)
        points.append(RateCost(label, sum(costs) / len(rows), sum(rates) / len(rows), len(rows), yuv))
    return sorted(points, key=lambda point: (point.cost_ms, point.label))


def _bd_rate_percent(anchor: Curve | None, curve: Curve, measure: Measure) -> float | None:
    """Return the difference in rate of a curve to another, or None if they cannot be compared."""
    if anchor is None or curve.has_lossless_keys:
        return None
    if curve is anchor:
        return 0.0 if measure == "luma" or curve.psnrs_yuv_db else None
    difference = compare_curves(anchor, curve, "rate", measure)
    return None if isinstance(difference, str) else difference.value


Outcome = Literal["better", "worse", "none"]


@dataclass(frozen=True)
class Cell:
    """Cell of a matrix of BD-rates."""

    text: str  # such as ``−12.3 %``
    outcome: Outcome = "none"


@dataclass(frozen=True)
class VerdictRow:
    """One curve against the anchor on one sequence, as text."""

    sequence: str
    codec: str
    outcome: Outcome
    differences: tuple[str, ...]  # BD-rate, then BD-PSNR, by measure
    overlap: str  # range of PSNR that both curves cover
    points: str  # numbers of points of codec and anchor
    crossings: str  # ranges of rates with a better codec


@dataclass(frozen=True)
class Verdict:
    """All curves against one."""

    anchor: str  # label
    codecs: tuple[str, ...]  # labels of the other curves
    measures: tuple[Measure, ...]  # BD-rates of each codec in the matrix
    matrix: tuple[tuple[str, tuple[Cell, ...]], ...]  # name and cells of each sequence; means last
    rows: tuple[VerdictRow, ...]

    @property
    def columns(self) -> list[str]:
        """Titles of the columns of the matrix."""
        if len(self.measures) == 1:
            return list(self.codecs)
        return [f"{label}: {measure}" for label in self.codecs for measure in self.measures]


def verdicts(found: Sequence[Experiment]) -> list[Verdict]:
    """Compare every curve with every other on the same frames."""
    curves = [curve for one in found for curve in one.curves if not curve.has_lossless_keys]
    labels = {curve.label: curve.is_anchor for curve in curves}
    ordered = sorted(labels, key=lambda label: (labels[label], label))
    built = [_verdict(found, anchor, [label for label in ordered if label != anchor]) for anchor in ordered]
    return [verdict for verdict in built if verdict.rows]


def _verdict(found: Sequence[Experiment], anchor: str, labels: Sequence[str]) -> Verdict:
    measures = table_measures(any(one.in_colour for one in found))
    by_sequence = {
        one.name: {
            label: Comparison(one.name, reference, curve) for label in labels if (curve := one.anchor(label))
        }
        for one in found
        if (reference := one.anchor(anchor)) is not None
    }
    codecs = [label for label in labels if any(label in pairs for pairs in by_sequence.values())]
    columns = [(label, measure) for label in codecs for measure in measures]
    differences = {
        name: [pairs[label].rates[measure] if label in pairs else None for label, measure in columns]
        for name, pairs in by_sequence.items()
    }
    matrix = [(name, tuple(map(_cell, cells))) for name, cells in differences.items()]
    means = []
    for column in zip(*differences.values(), strict=True):
        results = [one for one in column if isinstance(one, BdResult)]
        cell = Cell(NOTHING)
        if len(results) > 1:
            result = replace(results[0], value=sum(one.value for one in results) / len(results))
            cell = Cell(f"{_signed(result.value, 1, '%')} ({len(results)})", _outcome(result))
        means.append(cell)
    if any(cell.text != NOTHING for cell in means):
        matrix.append(("mean (sequences)", tuple(means)))
    rows = [_row(pair, measures) for pairs in by_sequence.values() for pair in pairs.values()]
    return Verdict(anchor, tuple(codecs), measures, tuple(matrix), tuple(rows))


def _row(pair: Comparison, measures: Sequence[Measure]) -> VerdictRow:
    luma = pair.rates["luma"]
    overlap, points = NOTHING, f"{len(pair.other.points)} and {len(pair.reference.points)}"
    if isinstance(luma, BdResult):
        low, high = luma.overlap
        overlap = f"{low:.1f} to {high:.1f} dB ({100 * luma.overlap_share:.0f} %)"
        points = f"{luma.num_points[1]} and {luma.num_points[0]}"
    rates = [_difference_text(pair.rates[measure], 1, "%") for measure in measures]
    psnrs = [
        NOTHING
        if isinstance(luma, str) and measure == "luma"
        else _difference_text(pair.psnrs[measure], 2, "dB")
        for measure in measures
    ]
    crossings = crossing_text(pair.reference, pair.other)
    return VerdictRow(
        pair.sequence, pair.other.label, _outcome(luma), (*rates, *psnrs), overlap, points, crossings
    )


def _signed(value: float, decimals: int, unit: str) -> str:
    return f"{value:+.{decimals}f} {unit}".replace("-", "−")


def _difference_text(difference: BdResult | str, decimals: int, unit: str) -> str:
    if difference == NO_CHROMA:
        return NOTHING
    if isinstance(difference, str):
        return f"not comparable: {difference}"
    return _signed(difference.value, decimals, unit)


def _cell(difference: BdResult | str | None) -> Cell:
    if difference is None or difference == NO_CHROMA:
        return Cell(NOTHING)
    if isinstance(difference, str):
        return Cell("not comparable")
    return Cell(_signed(difference.value, 1, "%"), _outcome(difference))


def _outcome(difference: BdResult | str) -> Outcome:
    """Judge a difference in rate; one that is shown as zero is none."""
    if isinstance(difference, str) or abs(difference.value) < 0.05:
        return "none"
    return "better" if difference.value < 0 else "worse"
