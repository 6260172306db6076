"""One point: encode in one process, decode in a second, and prove the rate in a third."""

import filecmp
import json
import shlex
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from dvc.environment import python_module
from dvc.errors import DvcError
from dvc.rd.anchors.codecs import ANCHOR_CODECS
from dvc.rd.pictures import save_pictures
from dvc.rd.points import SCHEMA, Task
from dvc.rd.processes import ProcessGroup, ProcessTimes
from dvc.versions import library_versions

_STREAM, _PUNCTURED = "stream.dvc", "punctured.dvc"
_VIDEO, _AGAIN, _PREDICTED = "decoded.y4m", "again.y4m", "predicted.y4m"
_ENCODER_JSON, _DECODER_JSON = "encoder.json", "decoder.json"


def measure(task: Task, folder: Path, processes: ProcessGroup) -> dict[str, Any]:
    """Measure one point."""
    measured = (_measure_anchor if task.point.codec in ANCHOR_CODECS else _measure_codec)(
        task, folder, processes
    )
    predicted = folder / _PREDICTED
    measured["pictures"] = save_pictures(
        task,
        folder.parent,
        folder / _VIDEO,
        predicted if predicted.exists() else None,
        measured["per_frame"],
    )
    return measured


def _measure_codec(task: Task, folder: Path, processes: ProcessGroup) -> dict[str, Any]:
    encode, decode, *prove = _commands(task, str(task.source.path.absolute()), f"{folder}/")
    encoding = processes.run(_process(encode))
    decoding = processes.run(_process(decode))
    for command in prove:
        processes.run(_process(command))
    coded, decoded = _reports(folder)
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
        **_provenance(task, task.code.digest, video["width"], video["height"], frames_per_s),
        "commands": _shown(_commands(task, task.source.path.name)),
        "key": {"qp": config["key"]["qp"], "lossless": config["key"]["lossless"]},
        "totals": decoded,
        "times": {
            **_process_times(encoding, decoding),
            "coding_cpu_s": round(coded["coding_cpu_s"], 6),
            "key_encode_cpu_s": round(coded["key_cpu_s"], 6),
            "wz_encode_cpu_s": round(coded["wyner_ziv_cpu_s"], 6),
            "tracking_cpu_s": round(coded["tracking"]["cpu_s"], 6),
            "encode_start_up_cpu_s": round(coded["start_up_cpu_s"], 6),
        },
        "proof": proof,
        "config": config,
        "per_frame": per_frame,
    }


def _proof(task: Task, folder: Path, reported: int) -> dict[str, Any]:
    """Check that a rate is the size of a file, which decodes to the frames it is reported for."""
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


def _measure_anchor(task: Task, folder: Path, processes: ProcessGroup) -> dict[str, Any]:
    encode, decode = _anchor_commands(task, str(task.source.path.absolute()), f"{folder}/")
    encoding = processes.run(_process(encode))
    decoding = processes.run(_process(decode))
    coded, decoded = _reports(folder)
    totals = decoded["totals"]
    num_bytes = (folder / _anchor_file(task)).stat().st_size
    if not num_bytes == coded["bytes"] == totals["stream_bytes"] or coded["frames"] != totals["frames"]:
        raise DvcError(
            f"the file has {num_bytes} bytes, the reports say {coded['bytes']} for {coded['frames']} frames "
            f"and {totals['stream_bytes']} for {totals['frames']}"
        )
    vectors = {name: decoded[name] for name in ("num_vectors", "num_nonzero_vectors") if name in decoded}
    return {
        **_provenance(task, task.code_digest, decoded["width"], decoded["height"], decoded["frames_per_s"]),
        "commands": _shown(_anchor_commands(task, task.source.path.name)),
        "key": {"qp": coded["config"]["qp"], "lossless": False},
        "totals": totals,
        "times": {**_process_times(encoding, decoding), "coding_cpu_s": round(coded["coding_cpu_s"], 6)},
        "proof": {"file_bytes": num_bytes, "decoded_by": "FFmpeg", **vectors},
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
    encode = ["dvc.rd.anchors", "encode", original, file, "--codec", point.codec, "--qp", point.key_qp]
    encode += ["--start", str(point.start), "--json", folder + _ENCODER_JSON]
    if point.frames is not None:
        encode += ["--frames", str(point.frames)]
    decode = ["dvc.rd.anchors", "decode", file, "--reference", original]
    decode += ["--reference-start", str(point.start), "--video", folder + _VIDEO]
    if ANCHOR_CODECS[point.codec].zero_motion:
        decode.append("--zero-motion")
    planes = ["--luma-only"] if point.luma_only else []
    return [*encode, *planes], [*decode, *planes, "--json", folder + _DECODER_JSON]


def _anchor_file(task: Task) -> str:
    return f"stream{ANCHOR_CODECS[task.point.codec].suffix}"


def _process(arguments: list[str]) -> list[str]:
    return [*python_module(*arguments), "--quiet"]


def _shown(commands: tuple[list[str], ...]) -> list[str]:
    return [shlex.join(["python", "-m", *words]) for words in commands]


def _reports(folder: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Read what encoder and decoder have reported."""
    texts = [(folder / name).read_text(encoding="utf-8") for name in (_ENCODER_JSON, _DECODER_JSON)]
    return json.loads(texts[0]), json.loads(texts[1])


def _process_times(encoding: ProcessTimes, decoding: ProcessTimes) -> dict[str, float]:
    return {
        "encode_cpu_s": round(encoding.cpu_s, 4),
        "encode_wall_s": round(encoding.wall_s, 4),
        "decode_cpu_s": round(decoding.cpu_s, 4),
        "decode_wall_s": round(decoding.wall_s, 4),
    }


def _provenance(task: Task, digest: str, width: int, height: int, frames_per_s: float) -> dict[str, Any]:
    """Return what a result says of itself, its input and its code."""
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
        "code": {"version": task.code.version, "commit": task.code.commit, "digest": digest},
        "libraries": library_versions(),
    }
