"""What is asked for: sweeps, on the command line or in a file, and the points that they mean."""

import re
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from dvc.config import (
    DEFAULT_CODEC,
    MAX_QP,
    DiscoverMatrix,
    Qp,
    Quality,
    variant_of,
)
from dvc.errors import ConfigError
from dvc.files import read_whole
from dvc.rd.anchors.codecs import ANCHOR_CODECS
from dvc.rd.points import ANCHORS, NO_FEEDBACK, Point, anchor_gop

MAX_NUMBERS = 1000
USUAL_QPS = (22, 26, 30, 34, 38)
"""Qualities of a sweep that says nothing else."""
_RANGE = re.compile(r"(\d{1,9})(?:-(\d{1,9})(?::(\d{1,9}))?)?")
_OPTION_NAME = re.compile(r"[a-z][a-z0-9-]{0,40}")
_RESERVED = frozenset(
    {
        "codec",
        "gop",
        "qp",
        "wz-q",
        "key-qp",
        "luma-only",
        "start",
        "frames",
        "serve",
        "timeout",
        "json",
        "quiet",
    }
)


@dataclass(frozen=True)
class Sweep:
    """Points that differ in sequence and rate."""

    sequences: tuple[str, ...] = ()  # names of the catalogue, or paths
    codec: str = DEFAULT_CODEC  # one of `dvc.config.VARIANTS`
    wz_q: tuple[int, ...] = ()  # DISCOVER quantisation matrices
    key_qp: tuple[str, ...] = ("auto",)  # one QP for all matrices or qualities, or one for each
    gop: int | None = None  # as in `Point`; None for the codec's own
    start: int = 0  # as in `Point`
    frames: int | None = None
    luma_only: bool = False
    options: tuple[tuple[str, str], ...] = ()
    side_information: str | None = None
    anchors: tuple[str, ...] = ()  # names in `ANCHORS`
    # QPs of the anchors beside those of the sweep itself
    anchor_qp: tuple[int, ...] = field(default=tuple(range(20, 45, 4)))
    # qualities that set key frames, steps and requests together, in place of matrices; in place of neither,
    # `USUAL_QPS`
    qp: tuple[int, ...] = ()
    no_feedback: bool = False  # whether nothing is sent of Wyner-Ziv frames, which no decoder asks for
    proof: bool = True  # as in `Point`

    def __post_init__(self) -> None:
        if not self.sequences:
            raise ConfigError("a sweep needs at least one sequence")
        if self.qp and self.wz_q:
            raise ConfigError("qualities (qp) or matrices (wz_q): a sweep takes one of them")
        count, what = len(self._levels()), "matrices" if self.wz_q else "qualities"
        if self._has_levels() and len(self.key_qp) not in (1, count):
            raise ConfigError(f"{len(self.key_qp)} key QPs for {count} {what}; give one, or one each")
        for name in self.anchors:
            if name not in ANCHORS:
                raise ConfigError(f"the anchor must be one of {', '.join(ANCHORS)}, got {name!r}")
            if name in ANCHOR_CODECS and ANCHOR_CODECS[name].zero_motion and not self.luma_only:
                raise ConfigError(f"the anchor {name} codes luma only: add --luma-only")
        if self.side_information is not None:
            check_option(self.side_information)
        for name, _ in self.options:
            check_option(name)

    def points(self) -> Iterator[Point]:
        """Yield the points, sequence by sequence, anchors last."""
        gop = self._gop_length()
        levels = self._levels() if self._has_levels() else [(None, None)] * len(self.key_qp)
        key_qps = self.key_qp if len(self.key_qp) > 1 else self.key_qp * len(levels)
        for sequence in self.sequences:
            common = {"start": self.start, "frames": self.frames, "luma_only": self.luma_only}
            for (wz_q, qp), key_qp in zip(levels, key_qps, strict=False):
                yield Point(
                    sequence,
                    self.codec,
                    wz_q,
                    key_qp,
                    gop,
                    options=self._encoder_options(),
                    side_information=self.side_information,
                    qp=qp,
                    proof=self.proof,
                    **common,  # type: ignore[arg-type]
                )
            for anchor in self.anchors:
                gop_length = anchor_gop(ANCHORS[anchor])
                for qp in self.anchor_qps():
                    yield Point(sequence, ANCHORS[anchor], None, str(qp), gop_length, **common)  # type: ignore[arg-type]

    def _encoder_options(self) -> tuple[tuple[str, str], ...]:
        """Return further options of the encoder."""
        own = {NO_FEEDBACK: "true"} if self.no_feedback else {}
        return tuple(sorted({**dict(self.options), **own}.items()))

    def _has_levels(self) -> bool:
        """Tell whether points differ in matrix or quality: a matrix says nothing of key frames."""
        return self._gop_length() > 1 or bool(self.qp)

    def _levels(self) -> list[tuple[int | None, int | None]]:
        """List matrix or quality of the points, the other being none."""
        if self.wz_q:
            return [(matrix, None) for matrix in self.wz_q]
        return [(None, qp) for qp in self.qp or USUAL_QPS]

    def _gop_length(self) -> int:
        options = dict(self.options)
        is_chosen = bool({"key-frames", "intra-period"} & options.keys())
        is_intra = options.get("key-frames") == "intra" or (bool(self.wz_q) and not is_chosen)
        usual = variant_of(self.codec).groups(options.get("references"), 0 if is_intra else None).length
        return usual if self.gop is None else self.gop

    def anchor_qps(self) -> list[int]:
        """Return the QPs of the anchors: their own, and those of the sweep's key frames."""
        qps = set(self.anchor_qp)
        levels = self._levels()
        for (wz_q, qp), key_qp in zip(levels, self.key_qp * len(levels), strict=False):
            if key_qp == "auto":
                quality: Quality = Qp(qp or 0) if wz_q is None else DiscoverMatrix(wz_q)
                qps.add(quality.key_qp)
            elif key_qp.isdecimal():
                qps.add(int(key_qp))
        return sorted(qps)


def check_option(name: str) -> None:
    """Refuse an option of the encoder that the experiment itself sets, or that cannot be one."""
    if not _OPTION_NAME.fullmatch(name) or name in _RESERVED:
        raise ConfigError(f"{name!r} cannot be given as an option of the encoder")


def parse_numbers(text: str, low: int, high: int) -> tuple[int, ...]:
    """Read a list of whole numbers and ranges."""
    numbers: dict[int, None] = {}
    for part in text.split(","):
        match = _RANGE.fullmatch(part.strip())
        first = int(match[1]) if match else low - 1
        last = int(match[2]) if match and match[2] else first
        step = int(match[3]) if match and match[3] else 1
        if not low <= first <= last <= high or step < 1 or last - first > MAX_NUMBERS:
            raise ConfigError(
                f"expected numbers from {low} to {high} such as {low},{low + 1} or {low}-{high}, got {text!r}"
            )
        numbers.update(dict.fromkeys(range(first, last + 1, step)))
    return tuple(numbers)


def parse_options(words: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """Read options of the encoder as ``NAME=VALUE``; a flag has the value ``true``."""
    options = {}
    for word in words:
        name, _, value = word.partition("=")
        check_option(name)
        options[name] = value or "true"
    return tuple(sorted(options.items()))


def read_spec(path: Path) -> list[dict[str, Any]]:
    """Read the sweeps of a specification file."""
    try:
        document = tomllib.loads(read_whole(path).decode())
    except (ValueError, RecursionError) as err:
        raise ConfigError(f"{path}: {err}") from err
    unknown = set(document) - {"defaults", "sweep"}
    sweeps, defaults = document.get("sweep"), document.get("defaults", {})
    if unknown or not isinstance(sweeps, list) or not sweeps or not isinstance(defaults, dict):
        raise ConfigError(f"{path}: expected tables [[sweep]] and, if wanted, [defaults]")
    names = {entry.name for entry in fields(Sweep)}
    merged = [{**defaults, **sweep} if isinstance(sweep, dict) else {"": sweep} for sweep in sweeps]
    for given in merged:
        for name in given:
            if name not in names:
                raise ConfigError(f"{path}: no field {name!r}; there are {', '.join(sorted(names))}")
    return merged


def build_sweep(given: dict[str, Any]) -> Sweep:
    """Build a sweep from plain values."""
    values = {name: value for name, value in given.items() if value is not None}
    for name in ("sequences", "key_qp", "anchors"):
        if name in values:
            values[name] = tuple(_listed(name, values[name]))
    ranges = {"wz_q": (1, 8), "qp": (1, MAX_QP), "anchor_qp": (1, 51)}
    for name, (low, high) in ranges.items():
        if name in values:
            values[name] = parse_numbers(",".join(_listed(name, values[name])), low, high)
    for name, low in (("gop", 1), ("start", 0), ("frames", 1)):
        if name in values and (type(values[name]) is not int or values[name] < low):
            raise ConfigError(f"`{name}` must be a whole number from {low}, got {values[name]!r}")
    for name in ("luma_only", "no_feedback", "proof"):
        if not isinstance(values.get(name, True), bool):
            raise ConfigError(f"`{name}` must be true or false, got {values[name]!r}")
    if not isinstance(values.get("codec", ""), str):
        raise ConfigError(f"`codec` must be a name, got {values['codec']!r}")
    if isinstance(values.get("options"), dict):
        values["options"] = tuple(sorted((name, _word(value)) for name, value in values["options"].items()))
    if not isinstance(values.get("side_information", ""), str):
        raise ConfigError(f"`side_information` must be a name, got {values['side_information']!r}")
    if not isinstance(values.get("options", ()), tuple):
        raise ConfigError(f"`options` must be a table of options and values, got {values['options']!r}")
    return Sweep(**values)


def _word(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _listed(name: str, value: object) -> list[str]:
    """Return the words of a list, or of one value."""
    items = value if isinstance(value, (list, tuple)) else str(value).split(",")
    if not items or not all(isinstance(item, (str, int)) and str(item) for item in items):
        raise ConfigError(f"`{name}` must be a list of names or numbers, got {value!r}")
    return [str(item) for item in items]


def expand(sweeps: Sequence[Sweep]) -> list[Point]:
    """List the points of several sweeps."""
    return list(dict.fromkeys(point for sweep in sweeps for point in sweep.points()))
