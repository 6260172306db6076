"""Contents of the page: figures of the latest frames of a decoding run, and pictures of fewer frames."""

from collections import Counter, OrderedDict, deque
from collections.abc import Callable
from dataclasses import asdict, dataclass
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decoder.report import DecodedPicture
from dvc.config import CodecConfig
from dvc.video.pixels import rgb_from_frame
from dvc.web.drawing import colour_disparity

NUM_ROWS = 1000
"""Number of latest frames with figures."""
MAX_PICTURE_PX = 2**24
"""Largest number of pixels in pictures of the latest frames; one frame is always kept."""
DIFFERENCE_GAIN = 4
"""Amplification of differences from the prediction."""
KINDS = ("decoded", "predicted", "difference", "depth")
REPORTED = ("index", "type", "bits", "psnr_y_db", "side_information", "side_information_reason", "decode_s")
"""Fields of a frame's report on the page."""
DEPTH_SHARE = 0.02
"""Share of the nearest and of the farthest pixels with the colours of the ends."""
QUALITY = 88
Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class Facts:
    """Facts about a sequence before it is decoded."""

    name: str  # file of the stream, or address of its encoder
    facts: str
    frame_rate: float
    total: int | None  # number of frames, if known


def facts_of(config: CodecConfig, name: str, num_frames: int | None) -> Facts:
    """Return the facts of a configuration."""
    video, key = config.video, config.key
    facts = [f"{video.width}x{video.height} at {float(video.frame_rate):g} Hz", f"codec {config.codec}"]
    facts += [f"side information {config.side_information.method}", "luma" if video.luma_only else "colour"]
    facts += ["lossless key frames" if key.lossless else f"key frames of QP {key.qp}"]
    return Facts(name, ", ".join(facts), float(video.frame_rate), num_frames)


class DecodingView:
    """Figures and pictures for a page; one thread adds, other threads read."""

    def __init__(self, facts: Facts, requests_in_flight: Callable[[], int] | None = None) -> None:
        self._facts, self._requests = asdict(facts), requests_in_flight
        self._rows: deque[dict[str, Any]] = deque(maxlen=NUM_ROWS)
        self._pictures: OrderedDict[int, DecodedPicture] = OrderedDict()
        self._num_frames, self._bits = 0, Counter[str]()
        self._finished = False
        self._lock = Lock()

    def add(self, picture: DecodedPicture, group: int) -> None:
        """Add a decoded picture of a group of pictures."""
        row = {name: picture.report[name] for name in REPORTED if name in picture.report}
        centre = None if picture.camera is None else _centre(picture.camera)
        pixels = picture.frame.width * picture.frame.height
        with self._lock:
            self._rows.append(
                {**row, "group": group, "centre": centre, "has_depth": picture.inverse_depth is not None}
            )
            self._pictures[picture.report["index"]] = picture
            while len(self._pictures) > max(MAX_PICTURE_PX // pixels, 1):
                self._pictures.popitem(last=False)
            self._num_frames += 1
            self._bits.update(picture.report["bits"])

    def finish(self) -> None:
        """Mark the run as finished."""
        self._finished = True

    def state(self, after: int) -> dict[str, Any]:
        """Return the figures of the run, and rows of the frames after one."""
        with self._lock:
            return {
                **self._facts,
                "num_frames": self._num_frames,
                "bits": dict(self._bits),
                "finished": self._finished,
                "requests_in_flight": None if self._requests is None else self._requests(),
                "first_picture": next(iter(self._pictures), None),
                "rows": [row for row in self._rows if row["index"] > after],
            }

    def jpeg(self, index: int, kind: str) -> bytes | None:
        """Return a picture of a frame; None if it is not available."""
        import cv2

        with self._lock:
            picture = self._pictures.get(index)
        drawn = None if picture is None else _drawn(picture, kind)
        if drawn is None:
            return None
        return bytes(cv2.imencode(".jpg", drawn, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1])


def _drawn(picture: DecodedPicture, kind: str) -> Picture | None:
    if kind == "decoded":
        return _bgr(picture)
    if kind == "depth":
        return None if picture.inverse_depth is None else _coloured(picture.inverse_depth)
    if picture.predicted is None:
        return None
    if kind == "predicted":
        return picture.predicted
    difference = picture.frame.luma.astype(np.int16) - picture.predicted
    return np.asarray(np.clip(128 + DIFFERENCE_GAIN * difference, 0, 255), np.uint8)


def _bgr(picture: DecodedPicture) -> Picture:
    frame = picture.frame
    return frame.luma if frame.chroma is None else rgb_from_frame(frame)[:, :, ::-1]


def _coloured(inverse_depth: NDArray[np.float16]) -> Picture:
    disparity = inverse_depth.astype(np.float64)
    known = disparity[np.isfinite(disparity)]
    ends = np.quantile(known, (DEPTH_SHARE, 1 - DEPTH_SHARE)) if known.size else (0.0, 1.0)
    return colour_disparity(disparity, float(ends[0]), float(ends[1]))


def _centre(camera: NDArray[np.float64]) -> list[float] | None:
    """Return the position of a camera; None if it is at infinity."""
    try:
        centre = -np.linalg.solve(camera[:, :3], camera[:, 3])
    except np.linalg.LinAlgError:
        return None
    return [float(value) for value in centre] if np.isfinite(centre).all() else None
