"""Comparison of curves: is one codec better than another, by how much, and up to which rate."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from dvc.errors import ConfigError, DvcError
from dvc.rd.curves import ANCHOR_LABEL, Curve, Experiment, experiments
from dvc.rd.differences import (
    MEASURES,
    NO_CHROMA,
    Measure,
    bd_text,
    compare_curves,
    crossing_text,
    crossings_kbps,
    told_measures,
)
from dvc.rd.point_result import PointResult, number
from dvc.rd.tables import NOTHING, csv_text

if TYPE_CHECKING:
    from dvc.metrics import BdResult

CSV_COLUMNS = (
    "sequence",
    "codec",
    "against",
    "bd_rate_percent",
    "overlap_low_db",
    "overlap_high_db",
    "overlap_share",
    "num_points",
    "num_points_against",
    "bd_psnr_db",
    "overlap_low_kbps",
    "overlap_high_kbps",
    "crossings_kbps",
    "refused",
    "first_frame",
    "frames",
    "bd_rate_yuv_percent",
    "bd_psnr_yuv_db",
)
"""Columns of the table for machines, in this order."""


@dataclass(frozen=True)
class Comparison:
    """One curve against another, on the same frames."""

    sequence: str  # name
    reference: Curve  # the curves; negative BD-rates mean that `other` needs less
    other: Curve
    # mean difference in rate at equal PSNR, and in PSNR at equal rate, or why there is none, by measure
    rates: "Mapping[Measure, BdResult | str]"
    psnrs: "Mapping[Measure, BdResult | str]"

    @property
    def in_colour(self) -> bool:
        """Whether both curves have PSNRs in colour."""
        return self.rates["colour"] != NO_CHROMA

    @property
    def comparable(self) -> bool:
        """Whether there is a figure, of rate or of PSNR."""
        return not all(isinstance(one, str) for one in (*self.rates.values(), *self.psnrs.values()))


QUALITIES = ("luma", "mse", "colour")
"""What curves may be compared at equal: mean PSNR of luma, PSNR of its mean squared error, or the mean with
chroma, (6 Y + Cb + Cr) / 8."""


def at_equal(results: Sequence[PointResult], quality: str) -> list[PointResult]:
    """Return points whose only PSNR is one measure of their quality."""
    found = []
    for result in results:
        totals = {**result.data["totals"], "psnr_y_db": _psnr_db(result, quality)}
        totals.pop("psnr_yuv_db", None)
        found.append(replace(result, data={**result.data, "totals": totals}))
    return found


def _psnr_db(result: PointResult, quality: str) -> float:
    if quality == "mse":
        from dvc.metrics import psnr_of_mean_error_db

        psnrs_db = [number(frame.get("psnr_y_db")) for frame in result.frame_rows]
        known = [psnr_db for psnr_db in psnrs_db if psnr_db is not None]
        if not known or len(known) < len(psnrs_db):
            raise ConfigError(f"{result.name} has {'a frame without PSNR' if psnrs_db else 'no frames'}")
        return psnr_of_mean_error_db(known)
    if quality == "colour":
        if result.psnr_yuv_db is None:
            raise ConfigError(f"{result.name} has no chroma: `dvc-rd run` measures it without --luma-only")
        return result.psnr_yuv_db
    return result.psnr_y_db


def compare(
    before: Sequence[PointResult],
    after: Sequence[PointResult] | None = None,
    against: str | None = None,
    curves: tuple[str, str] | None = None,
) -> list[Comparison]:
    """Compare what a user asks for."""
    if curves is not None:
        if after is not None:
            raise ConfigError("--curves compares within one experiment; give one folder")
        return _compare_pair(before, *curves)
    if after is not None and against is None:
        return _compare_same(before, after)
    return _compare_against(before, before if after is None else after, against or ANCHOR_LABEL)


def _compare_same(before: Sequence[PointResult], after: Sequence[PointResult]) -> list[Comparison]:
    """Compare every curve with that of the same label in another experiment; others are left out."""
    known = {(one.key, curve.label): curve for one in experiments(before) for curve in one.curves}
    rows = [
        _compare(one, known[one.key, curve.label], curve)
        for one in experiments(after)
        for curve in one.curves
        if (one.key, curve.label) in known
    ]
    if not rows:
        raise DvcError("the two experiments have no codec and sequence in common")
    return rows


def _compare_against(
    before: Sequence[PointResult], after: Sequence[PointResult], against: str
) -> list[Comparison]:
    """Compare every curve of `after` with one curve of `before`, which may be the same experiment."""
    label = find_label(before, against)
    known = {one.key: one.anchor(label) for one in experiments(before)}
    same = before is after
    rows = [
        _compare(one, reference, curve)
        for one in experiments(after)
        for curve in one.curves
        if (reference := known.get(one.key)) is not None
        and not (curve.has_lossless_keys or (same and curve.label == label))
    ]
    if not rows:
        raise DvcError(f"there is nothing to compare with {label!r} on the same frames")
    return rows


def _compare_pair(results: Sequence[PointResult], reference: str, other: str) -> list[Comparison]:
    """Compare two curves of an experiment."""
    wanted = find_label(results, other)
    if wanted == find_label(results, reference):
        raise ConfigError(f"{reference!r} and {other!r} are the same curve, {wanted!r}")
    rows = [row for row in _compare_against(results, results, reference) if row.other.label == wanted]
    if not rows:
        raise DvcError(f"no sequence has both {reference!r} and {other!r}")
    return rows


def find_label(results: Sequence[PointResult], text: str) -> str:
    """Find the label of a curve."""
    labels = list(dict.fromkeys(curve.label for one in experiments(results) for curve in one.curves))
    if text in labels:
        return text
    found = [label for label in labels if text.casefold() in label.casefold()]
    if len(found) != 1:
        problem = "no curve" if not found else "several curves"
        raise ConfigError(f"{problem} with {text!r}; there are: {'; '.join(found or labels)}")
    return found[0]


def comparison_table(comparisons: Sequence[Comparison]) -> tuple[list[str], list[list[str]]]:
    """Return head and rows of a table of comparisons, with means over the sequences."""
    measures = told_measures(any(one.in_colour for one in comparisons))
    told = [f", {measure}" for measure in measures] if len(measures) > 1 else [""]
    head = ["sequence", "codec", "against", *(f"BD-rate{one} (overlap, points)" for one in told)]
    head += [*(f"BD-PSNR{one}" for one in told), f"{'luma ' if len(measures) > 1 else ''}PSNR at equal rate"]
    rows = [
        [
            one.sequence,
            one.other.label,
            one.reference.label,
            *(bd_text(one.rates[measure]) for measure in measures),
            *(_psnr_text(one.psnrs[measure]) for measure in measures),
            crossing_text(one.reference, one.other),
        ]
        for one in comparisons
    ]
    return head, rows + _means(comparisons, measures)


def _psnr_text(difference: "BdResult | str") -> str:
    return NOTHING if isinstance(difference, str) else f"{difference.value:+.2f} dB"


def comparison_csv(comparisons: Iterable[Comparison]) -> str:
    """Write comparisons as comma-separated values."""
    rows = []
    for one in comparisons:
        crossings = " ".join(f"{rate:.1f}" for rate, _ in crossings_kbps(one.reference, one.other)[1:])
        rate: list[object] = [None] * 6
        psnr: list[object] = [None] * 3
        by_rate, by_psnr = one.rates["luma"], one.psnrs["luma"]
        if not isinstance(by_rate, str):
            shares = (*by_rate.overlap, by_rate.overlap_share)
            rate = [by_rate.value, *shares, by_rate.num_points[1], by_rate.num_points[0]]
        if not isinstance(by_psnr, str):
            psnr = [by_psnr.value, *by_psnr.overlap]
        refused = by_rate if isinstance(by_rate, str) else None
        in_colour = [getattr(found["colour"], "value", None) for found in (one.rates, one.psnrs)]
        names = [one.sequence, one.other.label, one.reference.label]
        data = one.other.points[0].data
        frames = [data["options"]["start"], data["totals"]["frames"]]
        rows.append([*names, *rate, *psnr, crossings, refused, *frames, *in_colour])
    return csv_text(CSV_COLUMNS, rows)


def _compare(experiment: Experiment, reference: Curve, other: Curve) -> Comparison:
    rates = {one: compare_curves(reference, other, "rate", one) for one in MEASURES}
    psnrs = {one: compare_curves(reference, other, "psnr", one) for one in MEASURES}
    return Comparison(experiment.name, reference, other, rates, psnrs)


def _means(comparisons: Sequence[Comparison], measures: Sequence[Measure]) -> list[list[str]]:
    """Return a row for each pair of curves that is compared on several sequences."""
    groups: dict[tuple[str, str], list[Comparison]] = {}
    for one in comparisons:
        groups.setdefault((one.other.label, one.reference.label), []).append(one)
    rows = []
    for labels, members in groups.items():
        cells = [_mean_cells(members, measure) for measure in measures]
        if any(rate != NOTHING for rate, _ in cells):
            rates, gains = zip(*cells, strict=True)
            rows.append(["*mean*", *labels, *rates, *gains, NOTHING])
    return rows


def _mean_cells(members: Sequence[Comparison], measure: Measure) -> tuple[str, str]:
    """Return means of BD-rate and BD-PSNR over the sequences that can be compared, if these are several."""
    known = [one for one in members if not isinstance(one.rates[measure], str)]
    rates, gains = (
        [found.value for found in differences if not isinstance(found, str)]
        for differences in ([one.rates[measure] for one in known], [one.psnrs[measure] for one in known])
    )
    if len(rates) < 2:
        return NOTHING, NOTHING
    count = f"{len(rates)} of {len(members)} sequences"
    text = f"{np.mean(rates):+.1f} % ({count}, {min(rates):+.1f} to {max(rates):+.1f} %)"
    return text, f"{np.mean(gains):+.2f} dB" if len(gains) == len(rates) else NOTHING
