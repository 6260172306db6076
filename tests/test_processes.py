"""Encoder and decoder as real processes: files, pipes of one machine, failing disks and failing peers."""

import fcntl
import json
import os
import resource
import signal
import socket
import subprocess
import sys
import termios
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from copy import deepcopy
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pytest

import decoder.__main__
import encoder.__main__
from benchmarks.hostile.bad_link import FAULTS, Faults
from benchmarks.hostile.lost_links import certificate
from benchmarks.slow_link import SlowLink, slow_link
from dvc.config import DEFAULT_CODEC
from dvc.errors import FeedbackError, VideoError
from dvc.feedback import Connection, DecoderEndpoint, EncoderEndpoint, parse_address
from dvc.geometry.cameras import PixelFrame
from dvc.metrics import psnr_db
from dvc.slepian_wolf import RequestTable
from dvc.stream import GopRecord, StreamReader
from dvc.video import Frame, open_video
from tests.clips import moving_texture, raw_bytes, same_frame, write_clip
from tests.scenes_3d import render
from tests.serving import frames_shown
from tests.waiting import wait_until

PATIENCE_S = 120
CODING = ("--codec", "2d", "--wz-q", 3)
"""Two groups of pictures with a Wyner-Ziv frame each."""
RAW = ("--size", "48x32", "--frame-rate", 25)


def start(module: str, *arguments: object, **options: Any) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", module, *map(str, arguments)]
    pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(command, text=True, **(pipes | options))


def finish(process: subprocess.Popen[str]) -> tuple[int, str]:
    try:
        _, stderr = process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
    return process.returncode, stderr


def run(module: str, *arguments: object, **options: Any) -> str:
    status, stderr = finish(start(module, *arguments, **options))
    assert status == 0, stderr
    return stderr


def run_here(module: str, *arguments: object) -> None:
    """Do as `run` without another process; groups are decoded in processes of their own all the same."""
    main = {"encoder": encoder.__main__.main, "decoder": decoder.__main__.main}[module]
    assert main([*map(str, arguments), "--quiet"]) == 0


def assert_refused(outcome: tuple[int, str], *words: str) -> None:
    status, stderr = outcome
    lines = stderr.splitlines()
    assert status == 2, stderr
    assert "Traceback" not in stderr
    assert all(word in lines[-1] for word in words), stderr


def listening_port(encoder: subprocess.Popen[str]) -> int:
    assert encoder.stderr is not None
    return int(encoder.stderr.readline().rsplit(":", 1)[1])


@contextmanager
def serving(source: object, *options: object, **pipes: Any) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Start a live encoder; return it and its address."""
    with start("encoder", source, *options, "--serve", "127.0.0.1:0", **pipes) as encoder:
        try:
            yield encoder, f"127.0.0.1:{listening_port(encoder)}"
        finally:
            encoder.kill()


@dataclass(frozen=True)
class Run:
    """Files that one way of decoding made."""

    video: Path
    punctured: Path
    side_information: Path
    report: dict[str, Any]

    @property
    def bits(self) -> list[dict[str, int]]:
        return [frame["bits"] for frame in self.report["per_frame"]]

    @property
    def contents(self) -> tuple[object, ...]:
        """Bytes of all files, and the bits of all frames."""
        files = (self.video, self.punctured, self.side_information)
        return *(file.read_bytes() for file in files), self.bits


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("processes")


@pytest.fixture(scope="module")
def clip(folder: Path) -> Path:
    return write_clip(folder / "clip.y4m", moving_texture(5, 32, 48))


@pytest.fixture(scope="module")
def stream(folder: Path, clip: Path) -> Path:
    run("encoder", clip, folder / "clip.dvc", *CODING)
    return folder / "clip.dvc"


def decode(folder: Path, name: str, clip: Path, *source: object, runs: Callable[..., object] = run) -> Run:
    video, punctured, report = (folder / f"{name}.{ending}" for ending in ("y4m", "dvc", "json"))
    predicted = folder / f"{name}_predicted.mkv"
    outputs = [video, "--punctured", punctured, "--json", report, "--side-information-video", predicted]
    runs("decoder", *source, *outputs, "--reference", clip)
    return Run(video, punctured, predicted, json.loads(report.read_text()))


@pytest.fixture(scope="module")
def buffered(folder: Path, clip: Path, stream: Path) -> Run:
    return decode(folder, "buffered", clip, stream)


@pytest.fixture(scope="module")
def live(folder: Path, clip: Path) -> Run:
    with serving(clip, *CODING, "--timeout", PATIENCE_S) as (encoder, address):
        decoded = decode(folder, "live", clip, "--connect", address, "--timeout", PATIENCE_S)
        status, stderr = finish(encoder)
    assert status == 0, stderr
    return decoded


@pytest.mark.parametrize("form", ["buffered", "punctured"])
@pytest.mark.parametrize(
    ("frames", "first", "end"), [("1:4", 1, 4), ("3:", 3, 5), (":1", 0, 1), ("4:99", 4, 5)]
)
def test_part_of_a_stream_is_that_part_of_the_whole(
    folder: Path, clip: Path, stream: Path, buffered: Run, form: str, frames: str, first: int, end: int
) -> None:
    """Frames A to B-1 have the samples, places, bits and PSNR that they have when all frames are decoded."""
    source = stream if form == "buffered" else buffered.punctured
    video, report, predicted = folder / "part.y4m", folder / "part.json", folder / "part_predicted.mkv"
    outputs = [video, "--json", report, "--side-information-video", predicted, "--reference", clip]
    run_here("decoder", source, *outputs, "--frames", frames, "--jobs", 1 + (first == 1))
    for part, whole in ((video, buffered.video), (predicted, buffered.side_information)):
        with open_video(part) as got, open_video(whole) as wanted:
            pictures = zip(list(got), list(wanted)[first:end], strict=True)
            assert all(np.array_equal(a.luma, b.luma) for a, b in pictures)
    totals = json.loads(report.read_text())
    rows, expected = totals["per_frame"], deepcopy(buffered.report["per_frame"][first:end])
    assert totals["stream_bytes"] == sum(sum(row["bits"].values()) for row in rows) / 8
    if first == 0:  # of a whole stream, the first frame has the bits of configuration and end
        expected[0]["bits"]["header"] = rows[0]["bits"]["header"]
    for row in (*rows, *expected):
        row.pop("decode_s", None)
    assert rows == expected


@pytest.fixture(scope="module")
def scene_clip(folder: Path) -> Path:
    """Write seven views of a static scene, two groups of pictures long."""
    frame = PixelFrame(104, 88)
    chroma = np.full((44, 52), 100, np.uint8), np.full((44, 52), 150, np.uint8)
    views = [Frame(render(k / 3.0, frame)[0], chroma) for k in range(7)]
    return write_clip(folder / "scene.y4m", views)


@pytest.mark.parametrize(
    ("codec", "references", "gop", "coder"),
    [
        ("3d", "keys", 3, "turbo"),
        ("3d-te", "hierarchical", 6, "cascade"),
        ("3d-td", "all", 3, "turbo"),
    ],
)
def test_scene_prediction_is_the_same_in_every_form(
    folder: Path, scene_clip: Path, codec: str, references: str, gop: int, coder: str
) -> None:
    """3D side information: any number of jobs, a punctured decoding and a live run agree to the bit."""
    coding = ["--gop", gop, "--references", references, "--coder", coder]
    if codec == DEFAULT_CODEC:
        coding += ["--qp", 26]  # some planes pay, others do not
    else:
        coding += ["--codec", codec, "--wz-q", 2, "--key-qp", 20]
    run_here("encoder", scene_clip, folder / "scene.dvc", *coding)
    first = decode(folder, "scene_1", scene_clip, folder / "scene.dvc", runs=run_here)
    wyner_ziv = [frame for frame in first.report["per_frame"] if frame["type"] == "wz"]
    assert {frame["side_information"] for frame in wyner_ziv} == {"depth"}
    assert (first.report["bits"]["tracks"] > 0) == (codec != "3d")
    assert (first.report["num_skipped_planes"] > 0) == (codec == DEFAULT_CODEC)
    maybe_fresh = run if codec == DEFAULT_CODEC else run_here
    others = [
        decode(folder, "scene_2", scene_clip, folder / "scene.dvc", "--jobs", 2, runs=run_here),
        decode(folder, "scene_3", scene_clip, first.punctured, runs=maybe_fresh),
    ]
    with serving(scene_clip, *coding) as (encoder, address):
        others.append(decode(folder, "scene_4", scene_clip, "--connect", address))
        assert finish(encoder)[0] == 0
    assert all(other.contents == first.contents for other in others)


def test_a_scene_may_be_decoded_with_another_method(folder: Path, scene_clip: Path) -> None:
    """The decoder may choose method and estimators for a buffered stream, not for a punctured one."""
    coding = ["--codec", "3d", "--gop", 3, "--wz-q", 1, "--key-qp", 20]
    run_here("encoder", scene_clip, folder / "choice.dvc", *coding)
    chosen = ["--side-information", "blocks", "--sfm", "colmap"]
    decoded = decode(folder, "chosen", scene_clip, folder / "choice.dvc", *chosen, runs=run_here)
    used = {frame.get("side_information", "blocks") for frame in decoded.report["per_frame"]}
    assert used == {"blocks"}
    assert decoded.report["config"]["geometry"]["backend"] == "colmap"
    refused = start("decoder", decoded.punctured, folder / "no.y4m", "--side-information", "mesh")
    assert_refused(finish(refused), "punctured", "blocks", "colmap")


def test_live_run_gives_the_same_frames_and_bits(buffered: Run, live: Run) -> None:
    assert live.contents == buffered.contents
    requests = [[frame.get("num_requests") for frame in run.report["per_frame"]] for run in (live, buffered)]
    assert requests[0] == requests[1]
    assert 0 < live.report["num_messages"] <= live.report["num_requests"]
    assert 0.0 < live.report["delay_s"]["median"] <= live.report["delay_s"]["worst"]
    assert "delay_s" not in buffered.report


def test_side_information_video_holds_what_was_predicted(clip: Path, buffered: Run) -> None:
    """It is as long as the decoded video, luma only: predictions as the report rates them, and key frames."""
    videos = []
    for path in (clip, buffered.video, buffered.side_information):
        with open_video(path) as video:
            videos.append(list(video))
    rows = buffered.report["per_frame"]
    for row, original, decoded, predicted in zip(rows, *videos, strict=True):
        assert predicted.chroma is None
        if row["type"] == "key":
            np.testing.assert_array_equal(predicted.luma, decoded.luma)
        else:
            assert psnr_db(original.luma, predicted.luma) == row["si_psnr_y_db"]


def test_reported_bits_are_the_size_of_the_punctured_file(buffered: Run) -> None:
    size = buffered.punctured.stat().st_size
    report = buffered.report
    assert sum(sum(bits.values()) for bits in buffered.bits) == 8 * size
    assert sum(report["bits"].values()) == 8 * size
    assert report["stream_bytes"] == size
    assert report["rate_kbps"] == pytest.approx(8 * size * 25 / 5 / 1000)
    assert report["num_failed_planes"] == 0
    assert report["wz_psnr_y_db"] > report["si_psnr_y_db"]
    assert report["psnr_y_db"] > 28
    assert [frame["type"] for frame in report["per_frame"]] == ["key", "wz", "key", "wz", "key"]


def limit_file_size(size: int) -> Callable[[], None]:
    """Stand-in for a full disk that needs no rights: no file may grow beyond a size."""
    return lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


@pytest.mark.parametrize(
    ("module", "output"), [("decoder", "a.y4m"), ("decoder", "a.mkv"), ("encoder", "a.dvc")]
)
def test_a_full_disk_leaves_nothing(
    tmp_path: Path, clip: Path, stream: Path, module: str, output: str
) -> None:
    source, size = (clip, 100) if module == "encoder" else (stream, 1000)
    process = start(module, source, tmp_path / output, preexec_fn=limit_file_size(size))
    assert_refused(finish(process), f"dvc-{module.removesuffix('r')}", output)
    assert list(tmp_path.iterdir()) == []


def test_a_first_connection_that_is_lost_is_tried_again(clip: Path, buffered: Run, tmp_path: Path) -> None:
    with serving(clip, *CODING) as (encoder, address):
        with slow_link(*parse_address(address), 0.001, 1e9) as link:
            link.is_down = True
            with start("decoder", "--connect", link.address, tmp_path / "out.y4m") as decoder:
                assert decoder.stderr is not None
                said = decoder.stderr.readline()
                assert "closed the connection" in said or "went away" in said
                assert said.endswith("; trying again for 30 s\n")
                link.is_down = False
                assert finish(decoder) == (0, "")
        assert finish(encoder) == (0, "")
    assert (tmp_path / "out.y4m").read_bytes() == buffered.video.read_bytes()


def test_decoder_and_encoder_prove_who_they_are(clip: Path, buffered: Run, tmp_path: Path) -> None:
    """By token and certificate inside TLS; a wrong end gets one line, and the encoder waits for the other."""
    import trustme

    for name in ("token", "other"):
        (tmp_path / name).write_text(f"a secret, the {name} of two\n")
    other = tmp_path / "other.pem"
    trustme.CA().cert_pem.write_to_path(other)
    ours, theirs = certificate(tmp_path)
    token = ("--token-file", tmp_path / "token")
    with serving(clip, *CODING, *ours, *token) as (encoder, address):
        for reason, *words in (
            ("dvc-decode: ", "--patience", 0),
            ("dvc-decode: ", "--tls-ca", other),
            ("dvc-decode: ", "--fingerprint", "0" * 64),
            ("the token is wrong", *theirs),
            ("the token is wrong", *theirs, "--token-file", tmp_path / "other"),
        ):
            decoder = start("decoder", "--connect", address, tmp_path / "no.y4m", *words)
            assert_refused(finish(decoder), reason)
        run_here("decoder", "--connect", address, tmp_path / "yes.y4m", *theirs, *token)
        status, stderr = finish(encoder)
    assert status == 0, stderr
    assert stderr.count("dvc-encode: not a decoder: ") == 5, stderr
    assert (tmp_path / "yes.y4m").read_bytes() == buffered.video.read_bytes()


def test_a_network_is_not_served_without_tls(clip: Path) -> None:
    assert_refused(finish(start("encoder", clip, *CODING, "--serve", "0.0.0.0:0")), "TLS or --insecure")


@contextmanager
def halted(folder: Path, *names: str) -> Iterator[tuple[subprocess.Popen[str], subprocess.Popen[str]]]:
    """Start encoder and decoder of a live run with a source that halts after four frames; decode the first.

    The fourth is a Wyner-Ziv frame; its group has no end yet.
    """
    outputs = [name if name.startswith("--") else folder / name for name in names]
    with serving("-", *RAW, *CODING, stdin=subprocess.PIPE) as (encoder, address):
        assert encoder.stdin is not None
        encoder.stdin.buffer.write(raw_bytes(moving_texture(5, 32, 48)[:4]))
        encoder.stdin.flush()
        with start("decoder", "--connect", address, *outputs, "--patience", 1) as decoder:
            video = folder / f"{names[0]}.part"
            wait_until(lambda: video.exists() and frames_of(video))
            wait_until(lambda: is_waiting_for_more(encoder))
            try:
                yield encoder, decoder
            finally:
                decoder.kill()


def is_waiting_for_more(reader: subprocess.Popen[str]) -> bool:
    """Return whether a process has read all of its standard input, and all its threads sleep."""
    assert reader.stdin is not None
    num_unread = int.from_bytes(fcntl.ioctl(reader.stdin, termios.FIONREAD, bytes(4)), sys.byteorder)
    threads = Path(f"/proc/{reader.pid}/task").glob("*/stat")
    return num_unread == 0 and {stat.read_text().rpartition(")")[2].split()[0] for stat in threads} == {"S"}


def frames_of(path: Path) -> list[Frame]:
    """Return the frames of a video with any name."""
    whole = path.with_name("look.y4m")
    whole.write_bytes(path.read_bytes())
    try:
        with open_video(whole) as video:
            return list(video)
    except VideoError:  # nothing but a header
        return []
    finally:
        whole.unlink()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_encoder_sends_its_end(tmp_path: Path, buffered: Run, number: signal.Signals) -> None:
    """Frames that came before it are coded and decoded; the decoder has a whole video of them."""
    with halted(tmp_path, "out.y4m") as (encoder, decoder):
        encoder.send_signal(number)
        assert finish(decoder) == (0, "")
        status, stderr = finish(encoder)
    assert (status, stderr.splitlines()[-1]) == (130, "dvc-encode: interrupted")
    assert [path.name for path in tmp_path.iterdir()] == ["out.y4m"]
    frames, whole = frames_of(tmp_path / "out.y4m"), frames_of(buffered.video)
    assert len(frames) == 3  # the fourth waits for the end of its group
    assert all(same_frame(*pair) for pair in zip(frames, whole, strict=False))


def test_frames_that_a_decoder_cannot_take_are_left_out_and_counted(tmp_path: Path) -> None:
    """A pipe delivers all at once: whole groups reach the decoder, at their times; the rest is reported."""
    options = (*RAW, *CODING, "--leave-out", "--queue", 16, "--json", tmp_path / "report.json")
    with serving("-", *options, stdin=subprocess.PIPE) as (encoder, address):
        assert encoder.stdin is not None
        with start("decoder", "--connect", address, tmp_path / "out.mkv") as decoder:
            encoder.stdin.buffer.write(raw_bytes(moving_texture(60, 32, 48)))
            encoder.stdin.close()
            encoder.stdin = None
            assert finish(decoder) == (0, "")
            status, stderr = finish(encoder)
    assert status == 0, stderr
    report = json.loads((tmp_path / "report.json").read_text())
    left_out = report["left_out"]
    assert left_out["frames"] >= 20
    assert left_out["gaps"] >= 1
    assert f"left out {left_out['frames']} frames in {left_out['gaps']} gap" in stderr
    times_s = [time_s for _, time_s in frames_shown(tmp_path / "out.mkv")]
    assert len(times_s) == report["frames"] == 60 - left_out["frames"]
    assert set(times_s) <= {Fraction(number, 25) for number in range(60)}
    assert (
        sum(after - before > Fraction(1, 25) for before, after in pairwise(times_s)) >= left_out["gaps"] - 1
    )


@pytest.mark.parametrize("cause", ["SIGINT", "SIGTERM", "death"])
def test_decoded_frames_of_a_broken_live_run_are_kept(tmp_path: Path, buffered: Run, cause: str) -> None:
    """After an early end, whole groups stay as .part, with their own line and status, and a map of them."""
    names = ("out.y4m", "--punctured", "small.dvc", "--json", "report.json", "--scene", "map")
    with halted(tmp_path, *names) as (encoder, decoder):
        encoder.kill() if cause == "death" else decoder.send_signal(signal.Signals[cause])
        status, stderr = finish(decoder)
        _, encoder_stderr = encoder.communicate(timeout=PATIENCE_S)  # closes its input
    assert status == 3, stderr
    frames = frames_of(tmp_path / "out.y4m.part")
    assert frames
    assert stderr.splitlines()[-1].endswith(f"(frames kept: {len(frames)}, as {tmp_path}/out.y4m.part)")
    assert cause == "death" or encoder_stderr.splitlines()[-1].startswith("dvc-encode: the other side")
    left = sorted(path.name for path in tmp_path.iterdir())
    assert left == ["map", "out.y4m.part", "report.json.part", "small.dvc.part"]
    assert json.loads((tmp_path / "map" / "scene.json").read_text())["num_frames"] == len(frames)
    assert f"no frame of {len(frames)} located" in stderr
    assert all(same_frame(*pair) for pair in zip(frames, frames_of(buffered.video), strict=False))
    run_here("decoder", tmp_path / "small.dvc.part", tmp_path / "again.y4m", "--unfinished")
    assert (tmp_path / "again.y4m").read_bytes() == (tmp_path / "out.y4m.part").read_bytes()
    assert json.loads((tmp_path / "report.json.part").read_text())["frames"] == len(frames)


def test_interrupt_leaves_nothing(tmp_path: Path, clip: Path) -> None:
    """An encoder that is interrupted while it waits for a decoder says so and ends with status 130."""
    with serving(clip, "--json", tmp_path / "report.json") as (encoder, _):
        encoder.send_signal(signal.SIGINT)
        status, stderr = finish(encoder)
    assert (status, stderr) == (130, "dvc-encode: interrupted\n")
    assert list(tmp_path.iterdir()) == []


def test_termination_leaves_nothing(tmp_path: Path, stream: Path) -> None:
    (tmp_path / "out").mkdir()
    os.mkfifo(tmp_path / "pipe.dvc")
    decoder = start("decoder", tmp_path / "pipe.dvc", tmp_path / "out" / "out.mkv")
    with decoder, (tmp_path / "pipe.dvc").open("wb") as pipe:
        pipe.write(stream.read_bytes()[:-40])
        pipe.flush()
        wait_until(lambda: any((tmp_path / "out").iterdir()))
        decoder.send_signal(signal.SIGTERM)
        status, stderr = finish(decoder)
    assert (status, stderr) == (143, "dvc-decode: terminated\n")
    assert list((tmp_path / "out").iterdir()) == []


def next_event(connection: Connection, endpoint: DecoderEndpoint | EncoderEndpoint) -> object:
    """Send pending bytes, and return the next event."""
    connection.send(endpoint.bytes_to_send())
    while not (events := endpoint.receive(connection.receive(PATIENCE_S))):
        continue
    return events[0]


Behaviour = Callable[[socket.socket, Path], None]


def listen_only(peer: socket.socket, stream: Path) -> None:
    del stream
    while peer.recv(2**16):
        continue


def welcome(peer: socket.socket, stream: Path) -> tuple[Connection, EncoderEndpoint, list[GopRecord]]:
    """Welcome a decoder as an encoder does."""
    connection = Connection(peer)
    with StreamReader(stream) as reader:
        endpoint, records = EncoderEndpoint(reader.config), list(reader)
    next_event(connection, endpoint)
    endpoint.send_welcome()
    return connection, endpoint, records


def answer_until_the_first_request(
    peer: socket.socket, stream: Path
) -> tuple[Connection, EncoderEndpoint, RequestTable]:
    connection, endpoint, records = welcome(peer, stream)
    while True:
        while endpoint.flow.num_credits and records:
            endpoint.send_gop(records.pop(0))
        event = next_event(connection, endpoint)
        if isinstance(event, RequestTable):
            return connection, endpoint, event


def drip_at_the_first_request(peer: socket.socket, stream: Path) -> None:
    """Send an answer a byte at a time, each before the timeout."""
    connection, endpoint, table = answer_until_the_first_request(peer, stream)
    endpoint.send_answers(bytes(-(-table.num_bits // 8)))
    with suppress(FeedbackError):
        for byte in endpoint.bytes_to_send()[:-1]:
            connection.send(bytes([byte]))
            connection.receive(0.6)
        connection.receive(PATIENCE_S)


@pytest.mark.parametrize(
    ("behaviour", "status", "words"),
    [
        (listen_only, 2, "is silent for 1 s"),
        (drip_at_the_first_request, 3, "is silent for 1 s"),
    ],
)
def test_decoder_ends_with_a_bad_encoder(
    tmp_path: Path, stream: Path, behaviour: Behaviour, status: int, words: str
) -> None:
    """An encoder that is silent or drips ends it with one line; whole groups are kept."""

    def serve() -> None:
        peer, _ = listener.accept()
        with peer:
            behaviour(peer, stream)

    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=serve)
        thread.start()
        address = f"127.0.0.1:{listener.getsockname()[1]}"
        options = ("--timeout", 1, "--patience", 0)
        decoder = start("decoder", "--connect", address, tmp_path / "out.y4m", *options)
        ended, stderr = finish(decoder)
        thread.join(PATIENCE_S)
    assert ended == status, stderr
    assert stderr.startswith("dvc-decode: ")
    assert words in stderr
    assert stderr.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["out.y4m.part"] * (status == 3)


@pytest.fixture(scope="module")
def long_clip(folder: Path) -> Path:
    return write_clip(folder / "long.y4m", moving_texture(80, 48, 64))


@pytest.fixture(scope="module")
def unbroken(folder: Path, long_clip: Path) -> Run:
    run_here("encoder", long_clip, folder / "long.dvc", *CODING)
    return decode(folder, "unbroken", long_clip, folder / "long.dvc", runs=run_here)


@pytest.mark.parametrize(
    ("fault", "protection"),
    [
        ("all faults", "tls"),
        ("cuts", "plain"),
        pytest.param("cuts", "tls", marks=pytest.mark.slow),
    ],
)
def test_a_bad_link_changes_neither_frames_nor_bits(
    long_clip: Path, unbroken: Run, tmp_path: Path, protection: str, fault: str
) -> None:
    """Cut every so often, flipped, left out, repeated, moved, trickled: files are those of a good link."""
    ours, theirs = certificate(tmp_path) if protection == "tls" else ([], [])
    report = tmp_path / "encoder.json"
    options = ("--patience", PATIENCE_S, "--json", report, *ours)
    with serving(long_clip, *CODING, *options) as (encoder, address):
        faults = EachFault(FAULTS if fault == "all faults" else ())
        with slow_link(*parse_address(address), 0.0, 2e6, faults) as link:
            words = ("--connect", link.address, "--patience", PATIENCE_S, "--timeout", 5, *theirs)
            cutter = threading.Timer(0.0, cut_often, (link, encoder))
            if fault == "cuts":
                cutter.start()
            decoded = decode(tmp_path, "broken", long_clip, *words)
        status, stderr = finish(encoder)
    assert status == 0, stderr
    assert decoded.contents == unbroken.contents
    assert not faults.kinds
    counts = json.loads(report.read_text())
    assert counts["num_reconnections"] > 0
    assert counts["groups_sent_again"] > 0
    assert decoded.report["num_reconnections"] > 0
    assert decoded.report["away_s"] > 0.0


def cut_often(link: SlowLink, encoder: subprocess.Popen[str]) -> None:
    """Cut a link once some bytes have passed since the last time."""
    num_bytes = 5000
    while encoder.poll() is None:
        if link.forth.num_bytes + link.back.num_bytes > num_bytes:
            link.cut()
            num_bytes = link.forth.num_bytes + link.back.num_bytes + 20000
        Event().wait(0.01)


class EachFault:
    """Makes one fault of each kind, far apart; none in a first handshake, for that would end the run."""

    def __init__(self, kinds: Iterable[str]) -> None:
        self.kinds, self._left = list(kinds), 20_000

    def __call__(self, data: bytes) -> Iterable[bytes]:
        self._left -= len(data)
        if self._left > 0 or not self.kinds:
            return (data,)
        self._left = 20_000
        return Faults(0.0, seed=1, kinds=[self.kinds.pop(0)])(data)


def test_a_decoder_keeps_its_frames_if_another_encoder_comes(
    tmp_path: Path, long_clip: Path, unbroken: Run
) -> None:
    words = (tmp_path / "out.y4m", "--patience", 10 * PATIENCE_S)
    with (
        serving(long_clip, *CODING) as (encoder, address),
        start("decoder", "--connect", address, *words) as decoder,
    ):
        video = tmp_path / "out.y4m.part"
        wait_until(lambda: video.exists() and len(frames_of(video)) > 2)
        encoder.kill()
        finish(encoder)
        with start("encoder", long_clip, *CODING, "--serve", address) as another:
            status, stderr = finish(decoder)
            another.kill()
            _, another_stderr = another.communicate()
    assert status == 3, stderr
    assert "no decoder can continue here after" in stderr
    assert "no decoder can continue here after" in another_stderr
    frames = frames_of(video)
    assert all(same_frame(*pair) for pair in zip(frames, frames_of(unbroken.video), strict=False))
