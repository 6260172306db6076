"""One point: encode in one process, decode in a second, and prove the rate in a third."""

import filecmp
import json
import shlex
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from dvc.errors import DvcError
from dvc.rd.processes import ProcessGroup
from dvc.rd.provenance import library_versions
from dvc.rd.results import SCHEMA, Task

_STREAM, _PUNCTURED = "stream.dvc", "punctured.dvc"
_VIDEO, _AGAIN = "decoded.y4m", "again.y4m"
_ENCODER_JSON, _DECODER_JSON = "encoder.json", "decoder.json"


def measure(task: Task, folder: Path, processes: ProcessGroup) -> dict[str, Any]:
    """Measure one point.

    The rate is the size of the punctured stream. That it is an honest one is proven here: a fresh process
    decodes that stream, with nothing else at hand, to the same bytes.

    Parameters
    ----------
    task : Task
        The point.
    folder : Path
        Empty folder for the streams and decoded videos.
    processes : ProcessGroup
        Runs the encoder and the decoders.

    Returns
    -------
    dict
        Contents of the result file; see `docs/results.md`.

    Raises
    ------
    DvcError
        If one of the processes fails, or the proof does.
    Stopped
        If the experiment was stopped.
    """
    encode, decode, prove = _commands(task, str(task.source.path.absolute()), f"{folder}/")
    encoding = processes.run(_process(encode))
    decoding = processes.run(_process(decode))
    processes.run(_process(prove))
    coded = json.loads((folder / _ENCODER_JSON).read_text(encoding="utf-8"))
    decoded = json.loads((folder / _DECODER_JSON).read_text(encoding="utf-8"))
    num_bytes = (folder / _PUNCTURED).stat().st_size
    if num_bytes != decoded["stream_bytes"]:
        raise DvcError(
            f"the punctured stream has {num_bytes} bytes, the report says {decoded['stream_bytes']}"
        )
    if not filecmp.cmp(folder / _VIDEO, folder / _AGAIN, shallow=False):
        raise DvcError("a fresh process decodes the punctured stream to other frames")
    config, per_frame = decoded.pop("config"), decoded.pop("per_frame")
    del decoded["version"]
    return {
        "schema": SCHEMA,
        "identity": task.identity,
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "sequence": _sequence(task, config),
        "codec": task.point.codec,
        "options": task.point.to_dict(),
        "code": {"version": task.code.version, "commit": task.code.commit, "digest": task.code.digest},
        "libraries": library_versions(),
        "commands": [
            shlex.join(["python", "-m", *words]) for words in _commands(task, task.source.path.name)
        ],
        "key": {"qp": config["key"]["qp"], "lossless": config["key"]["lossless"]},
        "totals": decoded,
        "times": {
            "encode_cpu_s": round(encoding.cpu_s, 4),
            "encode_wall_s": round(encoding.wall_s, 4),
            "key_encode_cpu_s": round(coded["key_cpu_s"], 6),
            "wz_encode_cpu_s": round(coded["wyner_ziv_cpu_s"], 6),
            "decode_cpu_s": round(decoding.cpu_s, 4),
            "decode_wall_s": round(decoding.wall_s, 4),
        },
        "proof": {"punctured_bytes": num_bytes, "fresh_decode_equal": True},
        "config": config,
        "per_frame": per_frame,
    }


def _commands(task: Task, original: str, folder: str = "") -> tuple[list[str], list[str], list[str]]:
    """Return the arguments of encoder, decoder and proving decoder, each after the name of its module."""
    stream, punctured, video = folder + _STREAM, folder + _PUNCTURED, folder + _VIDEO
    encode = ["encoder", original, stream, *task.point.encoder_options(), "--json", folder + _ENCODER_JSON]
    decode = ["decoder", stream, video, "--reference", original, "--reference-start", str(task.point.start)]
    decode += ["--punctured", punctured, "--json", folder + _DECODER_JSON]
    return encode, decode, ["decoder", punctured, folder + _AGAIN]


def _process(arguments: list[str]) -> list[str]:
    return [sys.executable, "-m", *arguments, "--quiet"]


def _sequence(task: Task, config: dict[str, Any]) -> dict[str, Any]:
    video = config["video"]
    return {
        "name": task.source.name,
        "digest": task.source.digest,
        "width": video["width"],
        "height": video["height"],
        "frames_per_s": video["frame_rate_num"] / video["frame_rate_den"],
    }
