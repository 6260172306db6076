"""Files that commands read: good ones, damage to one of several in a folder, and their readers."""

import json
import re
import tempfile
from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.hostile.depth_streams import good_pieces
from benchmarks.hostile.material import material
from benchmarks.hostile.mutations import Change, mutate, mutate_record
from dvc.array_files import read_positions
from dvc.bits import decode_bytes, encode_varint
from dvc.dibr.depth_image.depth_image_stream import read_depth_map
from dvc.dibr.depth_image.piece_stream import decode, decode_stream
from dvc.dibr.depth_image.scene_pieces import read_pieces, write_pieces
from dvc.errors import DvcError
from dvc.feedback.protection import MIN_TOKEN_BYTES, read_token
from dvc.files import PARTIAL_SUFFIX
from dvc.geometry.camera_array import (
    ArrayView,
    CameraArray,
    DisparityLabels,
    LatticePosition,
    Reconstruction,
    Surface,
)
from dvc.geometry.camera_files import load_cameras
from dvc.images.edge_maps import EdgeMaps
from dvc.images.edge_selection import read_edges, write_edges
from dvc.picture_files import read_picture, write_pfm, write_png
from dvc.rd.points_csv import import_points
from dvc.rd.rd_results import read_results
from dvc.rd.specification import build_sweep, expand, read_spec
from dvc.stereo.surfaces.surface_folder import INDEX, read_reconstruction, write_reconstruction
from dvc.stream.reader import open_stream
from dvc.video import open_video

Planes = NDArray[np.uint8]
Files = dict[str, bytes]
"""Contents by name."""
_WORD = re.compile(rb"-?\d[\d.eE+-]*|\btrue\b|\bfalse\b|\bnull\b|\"[^\"\n]*\"")
_ODD = (*b"0 -1 1e308 -1e308 1e-308 NaN inf 65536 2147483648 null true".split(), b"9" * 40, b'""', b'"../x"')
_ODD += (b"[]", b"{}", b"[" * 40 + b"]" * 40, b'"\\ud800"', b'"\\u0000"')


def mutate_text(data: bytes, rng: np.random.Generator) -> bytes:
    """Replace a number or a quoted word, or damage bytes."""
    words = list(_WORD.finditer(data))
    if not words or rng.random() < 0.4:
        return mutate(data, rng)
    word = words[int(rng.integers(len(words)))]
    return data[: word.start()] + _ODD[int(rng.integers(len(_ODD)))] + data[word.end() :]


def damaged_files(good: Sequence[Files], number: int, change: Change = mutate_text) -> bytes:
    """Return the names and contents of files with damage in one of them."""
    rng, files = np.random.default_rng(number), dict(good[number % len(good)])
    chosen = sorted(files)[int(rng.integers(len(files)))]
    files[chosen] = change(files[chosen], rng)
    parts = [part for name, data in files.items() for part in (name.encode(), data)]
    return b"".join(encode_varint(len(part)) + part for part in parts)


def try_files(read: Callable[[Path], bool], damaged: bytes) -> str:
    """Write files into a folder, and return the outcome of a reader, which checks its result."""
    with tempfile.TemporaryDirectory() as folder:
        position = 0
        while position < len(damaged):
            name, position = decode_bytes(damaged, position)
            data, position = decode_bytes(damaged, position)
            (Path(folder) / name.decode()).write_bytes(data)
        try:
            if read(Path(folder)):
                return "decoded"
            return "the result is not finite, or differs from its declaration"
        except (DvcError, OSError):
            return "refused"


def written(write: Callable[[Path], object]) -> Files:
    """Return the files that a function writes into a folder."""
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder))
        return {path.name: path.read_bytes() for path in sorted(Path(folder).iterdir()) if path.is_file()}


_NAMES = "a.png", "b.png"
_PICTURE = np.zeros((120, 160), np.uint8)
_MATRIX = [[150.0, 0.0, 80.0], [0.0, 150.0, 60.0], [0.0, 0.0, 1.0]]
_CAMERAS = [
    {"file": name, "K": _MATRIX, "R": np.eye(3).tolist(), "t": [-float(k), 0.0, 0.0], "distortion": [0.02]}
    for k, name in enumerate(_NAMES)
]
_MIDDLEBURY = """cam0=[150 0 80; 0 150 60; 0 0 1]
cam1=[150 0 82; 0 150 60; 0 0 1]
doffs=2.0
baseline=193.0
width=160
height=120
ndisp=64
"""
_COLMAP = {
    "cameras.txt": "1 SIMPLE_RADIAL 160 120 150 80.5 60.5 0.02\n",
    "images.txt": "1 1 0 0 0 0 0 0 1 a.png\n80 60 1\n2 1 0 0 0 -1 0 0 1 b.png\n82 60 1\n",
    "points3D.txt": "1 0.5 0.25 7 0 0 0 0.1 1 0 2 0\n",
    "rigs.txt": "1 1 CAMERA 1\n",
    "frames.txt": "1 1 1 0 0 0 0 0 0 1 CAMERA 1 1\n2 1 1 0 0 0 -1 0 0 1 CAMERA 1 2\n",
}


@cache
def good_cameras() -> tuple[Files, ...]:
    """Return good inputs: the files of each."""
    colmap = {name: text.encode() for name, text in _COLMAP.items()}
    json_file = json.dumps({"cameras": _CAMERAS, "points": [[0.5, 0.25, 7.0]]}).encode()
    return {"cameras.json": json_file}, {"calib.txt": _MIDDLEBURY.encode()}, colmap


def read_cameras(folder: Path) -> bool:
    """Read cameras, and return whether they are finite."""
    paths = list(folder.iterdir())
    views = load_cameras(paths[0] if len(paths) == 1 else folder, _NAMES, [_PICTURE] * len(_NAMES))
    matrices = [(view.K, view.R, view.t) for view in views.cameras]
    return all(np.isfinite(matrix).all() for camera in matrices for matrix in camera)


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
    """Read the only file."""
    (path,) = folder.iterdir()
    if path.name in _TABLE_READERS:
        return _TABLE_READERS[path.name](path)
    (folder / "points").mkdir()
    path.rename(folder / "points" / path.name)
    return all(np.isfinite(result.rate_kbps) for result in read_results(folder))


_TABLE_READERS: dict[str, Callable[[Path], bool]] = {
    "lattice.csv": lambda path: bool(np.isfinite(list(read_positions(path).values())).all()),
    "points.csv": lambda path: len(import_points(path, path.parent)) > 0,
    "sweep.toml": lambda path: len(expand([build_sweep(sweep) for sweep in read_spec(path)])) > 0,
    "token": lambda path: len(read_token(path)) >= MIN_TOKEN_BYTES,
}


_SHAPE = 18, 26


@cache
def good_maps() -> tuple[Files, ...]:
    """Return a float map, one of 16 bits, a picture in colour, and edges."""
    rng = np.random.default_rng(2)
    levels, colours = rng.integers(0, 2**16, _SHAPE, np.uint16), rng.integers(0, 256, (*_SHAPE, 3), np.uint8)
    rows, columns = (rng.integers(0, 2, _SHAPE, np.uint8) for _ in range(2))

    def _png(name: str) -> Callable[[Path], object]:
        picture = np.asarray(levels if name == "map.png" else colours)
        return lambda folder: write_png(folder / name, picture)

    rows[-1], columns[:, -1] = 0, 0
    return (
        written(lambda folder: write_pfm(folder / "map.pfm", levels.astype(np.float32))),
        written(_png("map.png")),
        written(_png("colours.png")),
        written(lambda folder: write_edges(folder / "edges.png", EdgeMaps(rows, columns))),
    )


def read_maps(folder: Path) -> bool:
    """Read the only file."""
    (path,) = folder.iterdir()
    if path.stem == "map":
        return bool(np.isfinite(read_depth_map(path, 0.0).depth).all())
    if path.stem == "edges":
        return read_edges(path, _SHAPE).shape == _SHAPE
    return read_picture(path).shape[2:] == (3,)


@cache
def good_folders() -> tuple[Files, ...]:
    """Return layers, sprites, and a reconstruction."""
    rng = np.random.default_rng(4)
    pieces = [decode(decode_stream(data)) for data in good_pieces()]
    views, surfaces = [], []
    for m in range(2):
        image, valid = rng.integers(0, 256, (*_SHAPE, 3), np.uint8), rng.random(_SHAPE) < 0.9
        views.append(ArrayView(f"{m}", image, LatticePosition(float(m), 0.0), valid if m else None))
        disparity = rng.uniform(0.0, 5.0, _SHAPE).astype(np.float32)
        surfaces.append(Surface(disparity, ~valid, valid.astype(np.float32)))
    whole = Reconstruction(CameraArray(tuple(views)), DisparityLabels(0.0, 1.0, 6), tuple(surfaces), {})
    return (
        *(written(lambda folder, one=one: write_pieces(folder, one.scene)) for one in pieces[1:]),  # type: ignore[misc]
        written(lambda folder: write_reconstruction(folder, whole)),
    )


def read_folders(folder: Path) -> bool:
    """Read layers or a reconstruction."""
    if (folder / INDEX).exists():
        return all(np.isfinite(surface.disparity).all() for surface in read_reconstruction(folder).surfaces)
    return all(np.isfinite(piece.disparity).all() for piece in read_pieces(folder).pieces)


@cache
def good_videos() -> tuple[Files, ...]:
    """Return frames as YUV4MPEG2, raw, and as pictures."""
    height, width = _SHAPE
    planes = np.random.default_rng(8).integers(16, 236, (3, height * width * 3 // 2), np.uint8)
    head = f"YUV4MPEG2 W{width} H{height} F25:1 Ip A1:1 C420jpeg\n".encode()
    pictures = planes[:, : height * width].reshape(3, height, width)
    return (
        {"frames.y4m": head + b"".join(b"FRAME\n" + plane.tobytes() for plane in planes)},
        {"frames.yuv": planes.tobytes()},
        written(lambda folder: _write_pictures(folder, pictures)),
    )


def _write_pictures(folder: Path, pictures: Planes) -> None:
    for number, picture in enumerate(pictures):
        write_png(folder / f"{number}.png", picture)


def read_videos(folder: Path) -> bool:
    """Read all frames, and return whether they have the declared size."""
    paths = sorted(folder.iterdir())
    size = {"size": (_SHAPE[1], _SHAPE[0]), "frame_rate": Fraction(25)} if paths[0].suffix == ".yuv" else {}
    with open_video(folder if len(paths) > 1 else paths[0], **size) as video:  # type: ignore[arg-type]
        shape = video.info.height, video.info.width
        return all(frame.luma.shape == shape for frame in video)


@cache
def good_recordings() -> tuple[Files, ...]:
    """Return segments of both forms, the last one unfinished."""
    made = material()
    return tuple(
        {"1.dvc": stream, "2.dvc": stream, f"3.dvc{PARTIAL_SUFFIX}": stream[: 2 * len(stream) // 3]}
        for stream in (made.buffered, made.punctured)
    )


def mutate_segment(data: bytes, rng: np.random.Generator) -> bytes:
    """Damage a record, the index as well, and mend its checksum; or damage bytes."""
    try:
        return mutate_record(data, rng) if rng.random() < 0.7 else mutate_text(data, rng)
    except IndexError:  # the segment that is unfinished
        return mutate_text(data, rng)


def read_recordings(folder: Path) -> bool:
    """Read all groups, then only the last one, of a recording and of its first segment."""
    for path in (folder, folder / "1.dvc"):
        for unfinished in (True, False):
            with open_stream(str(path), unfinished=unfinished) as reader:
                num_frames = sum(record.num_frames for record in reader)
                if num_frames > 2**16 or (reader.missing is None and num_frames != reader.index.num_frames):
                    return False
                reader.seek_gop(max(len(reader.index.entries) - 1, 0))
                list(reader)
    return True
