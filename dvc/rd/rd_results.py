"""Results of points: one JSON file each, written whole or not at all; see `docs/rd.md`."""

import logging
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from dvc import cli
from dvc.errors import DvcError
from dvc.rd.originals import CodeVersion, values_digest
from dvc.rd.specification import SCHEMA, Point, Task

POINTS_FOLDER = "points"
IMPORTED = "imported"
"""Codec of imported points; see `dvc.rd.points_csv`."""
MAX_NUMBER = 1e15
"""Bound of all numbers in results."""
SHARES = ("key", "intra", "inter", "parity", "crc", "tracks", "header", "stream")
"""Kinds of bits, in the order of tables."""
_LOG = logging.getLogger(__name__)

Number = Annotated[float, Meta(gt=-MAX_NUMBER, lt=MAX_NUMBER)]
Positive = Annotated[float, Meta(gt=0, lt=MAX_NUMBER)]
Count = Annotated[int, Meta(ge=0, lt=10**15)]
Size = Annotated[int, Meta(ge=1, lt=10**9)]


@dataclass(frozen=True)
class SequenceInfo:
    """Original of a point."""

    name: str
    digest: str  # digest of the contents
    width: Size
    height: Size
    frames_per_s: Positive


@dataclass(frozen=True)
class PointOptions:
    """Options of a point, as `dvc.rd.specification.Point.to_dict` writes them."""

    codec: str
    wz_q: int | None
    key_qp: str
    gop: Count
    start: Count
    frames: int | None
    luma_only: bool
    options: dict[str, str]
    side_information: str | None = None
    qp: int | None = None
    decoder: dict[str, str] = field(default_factory=dict)
    proof: bool = True


@dataclass(frozen=True)
class KeyQuality:
    """Quality of the key frames."""

    qp: int | None
    lossless: bool = False


@dataclass(frozen=True)
class Totals:
    """Rate and PSNRs of all frames; entries that a codec does not have are None."""

    frames: Size
    stream_bytes: Count
    rate_kbps: Positive
    psnr_y_db: Number
    bits: dict[str, Count]  # by kind, see `SHARES`
    duration_s: Number | None = None
    key_psnr_y_db: Number | None = None
    wz_psnr_y_db: Number | None = None
    si_psnr_y_db: Number | None = None
    refined_si_psnr_y_db: Number | None = None
    worst_psnr_y_db: Number | None = None
    psnr_cb_db: Number | None = None
    psnr_cr_db: Number | None = None
    psnr_yuv_db: Number | None = None  # (6 Y + Cb + Cr) / 8
    num_requests: Count | None = None
    num_failed_planes: Count | None = None
    decode_s: Number | None = None
    plane_bits: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not sum(self.bits.values()):
            raise ValueError("totals.bits are all zero")


@dataclass(frozen=True)
class CpuTimes:
    """Processor times in seconds."""

    encode_cpu_s: Number | None = None  # whole processes
    decode_cpu_s: Number | None = None
    coding_cpu_s: Number | None = None  # encoding, without reading the input and loading code
    key_encode_cpu_s: Number | None = None
    wz_encode_cpu_s: Number | None = None
    tracking_cpu_s: Number | None = None


@dataclass(frozen=True)
class FrameResult:
    """Measurements of one frame; entries that its type does not have are None."""

    type: str  # ``key``, ``wz``, ``intra`` or ``inter``
    index: Count | None = None
    bits: Count | dict[str, Count] | None = None
    psnr_y_db: Number | None = None
    psnr_cb_db: Number | None = None
    psnr_cr_db: Number | None = None
    si_psnr_y_db: Number | None = None
    refined_si_psnr_y_db: Number | None = None
    num_requests: Count | None = None
    num_failed_planes: Count | None = None
    side_information: str | None = None
    side_information_reason: str | None = None
    decode_s: Number | None = None


@dataclass(frozen=True)
class PictureFiles:
    """Pictures of one frame and of the key frame before it; file names in the folder of the experiment."""

    index: Count | None = None
    key_index: Count | None = None
    original: str | None = None
    decoded: str | None = None
    predicted: str | None = None
    key: str | None = None


PICTURE_KINDS = ("original", "decoded", "predicted", "key")


@dataclass(frozen=True)
class Proof:
    """Check that the rate is the size of a file that decodes to these frames."""

    fresh_decode_equal: bool | None = None  # a fresh process decoded the punctured stream to the same frames


@dataclass(frozen=True)
class PointResult:
    """A measured or imported point, with the entries that reports need."""

    schema: Literal["dvc3d-rd-point/1"]
    identity: str
    sequence: SequenceInfo
    codec: str
    options: PointOptions
    code: CodeVersion
    key: KeyQuality
    totals: Totals
    times: CpuTimes
    date: str = ""
    libraries: dict[str, str] = field(default_factory=dict)
    commands: tuple[str, ...] = ()
    proof: Proof = Proof()
    per_frame: tuple[FrameResult, ...] = ()
    pictures: PictureFiles | None = None
    name: str = ""  # file name without suffix; not part of the file

    def __post_init__(self) -> None:
        if self.codec == IMPORTED and not {"curve", "point"} <= self.options.options.keys():
            raise ValueError("options.options lacks the name of the curve or point")

    @property
    def rate_kbps(self) -> float:
        """Rate in kbit/s."""
        return self.totals.rate_kbps

    @property
    def psnr_y_db(self) -> float:
        """Mean luma PSNR of the frames in dB."""
        return self.totals.psnr_y_db

    @property
    def has_level(self) -> bool:
        """Whether a matrix or a quality was given, besides the QP of key frames."""
        return self.options.wz_q is not None or self.options.qp is not None

    @property
    def level(self) -> str:
        """Matrix such as ``Q4``, or quality such as ``QP 28``; of an intra codec that of its key frames."""
        if self.codec == IMPORTED:
            return self.options.options["point"]
        if self.options.wz_q is not None:
            return f"Q{self.options.wz_q}"
        return f"QP {self.key.qp if self.options.qp is None else self.options.qp}"

    @property
    def label(self) -> str:
        """Name of the point on its curve, such as ``Q4, key QP 34`` or ``QP 28``."""
        if self.codec == IMPORTED:
            return self.level
        if not self.has_level:
            return "lossless" if self.key.lossless else f"QP {self.key.qp}"
        return f"{self.level}, {'lossless keys' if self.key.lossless else f'key QP {self.key.qp}'}"

    @property
    def is_proven(self) -> bool:
        """Whether a fresh process decoded the punctured stream to the same frames."""
        return self.proof.fresh_decode_equal is True

    def num_frames(self, frame_type: str) -> int:
        """Count the frames of a type."""
        return sum(row.type == frame_type for row in self.per_frame)

    def cpu_ms(self, part: Literal["coding", "encode", "decode", "key_encode", "wz_encode"]) -> float | None:
        """Return the processor time of a part by frame; of `key_encode` and `wz_encode` by their frames."""
        total_s, kind = getattr(self.times, f"{part}_cpu_s"), part.partition("_")[0]
        count = self.num_frames(kind) if kind in ("key", "wz") else self.totals.frames
        return None if total_s is None or not count else 1000 * total_s / count

    @property
    def bit_shares(self) -> dict[str, float]:
        """Shares of the bits in per cent by kind, without kinds that have no bit."""
        bits, total = self.totals.bits, sum(self.totals.bits.values())
        order = [*SHARES, *sorted(set(bits) - set(SHARES))]
        return {name: 100 * bits[name] / total for name in order if bits.get(name)}


def mean(values: Iterable[float | None]) -> float | None:
    """Return the mean of the values that are not None."""
    numbers = [value for value in values if value is not None]
    return sum(numbers) / len(numbers) if numbers else None


def parse_result(name: str, data: object) -> PointResult:
    """Build a result from JSON-safe values or the text of a file; raise `DvcError` if one is wrong."""
    try:
        if isinstance(data, bytes):
            data = msgspec.json.decode(data)
        schema = data.get("schema") if isinstance(data, dict) else None
        if schema != SCHEMA:
            raise DvcError(f"{name}.json: not a result of schema {SCHEMA}")
        return replace(msgspec.convert(data, PointResult), name=name)
    except (msgspec.MsgspecError, ValueError, RecursionError) as err:
        raise DvcError(f"{name}.json: damaged result: {err}") from err


def read_result(path: Path) -> PointResult:
    """Read and check a result."""
    try:
        return parse_result(path.stem, path.read_bytes())
    except OSError as err:
        raise DvcError(f"{path.name}: damaged result: {err}") from err


def write_result(folder: Path, name: str, data: dict[str, Any]) -> PointResult:
    """Write a result; the inverse of `read_result`."""
    path = folder / POINTS_FOLDER / f"{name}.json"
    cli.write_json(path, data)
    return read_result(path)


def options_of(point: Point) -> PointOptions:
    """Return the options that the result of a point has."""
    return msgspec.convert(point.to_dict(), PointOptions)


def is_finished(folder: Path, task: Task, any_version: bool = False) -> bool:
    """Return whether a valid result of a task exists; log the reason if an existing file does not count."""
    path = folder / POINTS_FOLDER / f"{task.name}.json"
    if not path.exists():
        return False
    try:
        result = read_result(path)
    except DvcError as err:
        _LOG.warning("%s; measuring again", err)
        return False
    if result.identity == task.identity or (any_version and result.options == options_of(task.point)):
        return True
    _LOG.warning("%s: made by another version of the code; measuring again", path.name)
    return False


def read_results(folder: Path) -> list[PointResult]:
    """Read all results of an experiment; log damaged ones and leave them out."""
    results = []
    for path in sorted((folder / POINTS_FOLDER).glob("*.json")):
        try:
            results.append(read_result(path))
        except DvcError as err:
            _LOG.warning("%s; left out", err)
    if not results:
        raise DvcError(f"{folder}: no results in its folder {POINTS_FOLDER}; make some with `dvc-rd run`")
    return results


def read_folders(folders: Sequence[Path]) -> tuple[list[PointResult], list[str]]:
    """Return each point of several experiments once, the newer result if two are there, and notes."""
    newest: dict[str, PointResult] = {}
    damaged: list[str] = []
    num_replaced = 0
    for folder in folders:
        results, root = read_results(folder), folder.resolve()
        names = {result.name for result in results}
        damaged += [
            path.name for path in sorted((folder / POINTS_FOLDER).glob("*.json")) if path.stem not in names
        ]
        for result in results:
            key = values_digest(msgspec.to_builtins([result.codec, result.options, result.sequence]))
            other = newest.get(key)
            num_replaced += other is not None and other.identity != result.identity
            if other is None or result.date > other.date:
                newest[key] = result
                if result.pictures is not None:  # absolute names, if these do not lead out of the folder
                    located: dict[str, Any] = {}
                    for kind in PICTURE_KINDS:
                        name = getattr(result.pictures, kind) or ""
                        path = root if "\0" in name else (root / name).resolve()
                        located[kind] = str(path) if root in path.parents else None
                    newest[key] = replace(result, pictures=replace(result.pictures, **located))
    notes = []
    if damaged:
        noun = "damaged file" if len(damaged) == 1 else "damaged files"
        notes.append(f"{len(damaged)} {noun} left out: {', '.join(damaged)}.")
    if num_replaced:
        noun = "result" if num_replaced == 1 else "results"
        notes.append(f"{num_replaced} {noun} of an older measurement left out for a newer one.")
    return list(newest.values()), notes
