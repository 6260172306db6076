"""A measured point and its numbers."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from dvc.config import VARIANTS

SHARES = ("key", "intra", "inter", "parity", "crc", "tracks", "header", "stream")
"""What bits can be, in the order in which shares are shown."""
LETTERS = {"key": "k", "intra": "k", "wz": "w", "inter": "p"}
IMPORTED = "imported"
"""Codec of points that others have measured; see `dvc.rd.imported`."""
DECIMALS = {"psnr": 2, "initial": 2, "refined": 2, "requests": 0, "decode": 3, "kbits": 3}


@dataclass(frozen=True)
class PointResult:
    """A measured point: its file, and the numbers that reports take from it, whatever it has or lacks."""

    name: str  # of its file
    data: dict[str, Any]  # contents of the file, of which the required part has been checked

    @property
    def rate_kbps(self) -> float:
        """Rate of the punctured stream in kbit/s."""
        return float(self.data["totals"]["rate_kbps"])

    @property
    def psnr_y_db(self) -> float:
        """Mean of the PSNRs of the frames in dB."""
        return float(self.data["totals"]["psnr_y_db"])

    @property
    def psnr_yuv_db(self) -> float | None:
        """Mean of the PSNRs of the frames in colour, (6 Y + Cb + Cr) / 8; None without chroma."""
        return self.total("psnr_yuv_db")

    def total(self, name: str) -> float | None:
        """Return a number of the totals."""
        return number(self.data["totals"].get(name))

    @property
    def label(self) -> str:
        """Name of the point on its curve, such as ``Q4, key QP 34`` or ``QP 28``."""
        key = self.data["key"]
        if self.data["codec"] == IMPORTED:
            return self.level
        if not self.has_level:
            return "lossless" if key.get("lossless") else f"QP {key['qp']}"
        return f"{self.level}, {'lossless keys' if key.get('lossless') else 'key QP ' + str(key['qp'])}"

    @property
    def has_level(self) -> bool:
        """Whether a preset or a quality was given, beside the QP of key frames."""
        options = self.data["options"]
        return options.get("wz_q") is not None or options.get("qp") is not None

    @property
    def level(self) -> str:
        """Preset such as ``Q4``, or quality such as ``QP 28``; an intra codec's is that of its key frames."""
        options = self.data["options"]
        if self.data["codec"] == IMPORTED:
            return str(options["options"]["point"])
        if options.get("wz_q") is not None:
            return f"Q{options['wz_q']}"
        qp = options.get("qp")
        return f"QP {self.data['key']['qp'] if qp is None else qp}"

    @property
    def is_proven(self) -> bool:
        """Whether a fresh process decoded the punctured stream to the same frames."""
        proof = self.data.get("proof")
        return isinstance(proof, dict) and proof.get("fresh_decode_equal") is True

    @property
    def frame_rows(self) -> list[dict[str, Any]]:
        """Frames as the result has them; empty if it has none."""
        rows = self.data.get("per_frame")
        return [row for row in rows if isinstance(row, dict)] if isinstance(rows, list) else []

    def num_frames(self, *types: str) -> int:
        """Count frames."""
        return sum(row.get("type") in types for row in self.frame_rows)

    @property
    def encoding_times_s(self) -> list[float] | None:
        """Processor times of encoding that belong to frames, in seconds: the loading of code is left out."""
        times = self.data["times"]
        if "coding_cpu_s" in times:
            names = ["coding_cpu_s"]
        else:
            names = ["key_encode_cpu_s"]
            names += ["wz_encode_cpu_s"] if self.num_frames("wz") else []
            codec = self.data["codec"]
            tracks = codec in VARIANTS and VARIANTS[codec].tracks.kind != "none"
            names += ["tracking_cpu_s"] if tracks else []
        parts = [number(times.get(name)) for name in names]
        known = [part for part in parts if part is not None]
        return known if len(known) == len(parts) else None

    @property
    def coding_ms(self) -> float | None:
        """Processor time of encoding a frame of any type, loading of code left out; None if not measured."""
        times_s = self.encoding_times_s
        return None if times_s is None else 1000 * sum(times_s) / max(1, self.data["totals"]["frames"])

    def type_ms(self, kind: str) -> float | None:
        """Return the processor time of encoding a frame of one type."""
        total, count = number(self.data["times"].get(f"{kind}_encode_cpu_s")), self.num_frames(kind)
        return None if total is None or not count else 1000 * total / count

    @property
    def frame_columns(self) -> dict[str, Any]:
        """What charts show of the frames."""
        rows = self.frame_rows
        columns: dict[str, list[float | None]] = {
            "psnr": [number(row.get("psnr_y_db")) for row in rows],
            "initial": [number(row.get("si_psnr_y_db")) for row in rows],
            "refined": [number(row.get("refined_si_psnr_y_db")) for row in rows],
            "kbits": [_kbits(row.get("bits")) for row in rows],
            "requests": [number(row.get("num_requests")) for row in rows],
            "decode": [number(row.get("decode_s")) for row in rows],
        }
        kept: dict[str, Any] = {
            name: [None if value is None else round(value, DECIMALS[name]) for value in values]
            for name, values in columns.items()
            if any(value is not None for value in values)
        }
        first = number(rows[0].get("index")) if rows else None
        kept["first"] = int(self.data["options"]["start"] + (first or 0))
        kept["types"] = "".join(LETTERS.get(str(row.get("type")), "?") for row in rows)
        return kept

    @property
    def bit_shares(self) -> dict[str, float]:
        """What the bits are for: per cent of all, by kind; kinds without a bit are left out."""
        bits = {str(name): number(value) or 0.0 for name, value in self.data["totals"]["bits"].items()}
        total = sum(bits.values())
        if total <= 0:
            return {}
        order = [*SHARES, *sorted(set(bits) - set(SHARES))]
        return {name: 100 * bits[name] / total for name in order if bits.get(name, 0.0) > 0}


def number(value: object) -> float | None:
    """Return a number, or nothing for what is none."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        return None
    return float(value)


def mean(values: Sequence[float | None]) -> float | None:
    """Return the mean of the numbers there are."""
    there = [value for value in values if value is not None]
    return sum(there) / len(there) if there else None


def _kbits(bits: object) -> float | None:
    if isinstance(bits, dict):
        parts = [number(value) for value in bits.values()]
        return sum(part for part in parts if part is not None) / 1000
    whole = number(bits)
    return None if whole is None else whole / 1000
