"""Panels, stages of a decoded frame, and JPEG files of bounded size."""

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.geometry.depth_maps import estimate_depths
from dvc.video import Frame, open_video
from dvc.video.pixels import picture_from_frame
from dvc.web.drawing import colour_disparity, in_rows, with_title
from sfm.cameras.rebasing import rigid_order
from sfm.pipeline import reconstruct

PANEL_WIDTH = 528
QUALITY = 80
_BANNER = 30
Picture = NDArray[np.uint8]
Floats = NDArray[np.float64]


@contextmanager
def scratch_files(*names: str) -> Iterator[list[Path]]:
    """Return paths in a temporary folder."""
    with tempfile.TemporaryDirectory() as folder:
        yield [Path(folder) / name for name in names]


def panel(plane: NDArray[np.uint8], title: str) -> Picture:
    """Scale a picture to the width of a panel and put a title above it."""
    colour = plane if plane.ndim == 3 else np.repeat(plane[:, :, None], 3, axis=2)
    height = round(PANEL_WIDTH * colour.shape[0] / colour.shape[1])
    scaled = cv2.resize(colour, (PANEL_WIDTH, height), interpolation=cv2.INTER_CUBIC)
    banner = np.full((_BANNER, PANEL_WIDTH, 3), 255, dtype=np.uint8)
    cv2.putText(banner, title, (4, 21), cv2.FONT_HERSHEY_SIMPLEX, 0.52, (30, 30, 30), 1, cv2.LINE_AA)
    framed: Picture = np.vstack([banner, np.asarray(scaled, np.uint8)])
    return framed


def correlation_noise(predicted: Floats, original: NDArray[np.uint8]) -> Picture:
    """Show the difference of side information and frame, grey if there is none."""
    return np.clip(128.0 + 2.0 * (predicted - original), 0, 255).astype(np.uint8)


def write_picture(path: Path, picture: Picture, max_bytes: int | None = None) -> Path:
    """Write a picture as JPEG, at a quality that fits a number of bytes; make its folder if needed."""
    for quality in [QUALITY] if max_bytes is None else range(92, 40, -4):
        _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])
        if max_bytes is None or data.size <= max_bytes:
            break
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data.tobytes())
    return path


def decoding_stages(decoded: Path, predicted: Path, frames: Sequence[dict[str, Any]]) -> Picture:
    """Draw a key frame, its depth, and the prediction of a frame that is decoded by it, side by side."""
    keys = [frame["index"] for frame in frames if frame["type"] == "key"]
    first, second = keys[0], (keys[0] + [*keys, len(frames) - 1][1]) // 2
    shown = (first + second) // 2
    before, after = _frame(decoded, first), _frame(decoded, second)
    predicted_db, decoded_db = frames[shown].get("si_psnr_y_db", np.nan), frames[shown]["psnr_y_db"]
    depth = _depth(before.luma, after.luma)
    depth_title = f"its depth, from frames {first} and {second} (bright: near)"
    if depth is None:
        depth, depth_title = np.zeros_like(_colours(before)), "no depth: no model that can be trusted"
    return in_rows(
        [
            with_title(_colours(before), f"frame {first}: key frame, as decoded"),
            with_title(depth, depth_title),
            with_title(
                _colours(_frame(predicted, shown)), f"frame {shown}: predicted (luma), {predicted_db:.1f} dB"
            ),
            with_title(_colours(_frame(decoded, shown)), f"frame {shown}: decoded, {decoded_db:.1f} dB"),
        ],
        columns=4,
    )


def _frame(path: Path, index: int) -> Frame:
    with open_video(path, start=index, num_frames=1) as reader:
        return next(iter(reader))


def _colours(frame: Frame) -> Picture:
    picture = picture_from_frame(frame.with_chroma(), "yuv420p")
    return np.asarray(picture.to_ndarray(format="bgr24"), np.uint8)


def _depth(first: NDArray[np.uint8], second: NDArray[np.uint8]) -> Picture | None:
    """Draw inverse depth as the decoder estimates it between two decoded frames, if it can."""
    model = reconstruct(first, second).model
    if model is None:
        return None
    ordered = rigid_order(model)
    pair = (model if ordered is None else ordered.model).view_pair
    inverse = estimate_depths(pair, first, second)[0].depth.inverse_depth
    lowest, highest = np.percentile(inverse, (1, 99))
    return colour_disparity(inverse, float(lowest), float(highest))
