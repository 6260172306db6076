"""Results as comma-separated values: a line per point, or per frame."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from dvc.rd.curves import experiments
from dvc.rd.point_result import PointResult
from dvc.rd.tables import csv_text

Column = Callable[[PointResult], object]


def results_csv(results: Sequence[PointResult], *, per_frame: bool = False) -> str:
    """Write a line for each point, or for each frame of each point."""
    names = _POINT_OF_FRAME if per_frame else tuple(POINT_COLUMNS)
    rows: list[list[object]] = []
    for one in experiments(results):
        for curve in one.curves:
            for point in curve.points:
                cells = [
                    point.data["sequence"]["name"],
                    curve.label,
                    *(POINT_COLUMNS[n](point) for n in names),
                ]
                frames = point.data.get("per_frame", ()) if per_frame else ()
                rows += [[*cells, *_frame_cells(frame)] for frame in frames] if per_frame else [cells]
    return csv_text(("sequence", "curve", *names, *(FRAME_COLUMNS if per_frame else ())), rows)


def _entry(*names: str) -> Column:
    """Return a column of one entry of a result, empty where it is missing."""

    def column(point: PointResult) -> object:
        value: Any = point.data
        for name in names:
            value = value.get(name) if isinstance(value, Mapping) else None
        return value

    return column


def _options(point: PointResult) -> str:
    """Write further options of the encoder as `--option` takes them."""
    options = point.data["options"]["options"]
    return " ".join(name if value == "true" else f"{name}={value}" for name, value in sorted(options.items()))


POINT_COLUMNS: dict[str, Column] = {
    "point": lambda point: point.name,
    "codec": _entry("codec"),
    "gop": _entry("options", "gop"),
    "wz_q": _entry("options", "wz_q"),
    "key_qp": _entry("key", "qp"),
    "lossless_keys": _entry("key", "lossless"),
    "side_information": _entry("options", "side_information"),
    "options": _options,
    "width": _entry("sequence", "width"),
    "height": _entry("sequence", "height"),
    "frames_per_s": _entry("sequence", "frames_per_s"),
    "first_frame": _entry("options", "start"),
    "frames": _entry("totals", "frames"),
    "luma_only": _entry("options", "luma_only"),
    "rate_kbps": _entry("totals", "rate_kbps"),
    "psnr_y_db": _entry("totals", "psnr_y_db"),
    "key_psnr_y_db": _entry("totals", "key_psnr_y_db"),
    "wz_psnr_y_db": _entry("totals", "wz_psnr_y_db"),
    "si_psnr_y_db": _entry("totals", "si_psnr_y_db"),
    "refined_si_psnr_y_db": _entry("totals", "refined_si_psnr_y_db"),
    "stream_bytes": _entry("totals", "stream_bytes"),
    "key_bits": _entry("totals", "bits", "key"),
    "tracks_bits": _entry("totals", "bits", "tracks"),
    "parity_bits": _entry("totals", "bits", "parity"),
    "crc_bits": _entry("totals", "bits", "crc"),
    "header_bits": _entry("totals", "bits", "header"),
    "num_requests": _entry("totals", "num_requests"),
    "num_failed_planes": _entry("totals", "num_failed_planes"),
    "encode_cpu_s": _entry("times", "encode_cpu_s"),
    "decode_cpu_s": _entry("times", "decode_cpu_s"),
    "code_version": _entry("code", "version"),
    "code_commit": _entry("code", "commit"),
    "code_digest": _entry("code", "digest"),
    "sequence_digest": _entry("sequence", "digest"),
    "date": _entry("date"),
    "intra_bits": _entry("totals", "bits", "intra"),
    "inter_bits": _entry("totals", "bits", "inter"),
    "key_encode_cpu_s": _entry("times", "key_encode_cpu_s"),
    "wz_encode_cpu_s": _entry("times", "wz_encode_cpu_s"),
    "tracking_cpu_s": _entry("times", "tracking_cpu_s"),
    "coding_cpu_s": _entry("times", "coding_cpu_s"),
    "qp": _entry("options", "qp"),
    "psnr_cb_db": _entry("totals", "psnr_cb_db"),
    "psnr_cr_db": _entry("totals", "psnr_cr_db"),
    "psnr_yuv_db": _entry("totals", "psnr_yuv_db"),
}
"""Columns of `results_csv` after `sequence` and `curve`; new ones are added at the end only."""

_POINT_OF_FRAME = ("point", "codec", "gop", "wz_q", "key_qp", "lossless_keys")
FRAME_COLUMNS = (
    "index",
    "type",
    "bits",
    "psnr_y_db",
    "si_psnr_y_db",
    "refined_si_psnr_y_db",
    "num_requests",
    "num_failed_planes",
    "side_information",
    "side_information_reason",
    "decode_s",
    "key_bits",
    "tracks_bits",
    "parity_bits",
    "crc_bits",
    "header_bits",
    "psnr_cb_db",
    "psnr_cr_db",
)
"""Columns of a frame, after those of its point; new ones are added at the end only."""


def _frame_cells(frame: Mapping[str, Any]) -> list[object]:
    """Return the cells of a frame; its bits are one number, or one for each kind."""
    bits = frame.get("bits")
    kinds = bits if isinstance(bits, Mapping) else {}
    total = sum(value for value in kinds.values() if isinstance(value, int)) if kinds else bits
    cells = {**frame, "bits": total, **{f"{kind}_bits": value for kind, value in kinds.items()}}
    return [cells.get(name) for name in FRAME_COLUMNS]
