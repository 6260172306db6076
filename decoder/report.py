"""Report of a decoding run: bits, quality and time of every frame, and totals; see `docs/rd.md`."""

from collections.abc import Iterator
from fractions import Fraction
from statistics import fmean, median
from typing import Any

import numpy as np
from numpy.typing import NDArray

import dvc
from decoder.group_tasks import DecodedFrame, DecodedGroup
from dvc.config import CodecConfig
from dvc.errors import ConfigError, VideoError
from dvc.metrics import PSNR_CAP_DB, psnr_db, psnr_of_mean_error_db, psnr_yuv_db
from dvc.stream import gop_bits
from dvc.video import Frame, VideoReader

BIT_CLASSES = ("key", "tracks", "parity", "crc", "header")
CHROMA = ("psnr_cb_db", "psnr_cr_db")
"""PSNRs of chroma, where stream and reference have it."""
PLANE_CLASSES = {"dc": range(1), "ac_1_2": range(1, 3), "ac_3_5": range(3, 6), "ac_6_15": range(6, 16)}
"""Groups of bands that share a line of the report, in zigzag order."""


class DecodeReport:
    """Reports frames, and collects the content of ``--json`` unless nothing is to be kept."""

    def __init__(
        self,
        config: CodecConfig,
        reference: VideoReader | None,
        wanted: range | None = None,
        kept: bool = True,
    ) -> None:
        video = config.video
        if reference is not None and (reference.info.width, reference.info.height) != (
            video.width,
            video.height,
        ):
            size = f"{reference.info.width}x{reference.info.height}"
            raise ConfigError(
                f"the reference has frames of {size}, the stream of {video.width}x{video.height}"
            )
        self._config = config
        self._wanted = wanted
        self._kept = kept
        self._reference: Iterator[Frame] | None = None if reference is None else iter(reference)
        self._next_original = 0 if wanted is None else wanted.start
        self._frames: list[dict[str, Any]] = []
        self._times_s: list[Fraction] = []  # when these are shown
        self._delays_s: list[float] = []  # delays of frames of a live run
        self._num_messages = 0

    def add(self, group: DecodedGroup) -> list[dict[str, Any]]:
        """Add a decoded group of pictures; return the rows of its frames."""
        rows = self._rows(group)
        if self._kept:
            self._frames += rows
            times_s = enumerate(group.times_s(self._config.video), group.first_index)
            self._times_s += [time_s for index, time_s in times_s if self._is_wanted(index)]
            self._num_messages += group.num_messages
            if group.delay_s is not None:
                self._delays_s += len(group.frames) * [group.delay_s]
        return rows

    def _rows(self, group: DecodedGroup) -> list[dict[str, Any]]:
        rows: list[dict[str, Any]] = []
        costs = gop_bits(group.record)
        for frame, record_bits in zip(group.wyner_ziv, costs.wyner_ziv_header, strict=True):
            if not self._is_wanted(frame.index):
                continue
            row: dict[str, Any] = {"index": frame.index, "type": "wz"}
            row["bits"] = _bits(
                parity=frame.parity_bits,
                crc=frame.crc_bits,
                header=frame.header_bits + record_bits,
            )
            reference = self._original(frame.index)
            original = None if reference is None else reference.luma
            row["psnr_y_db"] = _psnr(original, frame.frame.luma)
            row |= _chroma_psnrs(reference, frame.frame)
            row["si_psnr_y_db"] = _psnr(original, frame.side_information)
            row["refined_si_psnr_y_db"] = _psnr(original, frame.refined_side_information)
            row["num_requests"] = frame.num_requests
            row["num_failed_planes"] = frame.num_failed_planes
            row["num_skipped_planes"] = frame.num_skipped_planes
            row["plane_bits"] = _by_class(frame)
            row["side_information"] = frame.method
            row["side_information_reason"] = frame.reason
            row["decode_s"] = round(frame.decode_s, 6)
            rows.append(row)
        last_index = group.first_index + len(group.wyner_ziv)
        if self._is_wanted(last_index):
            bits = _bits(key=costs.key, tracks=costs.tracks, header=costs.header)
            rows.append(self._key_row(last_index, group.key, bits))
        return rows

    def _key_row(self, index: int, key: Frame, bits: dict[str, int]) -> dict[str, Any]:
        reference = self._original(index)
        psnr = _psnr(None if reference is None else reference.luma, key.luma)
        row = {"index": index, "type": "key", "bits": bits, "psnr_y_db": psnr}
        return row | _chroma_psnrs(reference, key)

    def _is_wanted(self, index: int) -> bool:
        return self._wanted is None or index in self._wanted

    def _original(self, index: int) -> Frame | None:
        if self._reference is None:
            return None
        for original in self._reference:
            self._next_original += 1
            if self._next_original > index:
                return original
        raise VideoError(f"the reference ends before frame {index} of the stream")

    def to_dict(self, stream_bytes: int) -> dict[str, Any]:
        """Return the report as JSON-safe values."""
        frames = self._frames
        counted = sum(sum(frame["bits"].values()) for frame in frames)
        if self._wanted is None:
            frames[0]["bits"]["header"] += 8 * stream_bytes - counted  # configuration and end of the stream
        else:
            stream_bytes = counted // 8
        video = self._config.video
        interval_s = Fraction(video.frame_rate_den, video.frame_rate_num)
        first_s, last_s = self._times_s[0], self._times_s[-1]
        duration_s = float(last_s - first_s + interval_s)
        shown_s = [time_s - first_s for time_s in self._times_s]
        if shown_s != [number * interval_s for number in range(len(frames))]:
            for frame, time_s in zip(frames, shown_s, strict=True):
                frame["time_s"] = round(float(time_s), 6)
        wyner_ziv = [frame for frame in frames if frame["type"] == "wz"]
        return {
            "frames": len(frames),
            "duration_s": duration_s,
            "stream_bytes": stream_bytes,
            "rate_kbps": 8 * stream_bytes / duration_s / 1000,
            "bits": {name: sum(frame["bits"][name] for frame in frames) for name in BIT_CLASSES},
            "psnr_y_db": _mean(frames, "psnr_y_db"),
            "mse_psnr_y_db": _mse_psnr(frames),
            "worst_psnr_y_db": min(_values(frames, "psnr_y_db"), default=None),
            "key_psnr_y_db": _mean([frame for frame in frames if frame["type"] == "key"], "psnr_y_db"),
            "wz_psnr_y_db": _mean(wyner_ziv, "psnr_y_db"),
            **_mean_in_colour(frames),
            "si_psnr_y_db": _mean(wyner_ziv, "si_psnr_y_db"),
            "refined_si_psnr_y_db": _mean(wyner_ziv, "refined_si_psnr_y_db"),
            "num_requests": sum(frame["num_requests"] for frame in wyner_ziv),
            **self._live(),
            "num_failed_planes": sum(frame["num_failed_planes"] for frame in wyner_ziv),
            "num_skipped_planes": sum(frame["num_skipped_planes"] for frame in wyner_ziv),
            "plane_bits": _ratios([frame["plane_bits"] for frame in wyner_ziv]),
            "decode_s": round(sum(frame["decode_s"] for frame in wyner_ziv), 6),
            "version": dvc.__version__,
            "config": self._config.to_dict(),
            "per_frame": frames,
        }

    def _live(self) -> dict[str, Any]:
        """Return the figures of live runs only."""
        if not self._delays_s:
            return {}
        delay_s = {"median": round(median(self._delays_s), 6), "worst": round(max(self._delays_s), 6)}
        return {"num_messages": self._num_messages, "delay_s": delay_s}


def _bits(**given: int) -> dict[str, int]:
    return {name: given.get(name, 0) for name in BIT_CLASSES}


def _psnr(original: NDArray[np.uint8] | None, decoded: NDArray[np.uint8]) -> float | None:
    return None if original is None else min(psnr_db(original, decoded), PSNR_CAP_DB)


def _chroma_psnrs(original: Frame | None, decoded: Frame) -> dict[str, float | None]:
    """Return the PSNRs of both planes of chroma, if the frame has chroma."""
    if original is None or original.chroma is None or decoded.chroma is None:
        return {}
    pairs = zip(original.chroma, decoded.chroma, strict=True)
    return {name: _psnr(*pair) for name, pair in zip(CHROMA, pairs, strict=True)}


def _mse_psnr(frames: list[dict[str, Any]]) -> float | None:
    """Return the PSNR of the mean squared error over frames."""
    psnrs_db = _values(frames, "psnr_y_db")
    return psnr_of_mean_error_db(psnrs_db) if psnrs_db else None


def _mean_in_colour(frames: list[dict[str, Any]]) -> dict[str, float]:
    """Return the mean PSNRs of chroma and of all planes, if the reference has chroma."""
    if not all(name in frame for frame in frames for name in CHROMA):
        return {}
    cb_db, cr_db = (fmean(_values(frames, name)) for name in CHROMA)
    yuv_db = psnr_yuv_db(fmean(_values(frames, "psnr_y_db")), cb_db, cr_db)
    return {**dict(zip(CHROMA, (cb_db, cr_db), strict=True)), "psnr_yuv_db": yuv_db}


def _mean(frames: list[dict[str, Any]], name: str) -> float | None:
    values = _values(frames, name)
    return fmean(values) if values else None


def _values(frames: list[dict[str, Any]], name: str) -> list[float]:
    return [frame[name] for frame in frames if frame[name] is not None]


def _by_class(frame: DecodedFrame) -> dict[str, dict[str, float]]:
    """Add up received and ideal bits of planes by class, and the bits of checks of the whole frame."""
    classes: dict[str, dict[str, float]] = {}
    for name, bands in PLANE_CLASSES.items():
        costs = [cost for cost in frame.band_costs if cost.band in bands]
        ideal = round(sum(cost.ideal_bits for cost in costs), 3)
        classes[name] = {"bits": sum(cost.bits for cost in costs), "ideal_bits": ideal}
    shared = frame.parity_bits + frame.crc_bits - sum(cost.bits for cost in frame.band_costs)
    classes["frame_checks"] = {"bits": shared, "ideal_bits": 0.0}
    return classes


def _ratios(frames: list[dict[str, dict[str, float]]]) -> dict[str, dict[str, float | None]]:
    """Add up received and ideal bits over frames, and divide the first by the second."""
    totals: dict[str, dict[str, float | None]] = {}
    for name in (*PLANE_CLASSES, "frame_checks", "all"):
        chosen = [cost for frame in frames for own, cost in frame.items() if name in (own, "all")]
        bits, ideal = (sum(cost[entry] for cost in chosen) for entry in ("bits", "ideal_bits"))
        ratio = round(bits / ideal, 4) if ideal else None
        totals[name] = {"bits": bits, "ideal_bits": round(ideal, 3), "ratio": ratio}
    return totals
