"""Comparison of curves: is one codec better than another, by how much, and up to which rate."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from dvc.errors import ConfigError, DvcError
from dvc.rd.curves import ANCHOR_LABEL, Curve, Experiment, experiments
from dvc.rd.differences import bd_text, compare_curves, crossing_text, crossings_kbps
from dvc.rd.point_result import PointResult, number
from dvc.rd.tables import NOTHING, csv_text

if TYPE_CHECKING:
    from dvc.metrics import BdResult

HEAD = (
    "sequence",
    "codec",
    "against",
    "BD-rate (overlap, points)",
    "BD-PSNR",
    "PSNR at equal rate",
)
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
)
"""Columns of the table for machines, in this order."""


@dataclass(frozen=True)
class Comparison:
    """One curve against another, on the same frames."""

    sequence: str  # name
    reference: Curve  # the curves; negative BD-rates mean that `other` needs less
    other: Curve
    # mean difference in rate at equal PSNR, and in PSNR at equal rate, or why there is none
    rate: "BdResult | str"
    psnr: "BdResult | str"

    @property
    def comparable(self) -> bool:
        """Whether there is a figure, of rate or of PSNR."""
        return not (isinstance(self.rate, str) and isinstance(self.psnr, str))


QUALITIES = ("luma", "mse", "colour")
"""What curves may be compared at equal: mean PSNR of luma, PSNR of its mean squared error, or the mean with
chroma, (6 Y + Cb + Cr) / 8."""


def at_equal(results: Sequence[PointResult], quality: str) -> list[PointResult]:
    """Return points whose PSNR is another measure of their quality."""
    found = []
    for result in results:
        totals = {**result.data["totals"], "psnr_y_db": _psnr_db(result, quality)}
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
        chroma = [result.total(name) for name in ("psnr_cb_db", "psnr_cr_db")]
        known = [psnr_db for psnr_db in chroma if psnr_db is not None]
        if len(known) < len(chroma):
            raise ConfigError(f"{result.name} has no chroma: `dvc-rd run --colour` measures it")
        return (6 * result.psnr_y_db + sum(known)) / 8
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


def comparison_rows(comparisons: Sequence[Comparison]) -> list[list[str]]:
    """Write comparisons as rows of a table, with means over the sequences."""
    rows = [
        [
            one.sequence,
            one.other.label,
            one.reference.label,
            bd_text(one.rate),
            NOTHING if isinstance(one.psnr, str) else f"{one.psnr.value:+.2f} dB",
            crossing_text(one.reference, one.other),
        ]
        for one in comparisons
    ]
    return rows + _means(comparisons)


def comparison_csv(comparisons: Iterable[Comparison]) -> str:
    """Write comparisons as comma-separated values."""
    rows = []
    for one in comparisons:
        crossings = " ".join(f"{rate:.1f}" for rate, _ in crossings_kbps(one.reference, one.other)[1:])
        rate: list[object] = [None] * 6
        psnr: list[object] = [None] * 3
        if not isinstance(one.rate, str):
            shares = (*one.rate.overlap, one.rate.overlap_share)
            rate = [one.rate.value, *shares, one.rate.num_points[1], one.rate.num_points[0]]
        if not isinstance(one.psnr, str):
            psnr = [one.psnr.value, *one.psnr.overlap]
        refused = one.rate if isinstance(one.rate, str) else None
        names = [one.sequence, one.other.label, one.reference.label]
        data = one.other.points[0].data
        frames = [data["options"]["start"], data["totals"]["frames"]]
        rows.append([*names, *rate, *psnr, crossings, refused, *frames])
    return csv_text(CSV_COLUMNS, rows)


def _compare(experiment: Experiment, reference: Curve, other: Curve) -> Comparison:
    rate = compare_curves(reference, other)
    return Comparison(experiment.name, reference, other, rate, compare_curves(reference, other, "psnr"))


def _means(comparisons: Sequence[Comparison]) -> list[list[str]]:
    """Return a row for each pair of curves that is compared on several sequences."""
    groups: dict[tuple[str, str], list[Comparison]] = {}
    for one in comparisons:
        groups.setdefault((one.other.label, one.reference.label), []).append(one)
    rows = []
    for (label, reference), members in groups.items():
        known = [(one.rate, one.psnr) for one in members if not isinstance(one.rate, str)]
        rates = [rate.value for rate, _ in known]
        psnrs = [psnr.value for _, psnr in known if not isinstance(psnr, str)]
        if len(rates) > 1:
            count = f"{len(rates)} of {len(members)} sequences"
            spread = f"{min(rates):+.1f} to {max(rates):+.1f} %"
            gain = f"{np.mean(psnrs):+.2f} dB" if len(psnrs) == len(rates) else NOTHING
            rows.append(
                ["*mean*", label, reference, f"{np.mean(rates):+.1f} % ({count}, {spread})", gain, NOTHING]
            )
    return rows
