"""Rate-distortion curves: results put together by experiment and codec."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from dvc.rd.anchors.codecs import ANCHOR_CODECS
from dvc.rd.point_result import IMPORTED, PointResult
from dvc.rd.points import ANCHORS, INTRA
from dvc.rd.reference_rows import REFERENCE_LABELS

ANCHOR_LABEL = "H.264 intra"


@dataclass(frozen=True)
class Curve:
    """The points of one codec on one experiment."""

    label: str  # codec and what of its options is not usual
    is_anchor: bool  # whether it is there to compare with
    points: tuple[PointResult, ...]  # by increasing rate

    @property
    def has_lossless_keys(self) -> bool:
        """Whether key frames are lossless, so that it tells of side information and not of rates."""
        return self.points[0].data["key"].get("lossless") is True

    @property
    def rates_kbps(self) -> list[float]:
        """Rates of the points in kbit/s."""
        return [point.rate_kbps for point in self.points]

    @property
    def psnrs_y_db(self) -> list[float]:
        """PSNRs of the points in dB."""
        return [point.psnr_y_db for point in self.points]

    @property
    def psnrs_yuv_db(self) -> list[float]:
        """PSNRs of the points in colour, in dB; none if a point has no chroma."""
        known = [psnr_db for point in self.points if (psnr_db := point.psnr_yuv_db) is not None]
        return known if len(known) == len(self.points) else []


@dataclass(frozen=True)
class Experiment:
    """All curves that were measured on the same frames."""

    name: str  # of the sequence; with its frames, or a number, where others have the same
    title: str  # name, size, frames and frame rate
    slug: str  # for file names; unique in a report
    # what the curves have in common: digest of the sequence, first frame, number of frames, luma only
    key: tuple[str, int, int, bool]
    curves: tuple[Curve, ...]  # anchors last

    @property
    def in_colour(self) -> bool:
        """Whether a curve tells PSNRs in colour beside those of luma."""
        return any(curve.psnrs_yuv_db for curve in self.curves)

    def anchor(self, label: str = ANCHOR_LABEL) -> Curve | None:
        """Return the curve to compare with."""
        return next((curve for curve in self.curves if curve.label == label), None)


def experiments(results: Sequence[PointResult]) -> list[Experiment]:
    """Sort results into experiments and curves."""
    groups: dict[tuple[str, int, int, bool], dict[str, list[PointResult]]] = {}
    for result in results:
        groups.setdefault(_key(result), {}).setdefault(_label(result), []).append(result)
    found: list[Experiment] = []
    for key, curves in sorted(
        groups.items(), key=lambda item: (_first(item[1]).data["sequence"]["name"], item[0])
    ):
        name = _first(curves).data["sequence"]["name"]
        slug = re.sub(r"[^A-Za-z0-9_.-]+", "_", name)
        if any(other.slug == slug for other in found):
            slug = f"{slug}-{len(found) + 1}"
        built = [_curve(label, points) for label, points in curves.items()]
        built.sort(key=lambda curve: (curve.is_anchor, curve.label))
        found.append(Experiment(name, _title(_first(curves)), slug, key, tuple(built)))
    return _distinct(found)


def _distinct(found: list[Experiment]) -> list[Experiment]:
    """Tell experiments of one name apart: by their frames if these differ, else by a number."""
    groups: dict[str, list[Experiment]] = {}
    for one in found:
        groups.setdefault(one.name, []).append(one)
    names = {}
    for name, members in groups.items():
        spans = [(one.key[1], one.key[1] + one.key[2] - 1) for one in members]
        differ = len(set(spans)) == len(spans)
        for number, (one, (first, last)) in enumerate(zip(members, spans, strict=True), 1):
            extra = f"frames {first} to {last}" if differ else str(number)
            names[one.key] = f"{name} ({extra})" if len(members) > 1 else name
    return [replace(one, name=names[one.key]) for one in found]


def _key(result: PointResult) -> tuple[str, int, int, bool]:
    options, sequence = result.data["options"], result.data["sequence"]
    return sequence["digest"], options["start"], result.data["totals"]["frames"], options["luma_only"]


def _label(result: PointResult) -> str:
    if result.data["codec"] == INTRA:
        return ANCHOR_LABEL
    if result.data["codec"] in ANCHOR_CODECS:
        return ANCHOR_CODECS[result.data["codec"]].label
    if result.data["codec"] in REFERENCE_LABELS:
        return REFERENCE_LABELS[result.data["codec"]]
    options = result.data["options"]
    if result.data["codec"] == IMPORTED:
        return str(options["options"]["curve"])
    given = sorted(options["options"].items()) + sorted(options.get("decoder", {}).items())
    extra = [name if value == "true" else f"{name} {value}" for name, value in given]
    if options.get("qp") is not None:
        extra.append("by QP")
    if (options.get("wz_q") or options.get("qp")) and options["key_qp"] not in ("auto", "lossless"):
        extra.append("chosen key QPs")
    if method := options.get("side_information"):
        extra.append(f"side information {method}")
    if result.data["key"].get("lossless"):
        extra.append("lossless key frames")
    return ", ".join([f"{result.data['codec'].upper()}-DVC, GOP {options['gop']}", *extra])


def _curve(label: str, points: list[PointResult]) -> Curve:
    ordered = sorted(points, key=lambda point: (point.rate_kbps, point.psnr_y_db))
    is_anchor = points[0].data["codec"] in (*ANCHORS.values(), *REFERENCE_LABELS, IMPORTED)
    return Curve(label, is_anchor, tuple(ordered))


def _title(result: PointResult) -> str:
    sequence, options = result.data["sequence"], result.data["options"]
    size = f"{sequence['width']}\N{MULTIPLICATION SIGN}{sequence['height']}"
    count, first = result.data["totals"]["frames"], options["start"]
    frames = f"frames {first} to {first + count - 1} at {sequence['frames_per_s']:.4g} Hz"
    return f"{sequence['name']}: {size}, {frames}, {'luma only' if options['luma_only'] else 'colour'}"


def _first(curves: dict[str, list[PointResult]]) -> PointResult:
    return next(iter(curves.values()))[0]
