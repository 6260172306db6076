"""Pictures of a point: one frame as it was, as it was predicted, and as it was decoded, and a key frame."""

from pathlib import Path
from typing import Any

import numpy as np

from dvc.errors import VideoError
from dvc.files import atomic_output
from dvc.rd.points import Task
from dvc.video import open_video
from dvc.video.frames import Plane

PICTURES_FOLDER = "pictures"
MAX_PICTURE_SIDE_PX = 8192
MAX_FILE_BYTES = 2**27


def picture_index(frames: int) -> int:
    """Return the frame that pictures are made of: an odd one in the middle, which is rarely a key frame."""
    return min(frames // 2 | 1, frames - 1)


def save_pictures(
    task: Task, folder: Path, decoded: Path, predicted: Path | None, per_frame: list[dict[str, Any]]
) -> dict[str, Any]:
    """Write the pictures of a point, 8-bit grey PNG; the original once for all points that have it."""
    index = picture_index(len(per_frame))
    frame = task.point.start + index
    key_index = _key_before(per_frame, index)
    names: dict[str, str | None] = {
        "original": f"{PICTURES_FOLDER}/{task.source.name}-{task.source.digest[:8]}-{frame}.png",
        "decoded": f"{PICTURES_FOLDER}/{task.name}-decoded.png",
        "predicted": f"{PICTURES_FOLDER}/{task.name}-predicted.png",
        "key": f"{PICTURES_FOLDER}/{task.name}-key.png",
    }
    (folder / PICTURES_FOLDER).mkdir(exist_ok=True)
    original = folder / str(names["original"])
    if not original.is_file():  # it is that of other points, too, which may come to it at the same time
        own = original.with_name(f"{task.name}-original.png")
        _write(own, _luma(task.source.path, frame))
        own.replace(original)
    _write(folder / str(names["decoded"]), _luma(decoded, index))
    if predicted is not None and key_index is not None:
        _write(folder / str(names["predicted"]), _luma(predicted, index))
        _write(folder / str(names["key"]), _luma(decoded, key_index))
    else:
        names["predicted"] = names["key"] = key_index = None
    return {"index": index, "key_index": key_index, **names}


def _key_before(per_frame: list[dict[str, Any]], index: int) -> int | None:
    """Return the key frame before a Wyner-Ziv frame; None for other frames."""
    if per_frame[index]["type"] != "wz":
        return None
    return next((i for i in range(index - 1, -1, -1) if per_frame[i]["type"] == "key"), None)


def read_picture(path: Path) -> Plane | None:
    """Read a picture of a point."""
    import cv2

    try:
        with path.open("rb") as file:
            head = file.read(24)
            width, height = (int.from_bytes(head[i : i + 4], "big") for i in (16, 20))
            if not head.startswith(b"\x89PNG") or not 0 < max(width, height) <= MAX_PICTURE_SIDE_PX:
                return None
            coded = head + file.read(MAX_FILE_BYTES)
        plane: Any = cv2.imdecode(np.frombuffer(coded, np.uint8), cv2.IMREAD_GRAYSCALE)
    except (OSError, cv2.error):
        return None
    return None if plane is None else np.asarray(plane, dtype=np.uint8)


def _luma(video: Path, index: int) -> Plane:
    with open_video(video, start=index, num_frames=1) as reader:
        for frame in reader:
            return frame.luma
    raise VideoError(f"{video.name}: has no frame {index}")


def _write(path: Path, luma: Plane) -> None:
    import cv2

    done, data = cv2.imencode(".png", luma)
    if not done:
        raise VideoError(f"{path.name}: cannot be coded as PNG")
    with atomic_output(path) as temporary:
        temporary.write_bytes(data.tobytes())
