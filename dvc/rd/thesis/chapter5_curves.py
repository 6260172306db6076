"""What chapter 5 of the thesis compares: methods of side information, curves, and the points of each."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from dvc.rd.curves import Curve, Experiment
from dvc.rd.point_result import PointResult
from dvc.rd.points import ANCHORS
from dvc.rd.tables import NOTHING

THESIS_SEQUENCES = ("street", "stairway", "statue")
LOSSLESS_GOP = 10
SEEN_QP = 26
"""QP of the key frames of figure 5.14; the point nearest to it is shown."""
KEYS = (("references", "keys"),)
HIERARCHICAL = (("references", "hierarchical"),)


@dataclass(frozen=True)
class Method:
    """One row of table 5.1."""

    name: str  # as the thesis calls it, or what is ours beside it
    codec: str  # of ours
    # what the decoder is told to predict with; None for dense depth, or block motion in 2D
    side_information: str | None
    # what the thesis has for its street, stairway and statue; None where it has no such method
    thesis_db: tuple[float, float, float] | None

    @property
    def options(self) -> tuple[tuple[str, str], ...]:
        """Options of the encoder: all methods predict from key frames only."""
        return KEYS if self.codec in ("3d-td", "3d-te") else ()

    def made(self, point: PointResult) -> bool:
        """Tell whether a point is of this method, with lossless key frames."""
        options = point.data["options"]
        return (
            point.data["codec"] == self.codec
            and point.data["key"].get("lossless") is True
            and options["gop"] == LOSSLESS_GOP
            and options.get("side_information") == self.side_information
            and options["options"] == dict(self.options)
        )


METHODS = (
    Method("2D-DVC (block motion)", "2d", None, (22.3, 19.0, 21.3)),
    Method("3D-DVC (epipolar blocks)", "3d", "blocks", (23.3, 20.0, 22.2)),
    Method("3D-DVC (mesh)", "3d", "mesh", (23.3, 20.1, 22.3)),
    Method("3D-DVC (depth)", "3d", None, None),
    Method("3D-DVC-TD (epipolar blocks)", "3d-td", "blocks", (28.4, 24.7, 25.5)),
    Method("3D-DVC-TD (mesh)", "3d-td", "mesh", (28.9, 25.0, 25.6)),
    Method("3D-DVC-TD (depth)", "3d-td", None, None),
    Method("3D-DVC-TE (epipolar blocks)", "3d-te", "blocks", (28.6, 28.0, 27.4)),
    Method("3D-DVC-TE (mesh)", "3d-te", "mesh", (29.3, 28.5, 27.6)),
    Method("3D-DVC-TE (depth)", "3d-te", None, None),
)
"""Rows of table 5.1 of [Maitre2008], with its numbers, and dense depth, which our codecs predict by."""


@dataclass(frozen=True)
class Duel:
    """Two curves of figure 5.15, and what the thesis says of them."""

    codec: str  # names in `CURVES`
    reference: str
    thesis: str  # where the first is better


CURVES: dict[str, Callable[[dict[str, Any]], bool]] = {
    "TE, key frames only": lambda data: _is(data, "3d-te", KEYS),
    "TE, hierarchical": lambda data: _is(data, "3d-te", HIERARCHICAL),
    "TD": lambda data: _is(data, "3d-td", ()),
    "3D without tracks": lambda data: _is(data, "3d", ()),
    "2D-DVC": lambda data: _is(data, "2d", ()),
    "H.264 intra": lambda data: data["codec"] == ANCHORS["intra"],
    "H.264 IPPP, zero motion": lambda data: data["codec"] == ANCHORS["x264-ippp-zero"],
    "H.264 IPPP": lambda data: data["codec"] == ANCHORS["x264-ippp"],
}
"""Curves of figure 5.15, by what tells their points."""

_ALL = "better at all rates"
_ZERO = "better up to 890 kbit/s (street), at all rates (stairway), up to 1400 kbit/s (statue)"
_TD = "better at all rates (street), up to 990 kbit/s (stairway), up to 740 kbit/s (statue)"
DUELS = (
    Duel("TE, key frames only", "2D-DVC", _ALL),
    Duel("TE, key frames only", "H.264 intra", "better"),
    Duel("TE, key frames only", "H.264 IPPP, zero motion", _ZERO),
    Duel("TE, key frames only", "H.264 IPPP", "worse"),
    Duel("TE, hierarchical", "2D-DVC", NOTHING),
    Duel("TE, hierarchical", "H.264 intra", NOTHING),
    Duel("TE, hierarchical", "H.264 IPPP, zero motion", NOTHING),
    Duel("TE, hierarchical", "H.264 IPPP", NOTHING),
    Duel("TD", "2D-DVC", _TD),
    Duel("TD", "H.264 intra", "better"),
    Duel("TD", "3D without tracks", "better"),
)
"""Comparisons that section 5.5.4 of [Maitre2008] makes, and the same for what it does not have."""


class ChapterPoints(NamedTuple):
    """What the pictures and tables of a sequence are made from."""

    # points of table 5.1 by name of the method, in the order of the table, as far as they are there
    lossless: dict[str, PointResult]
    # points of figure 5.13 by the QP of their key frames, the coarsest first, lossless last
    lossy: dict[str, PointResult]
    seen: PointResult | None  # point of figure 5.14: that whose key frames are nearest to `SEEN_QP`


def find_points(experiment: Experiment) -> ChapterPoints:
    """Find the points that the chapter shows by themselves."""
    points = [point for curve in experiment.curves for point in curve.points]
    made = {method.name: next((p for p in points if method.made(p)), None) for method in METHODS}
    lossless = {name: point for name, point in made.items() if point is not None}
    curve = find_curve(experiment, "TE, key frames only")
    coded = () if curve is None else curve.points
    lossy = {str(p.data["key"]["qp"]): p for p in sorted(coded, key=lambda p: -p.data["key"]["qp"])}
    if METHODS[-1].name in lossless:
        lossy["lossless"] = lossless[METHODS[-1].name]
    seen = min(coded, key=lambda point: abs(point.data["key"]["qp"] - SEEN_QP), default=None)
    return ChapterPoints(lossless, lossy, seen)


def find_curve(experiment: Experiment, name: str) -> Curve | None:
    """Find a curve of figure 5.15."""
    return next((curve for curve in experiment.curves if CURVES[name](curve.points[0].data)), None)


def _is(data: dict[str, Any], codec: str, options: tuple[tuple[str, str], ...]) -> bool:
    """Tell whether a point belongs to a curve of figure 5.15: lossy key frames, the rest as in `sweeps`."""
    return (
        data["codec"] == codec
        and data["key"].get("lossless") is not True
        and data["options"].get("side_information") is None
        and data["options"]["options"] == dict(options)
    )
