"""Digests of the output of small encodings and decodings, to find changes of their bytes."""

import hashlib
import json
import tempfile
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path

from benchmarks.results.harness import run_module
from dvc.rd.anchors import ANCHOR_CODECS

_SIZE, _CODED_SIZE = "96x80", "128x96"


def _digest(paths: Iterable[Path]) -> str:
    parts = [hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(paths)]
    return hashlib.sha256("".join(parts).encode()).hexdigest()[:16]


@cache
def anchors() -> str:
    """Digest the files of all anchors for a rendered scene, and their measured values."""
    from dvc.rd.anchors.anchor_files import encode_file, measure_file

    with tempfile.TemporaryDirectory() as scratch:
        video, files = Path(scratch) / "street.mkv", []
        run_module("sequences", "render", "street", "--size", _CODED_SIZE, "--frames", 17, "--out", video)
        for name, codec in ANCHOR_CODECS.items():
            files += [Path(scratch) / f"{name}{codec.suffix}", Path(scratch) / f"{name}.json"]
            encode_file(video, files[-2], codec, 28)
            measured = measure_file(files[-2], video)
            files[-1].write_text(json.dumps(measured["per_frame"]), encoding="utf-8")
        return _digest(files)


def _codec(*options: object, **num_frames: int) -> Callable[[Path], str]:
    """Code rendered scenes, decode them, and digest both streams, all frames and the anchors."""

    def _run(folder: Path) -> str:
        for scene, frames in num_frames.items():
            video, stream, punctured = (folder / f"{scene}{end}" for end in (".mkv", ".dvc", "-small.dvc"))
            sizes = "--size", _CODED_SIZE, "--frames", frames
            run_module("sequences", "render", scene, *sizes, "--out", video)
            run_module("encoder", video, stream, *options, "--quiet")
            files = [] if "--no-feedback" in options else ["--punctured", punctured]
            run_module("decoder", stream, folder / f"{scene}.y4m", *files, "--quiet")
        return _digest(folder.iterdir()) + anchors()[:8]

    return _run


def _stereo(folder: Path) -> str:
    toy, out = folder / "toy", folder / "out"
    run_module("sequences", "render", "toy", "--size", _SIZE, "--out", toy)
    words = ["reconstruct", *sorted(toy.glob("toy-*.png"))]
    run_module("dvc.stereo", *words, "--cameras", toy / "cameras.json", "--out", out, "--quiet")
    return _digest(out.glob("*.pfm"))


def _texture_depth(folder: Path) -> str:
    toy = folder / "toy"
    run_module("sequences", "render", "toy", "--size", _SIZE, "--out", toy)
    views = sorted(toy.glob("toy-*.png"))
    for method in ("l", "s", "quadtree"):
        words = ["encode", *views, folder / f"{method}.dibr", "--cameras", toy / "cameras.json"]
        run_module("dvc.dibr", *words, "--depths", "2:8", "--bpp", "1.0", "--disparity", method, "--quiet")
    return _digest(folder.glob("*.dibr"))


def _depth_map(folder: Path) -> str:
    import numpy as np

    from dvc.picture_files import write_pfm

    rows, columns = np.mgrid[0:80, 0:96]
    inside = (rows - 40) ** 2 + (columns - 50) ** 2 < 900
    write_pfm(folder / "map.pfm", np.where(inside, 40.0 + 0.1 * columns, 5.0).astype(np.float32))
    for transform in ("shape-adaptive", "standard"):
        words = ["encode", folder / "map.pfm", folder / f"{transform}.dibr", "--bpp", "0.3"]
        run_module("dvc.dibr", *words, "--transform", transform, "--quiet")
    return _digest(folder.glob("*.dibr"))


CANARIES: dict[str, Callable[[Path], str]] = {
    # By default groups of street end with key frames; of stairway none does, and the last has a single frame.
    "default": _codec("--qp", 30, street=25, stairway=34),
    "no-feedback": _codec("--qp", 30, "--no-feedback", street=25, stairway=25),
    "2d": _codec("--qp", 30, "--codec", "2d", street=9),
    "matrices": _codec("--wz-q", 3, "--luma-only", street=9),
    "stereo": _stereo,
    "texture-depth": _texture_depth,
    "depth-map": _depth_map,
}
"""Canaries by configuration."""


@cache
def canary(name: str) -> str:
    """Run a configuration, in seconds."""
    with tempfile.TemporaryDirectory() as folder:
        return CANARIES[name](Path(folder))
