"""The first picture of the README: key frame, depth, prediction and decoded frame of the default codec."""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.pictures.drawing import Picture
from benchmarks.results.harness import run_module
from dvc.geometry.depth_maps import estimate_depths
from dvc.video import Frame, open_video
from dvc.video.pixels import picture_from_frame
from dvc.web.drawing import colour_disparity, in_rows, with_title
from sfm.cameras.rebasing import rigid_order
from sfm.pipeline import reconstruct

PICTURE = Path("docs/pictures/first.jpg")
SCENE = ("street", "--frames", "17")
QP = "30"
MAX_BYTES = 150_000


def main(argv: Sequence[str] | None = None) -> int:
    """Code the rendered street in processes, and draw a frame between two that are decoded before it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/first"), help="folder for the streams")
    parser.add_argument("--picture", type=Path, default=PICTURE, help="picture to write")
    arguments = parser.parse_args(argv)
    folder: Path = arguments.out
    folder.mkdir(parents=True, exist_ok=True)
    files = [str(folder / name) for name in ("street.mkv", "street.dvc", "decoded.mkv", "predicted.mkv")]
    video, stream, decoded, predicted = files
    report = folder / "report.json"
    run_module("sequences", "render", *SCENE, "--out", video)
    run_module("encoder", video, stream, "--qp", QP, "--quiet")
    outputs = ["--side-information-video", predicted, "--json", str(report), "--reference", video, "--quiet"]
    run_module("decoder", stream, decoded, *outputs)
    drawn = _draw(decoded, predicted, json.loads(report.read_text())["per_frame"])
    _write(arguments.picture, drawn)
    print(arguments.picture)
    return 0


def _draw(decoded: str, predicted: str, frames: list[dict[str, Any]]) -> Picture:
    """Draw the four pictures side by side."""
    keys = [frame["index"] for frame in frames if frame["type"] == "key"]
    first, second = keys[0], (keys[0] + keys[1]) // 2
    shown = (first + second) // 2
    before, after = _frame(decoded, first), _frame(decoded, second)
    predicted_db, decoded_db = frames[shown]["si_psnr_y_db"], frames[shown]["psnr_y_db"]
    seen = _depth(before.luma, after.luma)
    return in_rows(
        [
            with_title(_colours(before), f"frame {first}: key frame, as decoded"),
            with_title(seen, f"its depth, from frames {first} and {second} (bright: near)"),
            with_title(
                _colours(_frame(predicted, shown)), f"frame {shown}: predicted (luma), {predicted_db:.1f} dB"
            ),
            with_title(_colours(_frame(decoded, shown)), f"frame {shown}: decoded, {decoded_db:.1f} dB"),
        ],
        columns=4,
    )


def _frame(path: str, index: int) -> Frame:
    with open_video(path, start=index, num_frames=1) as reader:
        return next(iter(reader))


def _colours(frame: Frame) -> Picture:
    picture: av.VideoFrame = picture_from_frame(frame.with_chroma(), "yuv420p")
    return np.asarray(picture.to_ndarray(format="bgr24"), np.uint8)


def _depth(first: NDArray[np.uint8], second: NDArray[np.uint8]) -> Picture:
    """Draw inverse depth as the decoder finds it between two decoded frames."""
    model = reconstruct(first, second).model
    if model is None:
        raise SystemExit("no model of the scene between the frames")
    ordered = rigid_order(model)
    pair = (model if ordered is None else ordered.model).view_pair
    inverse = estimate_depths(pair, first, second)[0].depth.inverse_depth
    lowest, highest = np.percentile(inverse, (1, 99))
    return colour_disparity(inverse, float(lowest), float(highest))


def _write(path: Path, picture: Picture) -> None:
    """Write a JPEG of at most `MAX_BYTES`."""
    for quality in range(92, 40, -4):
        _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])
        if data.size <= MAX_BYTES:
            break
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data.tobytes())


if __name__ == "__main__":
    sys.exit(main())
