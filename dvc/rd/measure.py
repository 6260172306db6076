"""One point: encode in one process, decode in a second, and prove the rate in a third."""

import filecmp
import json
import shlex
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from dvc.environment import python_module
from dvc.errors import DvcError, VideoError
from dvc.files import atomic_output
from dvc.rd.anchors import ANCHOR_CODECS
from dvc.rd.child_processes import ProcessGroup
from dvc.rd.specification import SCHEMA, Task
from dvc.versions import library_versions
from dvc.video import open_video
from dvc.video.frames import Plane

PICTURES_FOLDER = "pictures"
MAX_PICTURE_SIDE_PX = 8192
MAX_PICTURE_BYTES = 2**27
_STREAM, _PUNCTURED = "stream.dvc", "punctured.dvc"
_VIDEO, _AGAIN, _PREDICTED = "decoded.y4m", "again.y4m", "predicted.y4m"
_ENCODER_JSON, _DECODER_JSON = "encoder.json", "decoder.json"


def measure(task: Task, folder: Path, processes: ProcessGroup) -> dict[str, Any]:
    """Measure one point in a scratch folder; its pictures are written next to that folder."""
    is_anchor = task.point.codec in ANCHOR_CODECS
    commands_of, details_of = (
        (_anchor_commands, _anchor_details) if is_anchor else (_commands, _codec_details)
    )
    commands = commands_of(task, str(task.source.path.absolute()), f"{folder}/")
    encoding, decoding, *_ = (processes.run(_process(command)) for command in commands)
    texts = [(folder / name).read_text(encoding="utf-8") for name in (_ENCODER_JSON, _DECODER_JSON)]
    details = details_of(task, folder, *map(json.loads, texts))
    times = {
        "encode_cpu_s": round(encoding.cpu_s, 4),
        "encode_wall_s": round(encoding.wall_s, 4),
        "decode_cpu_s": round(decoding.cpu_s, 4),
        "decode_wall_s": round(decoding.wall_s, 4),
        **{name: round(value, 6) for name, value in details.pop("times").items()},
    }
    return {
        **_provenance(task, *details.pop("video")),
        "commands": [
            shlex.join(["python", "-m", *words]) for words in commands_of(task, task.source.path.name)
        ],
        "times": times,
        **details,
        "pictures": _save_pictures(task, folder, details["per_frame"]),
    }


def _codec_details(
    task: Task, folder: Path, coded: dict[str, Any], decoded: dict[str, Any]
) -> dict[str, Any]:
    proof = _proof(task, folder, decoded["stream_bytes"])
    config, per_frame = decoded.pop("config"), decoded.pop("per_frame")
    del decoded["version"]
    video = config["video"]
    frames_per_s = video["frame_rate_num"] / video["frame_rate_den"]
    if "time_s" in per_frame[0]:  # all codecs are compared at the constant rate
        duration_s = len(per_frame) / frames_per_s
        rate_kbps = 8 * decoded["stream_bytes"] / duration_s / 1000
        decoded |= {"duration_s": duration_s, "rate_kbps": rate_kbps}
    return {
        "video": (video["width"], video["height"], frames_per_s),
        "key": {"qp": config["key"]["qp"], "lossless": config["key"]["lossless"]},
        "totals": decoded,
        "times": {
            "coding_cpu_s": coded["coding_cpu_s"],
            "key_encode_cpu_s": coded["key_cpu_s"],
            "wz_encode_cpu_s": coded["wyner_ziv_cpu_s"],
            "tracking_cpu_s": coded["tracking"]["cpu_s"],
            "encode_start_up_cpu_s": coded["start_up_cpu_s"],
        },
        "proof": proof,
        "config": config,
        "per_frame": per_frame,
    }


def _proof(task: Task, folder: Path, reported: int) -> dict[str, Any]:
    """Check that the rate is the size of a file, and that the file decodes to the reported frames."""
    no_feedback = task.point.no_feedback
    num_bytes = (folder / (_STREAM if no_feedback else _PUNCTURED)).stat().st_size
    if num_bytes != reported:
        kind = "no-feedback" if no_feedback else "punctured"
        raise DvcError(f"the {kind} stream has {num_bytes} bytes, the report says {reported}")
    if no_feedback:
        return {"file_bytes": num_bytes, "decoded_by": "a fresh process"}
    if not task.point.proof:
        return {"punctured_bytes": num_bytes, "fresh_decode_equal": None}
    if not filecmp.cmp(folder / _VIDEO, folder / _AGAIN, shallow=False):
        raise DvcError("a fresh process decodes the punctured stream to other frames")
    return {"punctured_bytes": num_bytes, "fresh_decode_equal": True}


def _anchor_details(
    task: Task, folder: Path, coded: dict[str, Any], decoded: dict[str, Any]
) -> dict[str, Any]:
    totals = decoded["totals"]
    num_bytes = (folder / _anchor_file(task)).stat().st_size
    if not num_bytes == coded["bytes"] == totals["stream_bytes"] or coded["frames"] != totals["frames"]:
        raise DvcError(
            f"the file has {num_bytes} bytes, the reports say {coded['bytes']} for {coded['frames']} frames "
            f"and {totals['stream_bytes']} for {totals['frames']}"
        )
    return {
        "video": (decoded["width"], decoded["height"], decoded["frames_per_s"]),
        "key": {"qp": coded["config"]["qp"], "lossless": False},
        "totals": totals,
        "times": {"coding_cpu_s": coded["coding_cpu_s"]},
        "proof": {"file_bytes": num_bytes, "decoded_by": "FFmpeg"},
        "config": coded["config"],
        "per_frame": decoded["per_frame"],
    }


def _commands(task: Task, original: str, folder: str = "") -> tuple[list[str], ...]:
    """Return the arguments of encoder, decoder and proving decoder, each after the name of its module."""
    stream, punctured, video = folder + _STREAM, folder + _PUNCTURED, folder + _VIDEO
    encode = ["encoder", original, stream, *task.point.encoder_options(), "--json", folder + _ENCODER_JSON]
    options = task.point.decoder_options()
    decode = ["decoder", stream, video, "--reference", original, "--reference-start", str(task.point.start)]
    decode += [*options, "--json", folder + _DECODER_JSON]
    if task.point.has_wyner_ziv:
        decode += ["--side-information-video", folder + _PREDICTED]
    if task.point.no_feedback:
        return encode, decode
    decode += ["--punctured", punctured]
    if not task.point.proof:
        return encode, decode
    return encode, decode, ["decoder", punctured, folder + _AGAIN, *options]


def _anchor_commands(task: Task, original: str, folder: str = "") -> tuple[list[str], list[str]]:
    """Return the arguments that write and measure an anchor's file, each after the name of its module."""
    point, file = task.point, folder + _anchor_file(task)
    planes = ["--luma-only"] if point.luma_only else []
    frames = [] if point.frames is None else ["--frames", str(point.frames)]
    encode = ["dvc.rd.anchors", "encode", original, file, "--codec", point.codec, "--qp", point.key_qp]
    encode += ["--start", str(point.start), "--json", folder + _ENCODER_JSON, *frames, *planes]
    decode = ["dvc.rd.anchors", "decode", file, "--reference", original]
    decode += ["--reference-start", str(point.start), "--video", folder + _VIDEO]
    return encode, [*decode, *planes, "--json", folder + _DECODER_JSON]


def _anchor_file(task: Task) -> str:
    return f"stream{ANCHOR_CODECS[task.point.codec].suffix}"


def _process(arguments: list[str]) -> list[str]:
    return [*python_module(*arguments), "--quiet"]


def _provenance(task: Task, width: int, height: int, frames_per_s: float) -> dict[str, Any]:
    """Return the entries of a result about itself, its input and its code."""
    return {
        "schema": SCHEMA,
        "identity": task.identity,
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "sequence": {
            "name": task.source.name,
            "digest": task.source.digest,
            "width": width,
            "height": height,
            "frames_per_s": frames_per_s,
        },
        "codec": task.point.codec,
        "options": task.point.to_dict(),
        "code": {"version": task.code.version, "commit": task.code.commit, "digest": task.code_digest},
        "libraries": library_versions(),
    }


def picture_index(frames: int) -> int:
    """Return the frame that is saved: an odd one in the middle, which is rarely a key frame."""
    return min(frames // 2 | 1, frames - 1)


def _save_pictures(task: Task, scratch: Path, per_frame: list[dict[str, Any]]) -> dict[str, Any]:
    """Write one frame of a point as grey PNG: original, decoded, predicted, and the key frame before it."""
    index, folder = picture_index(len(per_frame)), scratch.parent
    frame = task.point.start + index
    names: dict[str, str | None] = {
        "original": f"{PICTURES_FOLDER}/{task.source.name}-{task.source.digest[:8]}-{frame}.png",
        **{kind: f"{PICTURES_FOLDER}/{task.name}-{kind}.png" for kind in ("decoded", "predicted", "key")},
    }
    (folder / PICTURES_FOLDER).mkdir(exist_ok=True)
    original = folder / str(names["original"])
    if not original.is_file():  # several points share it, and may write it at the same time
        copy = original.with_name(f"{task.name}-original.png")
        _write_picture(copy, _luma(task.source.path, frame))
        copy.replace(original)
    _write_picture(folder / str(names["decoded"]), _luma(scratch / _VIDEO, index))
    key_index = None
    if per_frame[index]["type"] == "wz" and (scratch / _PREDICTED).exists():
        key_index = next((i for i in range(index - 1, -1, -1) if per_frame[i]["type"] == "key"), None)
    if key_index is None:
        names |= {"predicted": None, "key": None}
    else:
        _write_picture(folder / str(names["predicted"]), _luma(scratch / _PREDICTED, index))
        _write_picture(folder / str(names["key"]), _luma(scratch / _VIDEO, key_index))
    return {"index": index, "key_index": key_index, **names}


def read_picture(path: Path) -> Plane | None:
    """Read a picture of a point; return None if it is missing, damaged or too large."""
    import cv2

    try:
        with path.open("rb") as file:
            head = file.read(24)
            width, height = (int.from_bytes(head[i : i + 4], "big") for i in (16, 20))
            if not head.startswith(b"\x89PNG") or not 0 < max(width, height) <= MAX_PICTURE_SIDE_PX:
                return None
            coded = head + file.read(MAX_PICTURE_BYTES)
        plane: Any = cv2.imdecode(np.frombuffer(coded, np.uint8), cv2.IMREAD_GRAYSCALE)
    except (OSError, cv2.error):
        return None
    return None if plane is None else np.asarray(plane, dtype=np.uint8)


def _luma(video: Path, index: int) -> Plane:
    with open_video(video, start=index, num_frames=1) as reader:
        for frame in reader:
            return frame.luma
    raise VideoError(f"{video.name}: has no frame {index}")


def _write_picture(path: Path, luma: Plane) -> None:
    import cv2

    encoded, data = cv2.imencode(".png", luma)
    if not encoded:
        raise VideoError(f"{path.name}: cannot be coded as PNG")
    with atomic_output(path) as temporary:
        temporary.write_bytes(data.tobytes())
