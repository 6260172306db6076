"""Tables, specifications and results of experiments, clouds of points, tokens; their readers."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.hostile.files import Files, written
from dvc.array_files import read_positions
from dvc.feedback.protection import MIN_TOKEN_BYTES, read_token
from dvc.rd.points_csv import import_points
from dvc.rd.rd_results import read_results
from dvc.rd.specification import build_sweep, expand, read_spec

_SPEC = """[defaults]
sequences = ["box", "desk"]
frames = 9
[[sweep]]
qp = "22-34:4"
no_feedback = true
options = {coder = "turbo", key-frames = "predicted"}
[[sweep]]
wz_q = [1, 4]
key_qp = "28"
anchors = ["x264-medium"]
"""
_POINTS = """# measured elsewhere
sequence,codec,point,qp,rate_kbps,psnr_y_db,width,height,frames_per_s,frames,first_frame,luma_only
foreman,other,"Q1, key",40,47.7,27.93,176,144,15,150,0,true
foreman,other,Q2,36,61.5,29.1,176,144,15,150,0,true
"""
_LATTICE = "file,m,n\na.png,0,0\nb.png,1,0.5\n"


@cache
def good_tables() -> tuple[Files, ...]:
    """Return positions, imported points, a specification, a result, and a token."""
    made = written(lambda folder: _import(folder, _POINTS))
    name, result = next(iter(made.items()))
    return (
        {"lattice.csv": _LATTICE.encode()},
        {"points.csv": _POINTS.encode()},
        {"sweep.toml": _SPEC.encode()},
        {name: result},
        {"token": b"a token of some length\n"},
    )


def _import(folder: Path, text: str) -> None:
    """Leave the results of points in a folder."""
    (folder / "in.csv").write_text(text, encoding="utf-8")
    import_points(folder / "in.csv", folder)
    (folder / "in.csv").unlink()
    for path in (folder / "points").iterdir():
        path.rename(folder / path.name)


def read_tables(folder: Path) -> bool:
    """Read the one that is there."""
    (path,) = folder.iterdir()
    return _READERS.get(path.name, _read_result)(path)


def _read_result(path: Path) -> bool:
    (path.parent / "points").mkdir()
    path.rename(path.parent / "points" / path.name)
    return all(np.isfinite(result.rate_kbps) for result in read_results(path.parent))


_READERS: dict[str, Callable[[Path], bool]] = {
    "lattice.csv": lambda path: bool(np.isfinite(list(read_positions(path).values())).all()),
    "points.csv": lambda path: len(import_points(path, path.parent)) > 0,
    "sweep.toml": lambda path: len(expand([build_sweep(sweep) for sweep in read_spec(path)])) > 0,
    "token": lambda path: len(read_token(path)) >= MIN_TOKEN_BYTES,
}
