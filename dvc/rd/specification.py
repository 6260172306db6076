"""Points of an experiment, and the sweeps on the command line or in a file that list them."""

import re
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from dvc.config import DEFAULT_CODEC, MAX_QP, DiscoverMatrix, Qp, Quality, variant_of
from dvc.errors import ConfigError
from dvc.files import read_whole
from dvc.rd.anchors import ANCHOR_CODECS
from dvc.rd.originals import CodeVersion, Source, anchors_digest, values_digest
from dvc.versions import library_versions

SCHEMA = "dvc3d-rd-point/1"
"""Name and version of the format of result files."""
INTRA = "h264-intra"
ANCHORS = {"intra": INTRA, **{name: name for name in ANCHOR_CODECS}}
"""Codecs to compare with, by their names on the command line."""
NO_FEEDBACK = "no-feedback"
"""Option of the encoder for streams that are decoded without requests."""
USUAL_QPS = (22, 26, 30, 34, 38)
"""Default qualities of a sweep."""
MAX_NUMBERS = 1000
_RANGE = re.compile(r"(\d{1,9})(?:-(\d{1,9})(?::(\d{1,9}))?)?")
_OPTION_NAME = re.compile(r"[a-z][a-z0-9-]{0,40}")
_RESERVED = frozenset(
    (
        *("codec", "gop", "qp", "wz-q", "key-qp", "luma-only"),
        *("start", "frames", "serve", "timeout", "json", "quiet"),
    )
)
"""Options of the encoder that the experiment itself sets."""

Options = tuple[tuple[str, str], ...]
_BOUNDS = {"wz_q": (1, 8), "qp": (1, MAX_QP), "anchor_qp": (1, 51)}
"""Smallest and largest number of lists of numbers."""
_LISTS = {"sequences", "key_qp", "anchors", *_BOUNDS}
Whole = Annotated[int, Meta(ge=0)]
Positive = Annotated[int, Meta(ge=1)]


def _arguments(options: Options) -> list[str]:
    given = [[f"--{name}"] if value == "true" else [f"--{name}", value] for name, value in options]
    return [word for words in given for word in words]


@dataclass(frozen=True)
class Point:
    """One point of a rate-distortion curve, before it is measured."""

    sequence: str  # name of the catalogue, or a path
    codec: str  # a variant of the codec, or a value of `ANCHORS`
    wz_q: int | None  # DISCOVER matrix
    key_qp: str  # QP of the key frames, ``"auto"`` or ``"lossless"``
    gop: int  # frames from one key frame to the next; 0: only the first is one
    start: int = 0  # first frame
    frames: int | None = None  # number of frames; None for all
    luma_only: bool = False
    options: Options = ()  # further options of the encoder without dashes, sorted; flags are ``"true"``
    side_information: str | None = None  # method that replaces the one in the stream
    qp: int | None = None  # quality that sets key frames, steps and requests together
    decoder: Options = ()  # further options of the decoder, as in `options`
    proof: bool = True  # decode the punctured stream again, in a fresh process

    @property
    def has_wyner_ziv(self) -> bool:
        """Whether some frames are not key frames."""
        return self.gop != 1 and (self.wz_q is not None or self.qp is not None)

    @property
    def no_feedback(self) -> bool:
        """Whether the encoder's own file is decoded, without requests."""
        return (NO_FEEDBACK, "true") in self.options

    def encoder_options(self) -> list[str]:
        """Return the options of the encoder that make this point."""
        words = ["--codec", "2d" if self.codec == INTRA else self.codec]
        words += ["--gop", str(self.gop), "--key-qp", self.key_qp, "--start", str(self.start)]
        for name, value in (("wz-q", self.wz_q), ("qp", self.qp), ("frames", self.frames)):
            words += [] if value is None else [f"--{name}", str(value)]
        return words + ["--luma-only"] * self.luma_only + _arguments(self.options)

    def decoder_options(self) -> list[str]:
        """Return the options of the decoder that make this point."""
        method = [] if self.side_information is None else ["--side-information", self.side_information]
        return method + _arguments(self.decoder)

    def to_dict(self) -> dict[str, Any]:
        """Return all except the sequence as JSON-safe values, without entries that are rarely set."""
        values = asdict(self) | {"options": dict(self.options), "decoder": dict(self.decoder)}
        defaults: dict[str, object] = {"side_information": None, "qp": None, "decoder": {}, "proof": True}
        del values["sequence"]
        return {k: v for k, v in values.items() if k not in defaults or v != defaults[k]}


@dataclass(frozen=True)
class Task:
    """A point with everything that identifies its result."""

    point: Point
    source: Source
    code: CodeVersion

    @property
    def name(self) -> str:
        """Name of the result file without suffix: sequence, codec and quality, then a unique digest."""
        point = self.point
        preset = "" if point.wz_q is None else f"-q{point.wz_q}"
        key_qp = re.sub(r"[^A-Za-z0-9]+", "_", point.key_qp)[:20]
        if point.qp is not None and point.key_qp == "auto":
            key_qp = str(point.qp)
        unique = values_digest([point.to_dict(), self.source.digest])[:8]
        return f"{self.source.name}-{point.codec}{preset}-qp{key_qp}-{unique}"

    @property
    def identity(self) -> str:
        """Digest of configuration, input, code and libraries: equal if the result would be."""
        version = "anchors" if self.point.codec in ANCHOR_CODECS else self.code.version
        made_by = [version, self.code_digest, library_versions()]
        return values_digest([SCHEMA, self.point.to_dict(), self.source.digest, made_by])

    @property
    def code_digest(self) -> str:
        """Digest of the code of the codec, or of the code that runs an anchor's encoder."""
        return anchors_digest() if self.point.codec in ANCHOR_CODECS else self.code.digest


@dataclass(frozen=True)
class Sweep:
    """Points that differ in sequence and rate; defaults and meanings are those of `Point`."""

    sequences: tuple[str, ...] = ()  # names of the catalogue, or paths
    codec: str = DEFAULT_CODEC
    wz_q: tuple[int, ...] = ()  # DISCOVER quantisation matrices
    key_qp: tuple[str, ...] = ("auto",)  # one QP, or one for each matrix or quality
    gop: Positive | None = None  # None: chosen by the codec
    start: Whole = 0
    frames: Positive | None = None
    luma_only: bool = False
    options: Options = ()
    side_information: str | None = None
    anchors: tuple[str, ...] = ()  # keys of `ANCHORS`
    anchor_qp: tuple[int, ...] = tuple(range(20, 45, 4))  # QPs of the anchors besides those of the sweep
    qp: tuple[int, ...] = ()  # qualities, which exclude `wz_q`; `USUAL_QPS` without either
    no_feedback: bool = False
    proof: bool = True

    def __post_init__(self) -> None:
        if not self.sequences:
            raise ConfigError("a sweep needs at least one sequence")
        if self.qp and self.wz_q:
            raise ConfigError("a sweep takes either qualities (qp) or matrices (wz_q)")
        count, noun = len(self._levels()), "matrices" if self.wz_q else "qualities"
        if self._has_levels() and len(self.key_qp) not in (1, count):
            raise ConfigError(f"{len(self.key_qp)} key QPs for {count} {noun}; give one, or one each")
        for name in self.anchors:
            if name not in ANCHORS:
                raise ConfigError(f"the anchor must be one of {', '.join(ANCHORS)}, got {name!r}")
        for name in ([self.side_information] if self.side_information else []) + list(dict(self.options)):
            check_option(name)

    def points(self) -> Iterator[Point]:
        """Yield the points, sequence by sequence, anchors last."""
        options = dict(self.options) | ({NO_FEEDBACK: "true"} if self.no_feedback else {})
        levels = self._levels() if self._has_levels() else [(None, None)] * len(self.key_qp)
        key_qps = self.key_qp if len(self.key_qp) > 1 else self.key_qp * len(levels)
        for sequence in self.sequences:
            point = partial(Point, sequence, start=self.start, frames=self.frames, luma_only=self.luma_only)
            for (wz_q, qp), key_qp in zip(levels, key_qps, strict=False):
                yield point(
                    codec=self.codec,
                    wz_q=wz_q,
                    key_qp=key_qp,
                    gop=self._gop_length(),
                    options=tuple(sorted(options.items())),
                    side_information=self.side_information,
                    qp=qp,
                    proof=self.proof,
                )
            for anchor in self.anchors:
                codec = ANCHORS[anchor]
                is_intra = codec == INTRA or ANCHOR_CODECS[codec].structure == "intra"
                gop = 1 if is_intra else ANCHOR_CODECS[codec].intra_period  # 0: only the first is intra
                for qp in self._anchor_qps():
                    yield point(codec=codec, wz_q=None, key_qp=str(qp), gop=gop)

    def _has_levels(self) -> bool:
        """Return whether points differ in matrix or quality; a matrix has no effect on key frames."""
        return self._gop_length() > 1 or bool(self.qp)

    def _levels(self) -> list[tuple[int | None, int | None]]:
        """List matrix and quality of the points; one of them is None."""
        if self.wz_q:
            return [(matrix, None) for matrix in self.wz_q]
        return [(None, qp) for qp in self.qp or USUAL_QPS]

    def _gop_length(self) -> int:
        if self.gop is not None:
            return self.gop
        options = dict(self.options)
        is_chosen = bool({"key-frames", "intra-period"} & options.keys())
        is_intra = options.get("key-frames") == "intra" or (bool(self.wz_q) and not is_chosen)
        return variant_of(self.codec).groups(options.get("references"), 0 if is_intra else None).length

    def _anchor_qps(self) -> list[int]:
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
    """Raise `ConfigError` for an option of the encoder that the experiment sets, or that cannot be one."""
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


def parse_options(words: Sequence[str]) -> Options:
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
    sweeps, defaults = document.get("sweep"), document.get("defaults", {})
    is_list = isinstance(sweeps, list) and all(isinstance(sweep, dict) for sweep in sweeps)
    if set(document) - {"defaults", "sweep"} or not sweeps or not is_list or not isinstance(defaults, dict):
        raise ConfigError(f"{path}: expected tables [[sweep]] and, optionally, [defaults]")
    names = {entry.name for entry in fields(Sweep)}
    merged = [{**defaults, **sweep} for sweep in sweeps]
    if unknown := [name for values in merged for name in values if name not in names]:
        raise ConfigError(f"{path}: no field {unknown[0]!r}; expected {', '.join(sorted(names))}")
    return merged


def build_sweep(values: dict[str, Any]) -> Sweep:
    """Build a sweep from plain values; None is a value that was not given."""
    given = {name: value for name, value in values.items() if value is not None}
    for name in _LISTS & given.keys():
        value = given[name]
        words = value if isinstance(value, (list, tuple)) else str(value).split(",")
        if not words or not all(isinstance(word, (str, int)) and str(word) for word in words):
            raise ConfigError(f"`{name}` must be a list of names or numbers, got {value!r}")
        given[name] = tuple(map(str, words))
        if name in _BOUNDS:
            given[name] = parse_numbers(",".join(given[name]), *_BOUNDS[name])
    if isinstance(options := given.get("options"), dict):
        texts = {name: str(value) for name, value in options.items()}
        flags = {name: texts[name].lower() for name, value in options.items() if isinstance(value, bool)}
        given["options"] = tuple(sorted((texts | flags).items()))
    try:
        return msgspec.convert(given, Sweep)
    except msgspec.ValidationError as err:
        problem, _, name = str(err).partition(" - at `$.")
        raise ConfigError(f"`{name.rstrip('`')}`: {problem}") from err


def expand(sweeps: Sequence[Sweep]) -> list[Point]:
    """List the points of several sweeps."""
    return list(dict.fromkeys(point for sweep in sweeps for point in sweep.points()))
