"""Report of a decoding run: bits, quality and time of every frame, and totals; see `docs/rd.md`."""

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from statistics import fmean, median
from typing import Any

import numpy as np
from numpy.typing import NDArray

import dvc
from decoder.group_tasks import DecodedFrame, DecodedGroup
from dvc.arrays import Bytes, Floats
from dvc.config import CodecConfig
from dvc.errors import ConfigError, VideoError
from dvc.metrics import PSNR_CAP_DB, psnr_db, psnr_of_mean_error_db, psnr_yuv_db
from dvc.stream import gop_bits
from dvc.video import Frame, VideoReader

BIT_CLASSES = ("key", "tracks", "parity", "crc", "header")
CHROMA = ("psnr_cb_db", "psnr_cr_db")
"""PSNRs of chroma, if stream and reference have it."""
PLANE_CLASSES = {"dc": range(1), "ac_1_2": range(1, 3), "ac_3_5": range(3, 6), "ac_6_15": range(6, 16)}
"""Groups of bands that share a line of the report, in zigzag order."""


@dataclass(frozen=True, eq=False)
class DecodedPicture:
    """A decoded frame, and the data that it was made from.

    Attributes
    ----------
    time_s : Fraction
        When it is shown, in seconds.
    frame : Frame
        The frame.
    predicted : ndarray of shape (H, W), uint8, or None
        Luma as it was predicted before anything of the frame was decoded; None for a key frame.
    inverse_depth : ndarray of shape (H, W), float16, or None
        Depth that predicted it, in the unit of a model of its group; None without a dense one.
    camera : ndarray of shape (3, 4), float64, or None
        Camera of the frame, in normalised coordinates and the basis of its group's model.
    report : dict
        Row of the frame in ``dvc-decode --json``: ``index``, ``type``, ``bits`` by kind, and more.
    """

    time_s: Fraction
    frame: Frame
    predicted: Bytes | None
    inverse_depth: NDArray[np.float16] | None
    camera: Floats | None
    report: dict[str, Any]


class DecodeReport:
    """Reports frames, and collects the content of ``--json`` if it is to be kept."""

    def __init__(
        self,
        config: CodecConfig,
        reference: VideoReader | None,
        selected: range | None = None,
        kept: bool = True,
    ) -> None:
        size = config.video.width, config.video.height
        if reference is not None and (reference.info.width, reference.info.height) != size:
            raise ConfigError(
                f"the reference has frames of {reference.info.width}x{reference.info.height}, the stream of"
                f" {size[0]}x{size[1]}"
            )
        self._config, self._selected, self._kept = config, selected, kept
        self._reference: Iterator[Frame] | None = None if reference is None else iter(reference)
        self._next_original = 0 if selected is None else selected.start
        self._frames: list[dict[str, Any]] = []
        self._times_s: list[Fraction] = []  # when these are shown
        self._delays_s: list[float] = []  # delays of frames of a live run
        self._num_messages = 0

    def add(self, group: DecodedGroup) -> list[DecodedPicture]:
        """Add a decoded group of pictures; return its selected frames, with their rows."""
        pictures = list(self._pictures(group))
        if self._kept:
            self._frames += [picture.report for picture in pictures]
            self._times_s += [picture.time_s for picture in pictures]
            self._num_messages += group.num_messages
            if group.delay_s is not None:
                self._delays_s += len(group.frames) * [group.delay_s]
        return pictures

    def _pictures(self, group: DecodedGroup) -> Iterator[DecodedPicture]:
        costs, times_s = gop_bits(group.record), group.times_s(self._config.video)
        indices = range(group.first_index, group.first_index + len(times_s))
        if self._selected is not None:
            indices = range(max(indices.start, self._selected.start), min(indices.stop, self._selected.stop))
        for index in indices:
            number, original = index - group.first_index, self._original(index)
            if number == len(group.wyner_ziv):
                bits = _bits(key=costs.key, tracks=costs.tracks, header=costs.header)
                row: dict[str, Any] = {"index": index, "type": "key", "bits": bits}
                row |= _psnrs(original, group.key)
                yield DecodedPicture(times_s[number], group.key, None, None, None, row)
            else:
                frame = group.wyner_ziv[number]
                predicted, depth = frame.side_information, frame.inverse_depth
                header = frame.header_bits + costs.wyner_ziv_header[number]
                luma = None if original is None else original.luma
                row = {
                    "index": frame.index,
                    "type": "wz",
                    "bits": _bits(parity=frame.parity_bits, crc=frame.crc_bits, header=header),
                    **_psnrs(original, frame.frame),
                    "si_psnr_y_db": _psnr(luma, predicted),
                    "refined_si_psnr_y_db": _psnr(luma, frame.refined_side_information),
                    "num_requests": frame.num_requests,
                    "num_failed_planes": frame.num_failed_planes,
                    "num_skipped_planes": frame.num_skipped_planes,
                    "plane_bits": _by_class(frame),
                    "side_information": frame.method,
                    "side_information_reason": frame.reason,
                    "decode_s": round(frame.decode_s, 6),
                }
                yield DecodedPicture(times_s[number], frame.frame, predicted, depth, frame.camera, row)

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
        if self._selected is None:
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
        psnrs_db = _values(frames, "psnr_y_db")
        plane_bits: dict[str, dict[str, float | None]] = {}
        for name in (*PLANE_CLASSES, "frame_checks", "all"):
            parts = [part for frame in wyner_ziv for part in frame["plane_bits"].items()]
            chosen = [cost for part, cost in parts if name in (part, "all")]
            bits, ideal = (sum(cost[entry] for cost in chosen) for entry in ("bits", "ideal_bits"))
            ratio = round(bits / ideal, 4) if ideal else None
            plane_bits[name] = {"bits": bits, "ideal_bits": round(ideal, 3), "ratio": ratio}
        live, colour = dict[str, Any](), dict[str, float]()
        if all(name in frame for frame in frames for name in CHROMA):
            colour = {name: fmean(_values(frames, name)) for name in CHROMA}
            colour["psnr_yuv_db"] = psnr_yuv_db(fmean(psnrs_db), *colour.values())
        if self._delays_s:
            live["num_messages"] = self._num_messages
            live["delay_s"] = {
                "median": round(median(self._delays_s), 6),
                "worst": round(max(self._delays_s), 6),
            }
        return {
            "frames": len(frames),
            "duration_s": duration_s,
            "stream_bytes": stream_bytes,
            "rate_kbps": 8 * stream_bytes / duration_s / 1000,
            "bits": {name: sum(frame["bits"][name] for frame in frames) for name in BIT_CLASSES},
            "psnr_y_db": _mean(frames, "psnr_y_db"),
            "mse_psnr_y_db": psnr_of_mean_error_db(psnrs_db) if psnrs_db else None,
            "worst_psnr_y_db": min(psnrs_db, default=None),
            "key_psnr_y_db": _mean([frame for frame in frames if frame["type"] == "key"], "psnr_y_db"),
            "wz_psnr_y_db": _mean(wyner_ziv, "psnr_y_db"),
            **colour,
            "si_psnr_y_db": _mean(wyner_ziv, "si_psnr_y_db"),
            "refined_si_psnr_y_db": _mean(wyner_ziv, "refined_si_psnr_y_db"),
            "num_requests": sum(frame["num_requests"] for frame in wyner_ziv),
            **live,
            "num_failed_planes": sum(frame["num_failed_planes"] for frame in wyner_ziv),
            "num_skipped_planes": sum(frame["num_skipped_planes"] for frame in wyner_ziv),
            "plane_bits": plane_bits,
            "decode_s": round(sum(frame["decode_s"] for frame in wyner_ziv), 6),
            "version": dvc.__version__,
            "config": self._config.to_dict(),
            "per_frame": frames,
        }


def _bits(**given: int) -> dict[str, int]:
    return {name: given.get(name, 0) for name in BIT_CLASSES}


def _psnr(original: Bytes | None, decoded: Bytes) -> float | None:
    return None if original is None else min(psnr_db(original, decoded), PSNR_CAP_DB)


def _psnrs(original: Frame | None, decoded: Frame) -> dict[str, float | None]:
    """Return the PSNR of luma, and those of chroma if both frames have it."""
    if original is None:
        return {"psnr_y_db": None}
    pairs = zip(CHROMA, original.chroma or (), decoded.chroma or (), strict=False)
    chroma_db = {name: _psnr(*planes) for name, *planes in pairs}
    return {"psnr_y_db": _psnr(original.luma, decoded.luma), **chroma_db}


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
