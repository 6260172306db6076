"""Rate-distortion curves: results grouped by frames and codec; differences and crossings of two curves."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dvc.errors import RdCurveError
from dvc.metrics import BdResult, bd_psnr, bd_rate, rising_curve
from dvc.rd.anchors import ANCHOR_CODECS
from dvc.rd.rd_results import IMPORTED, PointResult
from dvc.rd.specification import ANCHORS, INTRA

ANCHOR_LABEL = "H.264 intra"
Measure = Literal["luma", "colour"]
"""Measure of quality: PSNR of luma, or (6 Y + Cb + Cr) / 8."""
MEASURES: tuple[Measure, ...] = ("luma", "colour")
NO_CHROMA = "no PSNR of chroma"
NUM_SAMPLES = 2001
EQUAL_DB = 1e-6


@dataclass(frozen=True)
class Curve:
    """The points of one codec on the same frames."""

    label: str  # codec and its unusual options
    is_anchor: bool  # a codec to compare with
    points: tuple[PointResult, ...]  # by increasing rate

    @property
    def has_lossless_keys(self) -> bool:
        """Whether key frames are lossless, so that the curve measures side information and not rates."""
        return self.points[0].key.lossless

    @property
    def rates_kbps(self) -> list[float]:
        """Rates of the points in kbit/s."""
        return [point.rate_kbps for point in self.points]

    @property
    def psnrs_y_db(self) -> list[float]:
        """Luma PSNRs of the points in dB."""
        return [point.psnr_y_db for point in self.points]

    @property
    def psnrs_yuv_db(self) -> list[float]:
        """PSNRs of the points in colour, in dB; empty if a point has no chroma."""
        psnrs_db = [point.totals.psnr_yuv_db for point in self.points]
        return [] if None in psnrs_db else [float(psnr_db or 0.0) for psnr_db in psnrs_db]


@dataclass(frozen=True)
class Experiment:
    """All curves that were measured on the same frames."""

    name: str  # name of the sequence; with its frames, or a number, if several experiments have it
    title: str  # name, size, frames and frame rate
    slug: str  # name for files; unique in a report
    key: tuple[str, int, int, bool]  # digest of the sequence, first frame, number of frames, luma only
    curves: tuple[Curve, ...]  # anchors last

    @property
    def in_colour(self) -> bool:
        """Whether a curve has PSNRs in colour."""
        return any(curve.psnrs_yuv_db for curve in self.curves)

    def anchor(self, label: str = ANCHOR_LABEL) -> Curve | None:
        """Return the curve of a label."""
        return next((curve for curve in self.curves if curve.label == label), None)


def experiments(results: Sequence[PointResult]) -> list[Experiment]:
    """Group results into experiments and curves."""
    groups: dict[tuple[str, int, int, bool], dict[str, list[PointResult]]] = {}
    for result in results:
        options = result.options
        key = result.sequence.digest, options.start, result.totals.frames, options.luma_only
        groups.setdefault(key, {}).setdefault(_label(result), []).append(result)
    built: list[Experiment] = []
    named = [(next(iter(curves.values()))[0].sequence.name, key) for key, curves in groups.items()]
    for name, key in sorted(named):
        curves = []
        for label, points in groups[key].items():
            points.sort(key=lambda point: (point.rate_kbps, point.psnr_y_db))
            is_anchor = points[0].codec in (*ANCHORS.values(), IMPORTED)
            curves.append(Curve(label, is_anchor, tuple(points)))
        slug = re.sub(r"[^A-Za-z0-9_.-]+", "_", name)
        if any(other.slug == slug for other in built):
            slug = f"{slug}-{len(built) + 1}"
        (_, first, count, luma_only), sequence = key, curves[0].points[0].sequence
        size = f"{sequence.width}\N{MULTIPLICATION SIGN}{sequence.height}"
        frames = f"frames {first} to {first + count - 1} at {sequence.frames_per_s:.4g} Hz"
        title = f"{sequence.name}: {size}, {frames}, {'luma only' if luma_only else 'colour'}"
        curves.sort(key=lambda curve: (curve.is_anchor, curve.label))
        built.append(Experiment(name, title, slug, key, tuple(curves)))
    # Names that several experiments have get the frames, or a number if these are equal.
    renamed = []
    for one in built:
        members = [other for other in built if other.name == one.name]
        spans = [f"frames {other.key[1]} to {other.key[1] + other.key[2] - 1}" for other in members]
        number = members.index(one)
        extra = spans[number] if len(set(spans)) == len(spans) else str(number + 1)
        renamed.append(replace(one, name=f"{one.name} ({extra})") if len(members) > 1 else one)
    return renamed


def _label(result: PointResult) -> str:
    options = result.options
    if result.codec == INTRA:
        return ANCHOR_LABEL
    if result.codec in ANCHOR_CODECS:
        return ANCHOR_CODECS[result.codec].label
    if result.codec == IMPORTED:
        return options.options["curve"]
    given = sorted(options.options.items()) + sorted(options.decoder.items())
    extra = [name if value == "true" else f"{name} {value}" for name, value in given]
    if options.qp is not None:
        extra.append("by QP")
    if result.has_level and options.key_qp not in ("auto", "lossless"):
        extra.append("chosen key QPs")
    if options.side_information:
        extra.append(f"side information {options.side_information}")
    if result.key.lossless:
        extra.append("lossless key frames")
    return ", ".join([f"{result.codec.upper()}-DVC, GOP {options.gop}", *extra])


@dataclass(frozen=True)
class Comparison:
    """One curve against another on the same frames; negative BD-rates mean that `other` needs less rate."""

    sequence: str  # name
    reference: Curve
    other: Curve

    @cached_property
    def rates(self) -> dict[Measure, BdResult | str]:
        """Mean differences in rate at equal PSNR, or the reason for none, by measure."""
        return {measure: compare_curves(self.reference, self.other, "rate", measure) for measure in MEASURES}

    @cached_property
    def psnrs(self) -> dict[Measure, BdResult | str]:
        """Mean differences in PSNR at equal rate, or the reason for none, by measure."""
        return {measure: compare_curves(self.reference, self.other, "psnr", measure) for measure in MEASURES}

    @property
    def in_colour(self) -> bool:
        """Whether both curves have PSNRs in colour."""
        return self.rates["colour"] != NO_CHROMA

    @property
    def is_comparable(self) -> bool:
        """Whether there is a difference in rate or PSNR."""
        return not all(isinstance(one, str) for one in (*self.rates.values(), *self.psnrs.values()))


def compare_curves(
    reference: Curve,
    other: Curve,
    of: Literal["rate", "psnr"] = "rate",
    measure: Measure = "luma",
) -> BdResult | str:
    """Return the mean difference of a curve to another, or the reason for none."""
    difference = bd_rate if of == "rate" else bd_psnr
    psnrs_db = [curve.psnrs_y_db if measure == "luma" else curve.psnrs_yuv_db for curve in (reference, other)]
    if not all(psnrs_db):
        return NO_CHROMA
    try:
        return difference(reference.rates_kbps, psnrs_db[0], other.rates_kbps, psnrs_db[1])
    except RdCurveError as err:
        return str(err)


def table_measures(in_colour: bool) -> tuple[Measure, ...]:
    """Return the measures that have columns in a table."""
    return MEASURES if in_colour else MEASURES[:1]


def crossings_kbps(reference: Curve, other: Curve) -> list[tuple[float, bool]]:
    """Return the lower ends of the ranges of rates with a better (True) or worse (False) curve."""
    samples, gains_db = _gains(reference, other)
    if not samples.size:
        return []
    better = gains_db > EQUAL_DB
    starts = [0, *(np.flatnonzero(better[1:] != better[:-1]) + 1)]
    return [(float(10 ** samples[i]), bool(better[i])) for i in starts]


def crossing_text(reference: Curve, other: Curve) -> str:
    """Describe the ranges of rates with a better curve."""
    samples, gains_db = _gains(reference, other)
    if not samples.size:
        is_single = min(len(reference.points), len(other.points)) < 2
        return "a curve of one point" if is_single else "no rates in common"
    if (np.abs(gains_db) <= EQUAL_DB).all():
        return "equal at all common rates"
    pieces = crossings_kbps(reference, other)
    if len(pieces) == 1:
        return f"{'better' if pieces[0][1] else 'worse'} at all common rates"
    spans = []
    for number, (rate, better) in enumerate(pieces):
        if better:
            start = f"from {rate:.0f} " if number else ""
            end = f"up to {pieces[number + 1][0]:.0f} " if number + 1 < len(pieces) else ""
            spans.append(start + end)
    return f"better {'and '.join(spans)}kbit/s"


def _gains(reference: Curve, other: Curve) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return base-10 logarithms of common rates, and the PSNR gain of `other` at these."""
    from scipy.interpolate import PchipInterpolator

    try:
        curves = [rising_curve(curve.rates_kbps, curve.psnrs_y_db, "") for curve in (reference, other)]
    except RdCurveError:
        return np.empty(0), np.empty(0)
    low, high = max(curve[0][0] for curve in curves), min(curve[0][-1] for curve in curves)
    if low >= high:
        return np.empty(0), np.empty(0)
    samples = np.linspace(low, high, NUM_SAMPLES)
    psnrs_db = [PchipInterpolator(*curve)(samples) for curve in curves]
    return samples, psnrs_db[1] - psnrs_db[0]
