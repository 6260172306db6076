"""Sweeps: measure points in processes of their own, here or on a Dask cluster; skip those that are finished.

One process encodes, a second decodes, and a third proves the rate.
"""

import filecmp
import json
import logging
import shlex
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from importlib import util
from pathlib import Path
from typing import Any

from dvc import cli
from dvc.environment import python_module
from dvc.errors import DvcError
from dvc.files import atomic_output
from dvc.rd.anchors import ANCHOR_CODECS
from dvc.rd.child_processes import ProcessGroup, Stopped
from dvc.rd.originals import Source, code_version, default_cache, find_source, input_digest
from dvc.rd.rd_results import POINTS_FOLDER, is_finished, write_result
from dvc.rd.specification import SCHEMA, Point, Task
from dvc.versions import codec_digest, library_versions
from dvc.video import open_video

Progress = Callable[[int], None]
"""Function that is called with the number of points that have just been finished."""
PICTURES_FOLDER = "pictures"
_STREAM, _PUNCTURED = "stream.dvc", "punctured.dvc"
_VIDEO, _AGAIN, _PREDICTED = "decoded.y4m", "again.y4m", "predicted.y4m"
_ENCODER_JSON, _DECODER_JSON = "encoder.json", "decoder.json"
_LOG = logging.getLogger(__name__)


@dataclass
class SweepSummary:
    """Outcome of a sweep."""

    num_measured: int = 0
    num_skipped: int = 0  # points that were finished before
    failures: list[tuple[str, str]] = field(default_factory=list)  # name and reason of points that failed
    digests: dict[str, str] = field(default_factory=dict)  # digests of the originals, by sequence


def run_points(
    points: Sequence[Point],
    folder: Path,
    cache: Path,
    *,
    jobs: int = 1,
    any_version: bool = False,
    progress: Progress = lambda _: None,
    cluster: str | None = None,
) -> SweepSummary:
    """Measure points; a missing sequence fails all of its points."""
    missing = [name for name in ("encoder", "decoder", "sequences") if util.find_spec(name) is None]
    if missing:
        raise DvcError(f"the package {missing[0]!r} is not installed, so that no point can be measured")
    try:
        (folder / POINTS_FOLDER).mkdir(parents=True, exist_ok=True)
    except OSError as err:
        raise DvcError(f"cannot write to {folder}: {err.strerror}") from err
    processes, summary, code = ProcessGroup(), SweepSummary(), code_version()
    sources: dict[str, Source | str] = {}
    waiting: list[Task] = []
    with ThreadPoolExecutor(jobs) as pool:
        try:
            for point in points:
                if point.sequence not in sources:
                    # In the pool, so that an interrupt reaches this thread while a scene is being rendered.
                    sources[point.sequence] = pool.submit(_find, point.sequence, cache, processes).result()
                source = sources[point.sequence]
                if isinstance(source, str):
                    summary.failures.append((f"{point.sequence}-{point.codec}", source))
                    progress(1)
                    continue
                summary.digests[point.sequence] = source.digest
                task = Task(point, source, code)
                if is_finished(folder, task, any_version):
                    summary.num_skipped += 1
                    progress(1)
                else:
                    waiting.append(task)
            here = [] if cluster is not None else waiting
            futures = {pool.submit(_run_one, task, folder, processes): task for task in here}
            outcomes: Iterator[tuple[Task, str | None]] = (
                (futures[future], future.result()) for future in as_completed(futures)
            )
            if cluster is not None and waiting:
                outcomes = _on_cluster(waiting, folder, cluster)
            for task, failure in outcomes:
                if failure is None:
                    summary.num_measured += 1
                else:
                    summary.failures.append((task.name, failure))
                    _LOG.warning("%s failed: %s", task.name, failure)
                progress(1)
        except BaseException:
            processes.stop()
            pool.shutdown(cancel_futures=True)
            raise
    return summary


def _find(sequence: str, cache: Path, processes: ProcessGroup) -> Source | str:
    try:
        return find_source(sequence, cache, processes)
    except (DvcError, OSError) as err:
        _LOG.warning("no point of %s can be measured: %s", sequence, problem := cli.one_line(err))
        return problem


def _run_one(task: Task, folder: Path, processes: ProcessGroup) -> str | None:
    """Measure one point and write its result; return the reason if that failed."""
    try:
        with tempfile.TemporaryDirectory(prefix=".running-", dir=folder) as scratch:
            write_result(folder, task.name, _measure_unchanged(task, Path(scratch), processes))
    except Stopped:
        raise
    except (DvcError, OSError) as err:
        return cli.one_line(err)
    except Exception as err:  # an unexpected error must not end the other points
        return f"{type(err).__name__}: {cli.one_line(err)}"
    return None


def _measure_unchanged(task: Task, scratch: Path, processes: ProcessGroup) -> dict[str, Any]:
    """Measure one point; raise `DvcError` if the code was changed meanwhile."""
    measured = measure(task, scratch, processes)
    if codec_digest() != task.code.digest:
        raise DvcError("the code was changed while the point was measured")
    return measured


def _on_cluster(tasks: Sequence[Task], folder: Path, address: str) -> Iterator[tuple[Task, str | None]]:
    """Measure points on the workers of a Dask cluster, and write the results and pictures here."""
    from dvc.dask_cluster import connected, failure_text

    with connected(address, tasks[0].code.digest) as client:
        from distributed import as_completed as completed

        futures = {
            client.submit(measure_on_worker, task, key=f"{task.name}-{task.identity}", pure=False): task
            for task in tasks
        }
        try:
            for future in completed(futures, loop=client.loop):
                task, error, failure = futures[future], future.exception(), None
                if error is not None:
                    yield task, failure_text(error, "measured this point")
                    continue
                data, pictures = future.result()
                try:
                    for name, content in pictures.items():
                        (folder / name).parent.mkdir(parents=True, exist_ok=True)
                        with atomic_output(folder / name) as temporary:
                            temporary.write_bytes(content)
                    write_result(folder, task.name, data)
                except (DvcError, OSError) as err:
                    failure = cli.one_line(err)
                yield task, failure
        finally:
            client.cancel(list(futures))


def measure_on_worker(task: Task) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Measure a point on a worker of a cluster; return its result, and its other files by name."""
    from dvc.dask_cluster import OTHER_CODE

    if codec_digest() != task.code.digest:
        raise DvcError(OTHER_CODE)
    source, processes = task.source, ProcessGroup()
    if not source.path.exists():  # the worker has its own cache of rendered scenes
        local = find_source(task.point.sequence, default_cache(), processes)
        if local.digest != source.digest:
            raise DvcError(f"{source.name}: the worker has another sequence of this name")
        task = replace(task, source=local)
    elif input_digest(source.path) != source.digest:
        raise DvcError(f"{source.name}: the worker has another file of this name")
    with tempfile.TemporaryDirectory(prefix="dvc3d-") as name:
        scratch = Path(name) / ".running"
        scratch.mkdir()
        data = _measure_unchanged(task, scratch, processes)
        pictures = sorted((Path(name) / PICTURES_FOLDER).glob("*"))
        return data, {f"{PICTURES_FOLDER}/{path.name}": path.read_bytes() for path in pictures}


def measure(task: Task, folder: Path, processes: ProcessGroup) -> dict[str, Any]:
    """Measure one point in a scratch folder; its pictures are written next to that folder."""
    is_anchor = task.point.codec in ANCHOR_CODECS
    commands_of, details_of = (
        (_anchor_commands, _anchor_details) if is_anchor else (_commands, _codec_details)
    )
    encoding, decoding, *_ = (
        processes.run([*python_module(*command), "--quiet"])
        for command in commands_of(task, str(task.source.path.absolute()), f"{folder}/")
    )
    texts = [(folder / name).read_text(encoding="utf-8") for name in (_ENCODER_JSON, _DECODER_JSON)]
    details = details_of(task, folder, *map(json.loads, texts))
    width, height, frames_per_s = details.pop("video")
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
        "commands": [
            shlex.join(["python", "-m", *words]) for words in commands_of(task, task.source.path.name)
        ],
        "times": {
            "encode_cpu_s": round(encoding.cpu_s, 4),
            "encode_wall_s": round(encoding.wall_s, 4),
            "decode_cpu_s": round(decoding.cpu_s, 4),
            "decode_wall_s": round(decoding.wall_s, 4),
            **{name: round(value, 6) for name, value in details.pop("times").items()},
        },
        **details,
        "pictures": _save_pictures(task, folder, details["per_frame"]),
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
    point = task.point
    file = f"{folder}stream{ANCHOR_CODECS[point.codec].suffix}"
    planes = ["--luma-only"] if point.luma_only else []
    frames = [] if point.frames is None else ["--frames", str(point.frames)]
    encode = ["dvc.rd.anchors", "encode", original, file, "--codec", point.codec, "--qp", point.key_qp]
    encode += ["--start", str(point.start), "--json", folder + _ENCODER_JSON, *frames, *planes]
    decode = ["dvc.rd.anchors", "decode", file, "--reference", original]
    decode += ["--reference-start", str(point.start), "--video", folder + _VIDEO]
    return encode, [*decode, *planes, "--json", folder + _DECODER_JSON]


def _codec_details(
    task: Task, folder: Path, coded: dict[str, Any], decoded: dict[str, Any]
) -> dict[str, Any]:
    """Check that the rate is the size of a file that decodes to the reported frames; return measurements."""
    no_feedback, reported = task.point.no_feedback, decoded["stream_bytes"]
    num_bytes = (folder / (_STREAM if no_feedback else _PUNCTURED)).stat().st_size
    if num_bytes != reported:
        kind = "no-feedback" if no_feedback else "punctured"
        raise DvcError(f"the {kind} stream has {num_bytes} bytes, the report says {reported}")
    proof: dict[str, Any] = {"punctured_bytes": num_bytes, "fresh_decode_equal": task.point.proof or None}
    if no_feedback:
        proof = {"file_bytes": num_bytes, "decoded_by": "a fresh process"}
    elif task.point.proof and not filecmp.cmp(folder / _VIDEO, folder / _AGAIN, shallow=False):
        raise DvcError("a fresh process decodes the punctured stream to other frames")
    config, per_frame = decoded.pop("config"), decoded.pop("per_frame")
    del decoded["version"]
    video = config["video"]
    frames_per_s = video["frame_rate_num"] / video["frame_rate_den"]
    if "time_s" in per_frame[0]:  # all codecs are compared at the constant rate
        duration_s = len(per_frame) / frames_per_s
        decoded |= {"duration_s": duration_s, "rate_kbps": 8 * num_bytes / duration_s / 1000}
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


def _anchor_details(
    task: Task, folder: Path, coded: dict[str, Any], decoded: dict[str, Any]
) -> dict[str, Any]:
    totals = decoded["totals"]
    num_bytes = (folder / f"stream{ANCHOR_CODECS[task.point.codec].suffix}").stat().st_size
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


def _save_pictures(task: Task, scratch: Path, per_frame: list[dict[str, Any]]) -> dict[str, Any]:
    """Write one frame of a point as grey PNG: original, decoded, predicted, and the key frame before it."""
    # An odd frame in the middle, which is rarely a key frame.
    index, folder = min(len(per_frame) // 2 | 1, len(per_frame) - 1), scratch.parent
    frame = task.point.start + index
    names: dict[str, str | None] = {
        "original": f"{PICTURES_FOLDER}/{task.source.name}-{task.source.digest[:8]}-{frame}.png",
        **{kind: f"{PICTURES_FOLDER}/{task.name}-{kind}.png" for kind in ("decoded", "predicted", "key")},
    }
    (folder / PICTURES_FOLDER).mkdir(exist_ok=True)
    original = folder / str(names["original"])
    if not original.is_file():  # several points share it, and may write it at the same time
        copy = original.with_name(f"{task.name}-original.png")
        _write_luma(copy, task.source.path, frame)
        copy.replace(original)
    _write_luma(folder / str(names["decoded"]), scratch / _VIDEO, index)
    key_index = None
    if per_frame[index]["type"] == "wz" and (scratch / _PREDICTED).exists():
        key_index = next((i for i in range(index - 1, -1, -1) if per_frame[i]["type"] == "key"), None)
    if key_index is None:
        names |= {"predicted": None, "key": None}
    else:
        _write_luma(folder / str(names["predicted"]), scratch / _PREDICTED, index)
        _write_luma(folder / str(names["key"]), scratch / _VIDEO, key_index)
    return {"index": index, "key_index": key_index, **names}


def _write_luma(path: Path, video: Path, index: int) -> None:
    from dvc.picture_files import write_png

    with open_video(video, start=index, num_frames=1) as reader, atomic_output(path) as temporary:
        write_png(temporary, next(iter(reader)).luma)
