"""Test clips made from their sources: from a local server or folder, checked by their digests."""

import contextlib
import functools
import http.server
import threading
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from dvc.video import Frame, create_video, open_video
from sequences import fetch as fetching
from sequences.__main__ import main
from sequences.clip_sources import DIGESTS, NOT_REPEATABLE, SOURCES, Source

CLIP = Source("some/where", "abc", "clip.mkv", 1, 2, (400, 320), (20, 10, 360, 300), Fraction(25))
IMAGES = replace(CLIP, path="in/image_%02d.png", first=3)


class Quiet(http.server.SimpleHTTPRequestHandler):
    """A server of a folder that writes no log."""

    def log_message(self, format: str, *args: object) -> None:
        """Write nothing."""


@pytest.fixture
def tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Sources laid out as GitHub has them: a video of four frames, and images."""
    root = tmp_path / "tree"
    folder = root / CLIP.repository / CLIP.commit
    (folder / "in").mkdir(parents=True)
    rng = np.random.default_rng(1)
    with create_video(folder / CLIP.path, CLIP.size, CLIP.frame_rate) as writer:
        for _ in range(4):
            luma = rng.integers(16, 236, (320, 400), np.uint8)
            chroma = rng.integers(16, 241, (2, 160, 200), np.uint8)
            writer.write(Frame(luma, (chroma[0], chroma[1])))
    for index in range(3, 5):
        colours = np.broadcast_to(np.array([200, 30, 60 + index], np.uint8), (320, 400, 3))
        with av.open(str(folder / (IMAGES.path % index)), "w", format="image2") as container:
            stream = container.add_stream(
                "png", width=400, height=320, pix_fmt="rgb24", options={"update": "1"}
            )
            picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(colours), "rgb24")
            container.mux([*stream.encode(picture), *stream.encode(None)])
    for name, source in (("clip", CLIP), ("images", IMAGES)):
        monkeypatch.setitem(SOURCES, name, source)
        monkeypatch.setitem(DIGESTS, name, "")
    return root


@pytest.fixture
def server(tree: Path) -> Iterator[str]:
    """The address of a local server of the sources."""
    handler = functools.partial(Quiet, directory=str(tree))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as running:
        thread = threading.Thread(target=running.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{running.server_port}"
        running.shutdown()
        thread.join()


def run_fetch(names: str, origin: str | Path, out: Path) -> int:
    return main(["fetch", *names.split(), "--from", str(origin), "--out", str(out)])


def accept(monkeypatch: pytest.MonkeyPatch, name: str, clip: Path) -> None:
    """Record the digest of a clip as the right one."""
    monkeypatch.setitem(DIGESTS, name, fetching.digest(clip))


def test_clip_is_cropped_and_scaled(server: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Planes are means over areas of the crop; with the right digest the clip gets its name, and stays."""
    out = tmp_path / "clips"
    assert run_fetch("clip", server, out) == 2
    accept(monkeypatch, "clip", out / "clip-unchecked.mkv")
    assert run_fetch("clip", server, out) == 0
    assert [path.name for path in out.iterdir()] == ["clip.mkv"]
    with open_video(out / "clip.mkv") as made:
        assert (made.info.size, made.info.frame_rate) == ((352, 288), 25)
        frames = list(made)
    with open_video(tmp_path / "tree" / "some" / "where" / "abc" / "clip.mkv") as original:
        sources = list(original)[1:3]
    for frame, source in zip(frames, sources, strict=True):
        assert frame.chroma is not None
        assert source.chroma is not None
        for plane, cut in (
            (frame.luma, source.luma[10:310, 20:380]),
            (frame.chroma[1], source.chroma[1][5:155, 10:190]),
        ):
            rows, columns = (areas(n, m) for n, m in zip(cut.shape, plane.shape, strict=True))
            assert np.abs(rows @ cut.astype(float) @ columns.T - plane).max() < 0.51
    assert run_fetch("clip", "http://127.0.0.1:1", out) == 0


def areas(size: int, target: int) -> np.ndarray:
    """Return the share of each sample in each of the fewer target samples."""
    edges = np.arange(target + 1) * size / target
    low, high = np.arange(size), np.arange(size) + 1
    covered = np.minimum(edges[1:, None], high) - np.maximum(edges[:-1, None], low)
    return np.maximum(covered, 0) * target / size


def test_images_are_converted(tree: Path, tmp_path: Path) -> None:
    assert run_fetch("images", tree, tmp_path / "out") == 2
    with open_video(tmp_path / "out" / "images-unchecked.mkv") as made:
        frames = [frame.with_chroma() for frame in made]
    assert len(frames) == 2
    red, green, blue = 200, 30, 63
    luma = 16 + (65.481 * red + 128.553 * green + 24.966 * blue) / 255
    assert np.abs(frames[0].luma - luma).max() <= 1
    assert frames[0].chroma is not None
    cr = 128 + (112.0 * red - 93.786 * green - 18.214 * blue) / 255
    assert np.abs(frames[0].chroma[1] - cr).max() <= 1


def test_wrong_digest_is_reported(
    tree: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A clip that differs gives one line and status 2 and does not get its name; the next one is made."""
    out = tmp_path / "clips"
    assert run_fetch("images clip", tree, out) == 2
    accept(monkeypatch, "clip", out / "clip-unchecked.mkv")
    capsys.readouterr()
    assert run_fetch("images clip", tree, out) == 2
    shown = capsys.readouterr()
    assert shown.out.split() == [str(out / "clip.mkv")]
    assert len(shown.err.splitlines()) == 1
    assert "not the clip that results were measured on" in shown.err
    assert not (out / "images.mkv").exists()


def test_folder_may_hold_bare_file_names(tree: Path, tmp_path: Path) -> None:
    folder = tree / CLIP.repository / CLIP.commit
    assert run_fetch("clip", folder, tmp_path / "out") == 2
    assert (tmp_path / "out" / "clip-unchecked.mkv").exists()


@pytest.mark.parametrize(
    ("name", "origin", "message"),
    [
        ("foreman_qcif15", "{tree}", "cannot be made"),
        ("beach", "{tree}", "no clip is called 'beach'"),
        ("clip", "{server}/other", "404"),
        ("clip", "http://127.0.0.1:1", "refused"),
        ("clip", "file:///etc", "only http and https"),
        ("clip", "nowhere", "neither clip.mkv nor"),
        ("box", "{tree}", "neither data/box.mp4"),
    ],
)
def test_wrong_input_is_one_line(
    name: str,
    origin: str,
    message: str,
    server: str,
    tree: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A clip that cannot be made gives one line with the reason and status 2, and leaves no file."""
    assert run_fetch(name, origin.format(server=server, tree=tree), tmp_path / "out") == 2
    error = capsys.readouterr().err
    assert message in error
    assert len(error.splitlines()) == 1
    assert not list(tmp_path.glob("out/*"))


@pytest.mark.parametrize(
    ("length", "max_bytes", "message"),
    [
        ("abc", 2**28, "invalid literal"),
        ("4096", 2**28, "not complete after 0 s"),
        ("4096", 2, "larger than"),
    ],
)
def test_endless_answers_are_abandoned(
    length: str,
    max_bytes: int,
    message: str,
    tree: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """An answer of a byte at a time ends at the limits of time and size; a malformed length is refused."""
    monkeypatch.setattr(fetching, "MAX_FILE_BYTES", max_bytes)
    monkeypatch.setattr(fetching, "MAX_FILE_S", 0.3)
    gone = threading.Event()

    class Dripping(Quiet):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Length", length)
            self.end_headers()
            with contextlib.suppress(OSError):
                while not gone.wait(0.05):
                    self.wfile.write(b"x")

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Dripping) as running:
        threading.Thread(target=running.serve_forever).start()
        address = f"http://127.0.0.1:{running.server_port}"
        assert run_fetch("clip", address, tmp_path / "out") == 2
        gone.set()
        running.shutdown()
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    "source", [replace(CLIP, size=(400, 300)), replace(CLIP, first=3)], ids=["size", "end"]
)
def test_other_sources_are_refused(
    source: Source, tree: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(SOURCES, "clip", source)
    assert run_fetch("clip", tree, tmp_path / "out") == 2
    assert not list(tmp_path.glob("out/*"))


def test_help_has_notes_on_sources(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["fetch", "--help"])
    shown = " ".join(capsys.readouterr().out.split())
    assert "examples:" in shown
    assert all(f"{name} cannot be made" in shown for name in NOT_REPEATABLE)
    assert all(source.uncertain in shown for source in SOURCES.values())
    assert {name: len(digest) for name, digest in DIGESTS.items()} == dict.fromkeys(SOURCES, 64)
