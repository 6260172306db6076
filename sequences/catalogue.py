"""The catalogue: every sequence with a name, its source and its purpose."""

import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

from dvc.errors import ConfigError, DvcError
from dvc.video import open_video
from sequences.scene_layouts import VIDEO_SCENES
from sequences.scenery import Description

SUFFIXES = frozenset({".mkv", ".y4m", ".mp4", ".avi", ".mov", ".webm", ".m4v", ".mpg"})


@dataclass(frozen=True)
class Remarks:
    """Facts about a video that its file does not declare."""

    static: str  # whether only the camera moves: ``"yes"``, ``"no"``, ``"uncertain"`` or ``"unknown"``
    shows: str  # one sentence each
    motion: str
    purpose: str
    # mean, smallest and largest frame mean of tracked motion in pixels per frame
    motion_px: tuple[float, float, float] | None = None


DESCRIBED: dict[str, Remarks] = {
    "stone": Remarks(
        "yes",
        "a stone pillar with a sign",
        "fast, a full circle on foot round the pillar",
        "hard case: motion far above the usual range, large occlusions",
        (13.03, 4.14, 20.54),
    ),
    "tree": Remarks(
        "yes",
        "a tree trunk in snow",
        "fast, on foot round the trunk",
        "hard case: large motion, bright surfaces with little texture",
        (7.37, 3.22, 14.18),
    ),
    "desk": Remarks(
        "yes",
        "a desk with a cube, a figurine and a board",
        "hand-held, uneven, in places almost none",
        "ordinary indoor case; exposure and white balance drift half way, some motion blur",
        (2.70, 0.02, 8.41),
    ),
    "box": Remarks(
        "yes",
        "a printed box on a desk, close",
        "hand-held, slow",
        "easy case: much texture, few depths, small motion",
        (1.15, 0.34, 3.02),
    ),
    "river": Remarks(
        "yes",
        "a wooded gorge with a river, from far above; only the water moves",
        "a slow sweep, almost a pure rotation",
        "degenerate geometry: hardly any parallax to reconstruct from",
        (1.50, 0.63, 2.76),
    ),
    "cube": Remarks(
        "uncertain",
        "a patterned cube on a round table before a blank background, grey",
        "cube and table turn against the background, or the camera round them",
        "two rigid motions or one; no evidence for the static case",
        (1.62, 0.02, 4.19),
    ),
    "foreman_qcif15": Remarks(
        "no",
        "a man who talks to a hand-held camera, QCIF, from an H.264 copy",
        "the subject moves and speaks, a pan near the end",
        "the fall-back to 2D motion; figures are not comparable with those on the original",
    ),
}
USER_MATERIAL = Remarks("unknown", "user material", "not described", "user material")


@dataclass(frozen=True)
class Entry:
    """A row of the catalogue."""

    name: str
    kind: str  # ``"rendered"`` or ``"file"``
    width: int  # size in pixels; the default one of a rendered scene, 0 for a file that cannot be read
    height: int
    frame_rate: Fraction  # frames per second
    num_frames: int | None  # length, if the file declares it
    path: str | None  # video file
    about: Remarks

    def to_dict(self) -> dict[str, Any]:
        """Return the entry as plain values for JSON."""
        flat = asdict(self)
        about = flat.pop("about")
        return {**flat, "frame_rate": str(self.frame_rate), "fps": float(self.frame_rate), **about}


def data_folder() -> Path | None:
    """Return the folder of video files: ``$DVC_DATA``, else ``../shared/sequences`` next to the project."""
    named = os.environ.get("DVC_DATA")
    if named:
        if not Path(named).is_dir():
            raise ConfigError(f"$DVC_DATA is {named!r}, which is not a folder")
        return Path(named)
    folder = Path(__file__).resolve().parents[2] / "shared" / "sequences"
    return folder if folder.is_dir() else None


def files() -> dict[str, Path]:
    """Return the video files of the data folder by name (the file name without its suffix), sorted."""
    folder = data_folder()
    if folder is None:
        return {}
    paths = sorted(p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES and p.is_file())
    stems = [path.stem for path in paths]
    return {path.stem if stems.count(path.stem) == 1 else path.name: path for path in paths}


def entries() -> list[Entry]:
    """List the rendered scenes, then the files of the data folder."""
    scenes = [_rendered_entry(scene) for scene in VIDEO_SCENES.values()]
    taken = {entry.name for entry in scenes}
    return scenes + [
        _file_entry(path.name if name in taken else name, path) for name, path in files().items()
    ]


def _rendered_entry(scene: Description) -> Entry:
    """Return the entry of a rendered scene."""
    about = Remarks("yes", scene.shows, scene.motion, scene.purpose, scene.motion_px)
    return Entry(scene.name, "rendered", 352, 288, scene.frame_rate, scene.num_frames, None, about)


def _file_entry(name: str, path: Path) -> Entry:
    """Return the entry of a video file; for an unreadable one, its purpose is the error."""
    import av

    about = DESCRIBED.get(path.stem, USER_MATERIAL)
    try:
        with open_video(path) as reader:
            info = reader.info
    except DvcError as err:
        about = Remarks("unknown", "unreadable", "not described", str(err))
        return Entry(name, "file", 0, 0, Fraction(0), None, str(path), about)
    num_frames = info.num_frames
    if not num_frames:  # count the coded pictures without decoding them, if the container permits
        with suppress(av.error.FFmpegError, IndexError, OSError), av.open(str(path)) as container:
            stream = container.streams.video[0]
            num_frames = sum(1 for packet in container.demux(stream) if packet.size)
    return Entry(name, "file", info.width, info.height, info.frame_rate, num_frames, str(path), about)


def resolve(name_or_path: str | Path) -> Path | Description:
    """Resolve a name to a scene or a file; with a suffix an existing file comes before the data folder."""
    name = str(name_or_path)
    if not isinstance(name_or_path, Path) and name in VIDEO_SCENES:
        return VIDEO_SCENES[name]
    if Path(name).suffix and Path(name).exists():
        return Path(name)
    available = files()
    if not isinstance(name_or_path, Path):
        for stem, path in available.items():
            if name in (stem, path.name):
                return path
    if Path(name).exists():
        return Path(name)
    names = ", ".join([*VIDEO_SCENES, *available])
    raise ConfigError(f"{name!r} is neither a file nor a sequence; the sequences are {names}")


def entry(name_or_path: str | Path) -> Entry:
    """Return the entry of a name or path."""
    resolved = resolve(name_or_path)
    if isinstance(resolved, Description):
        return _rendered_entry(resolved)
    open_video(resolved).close()
    return _file_entry(resolved.stem, resolved)


FIELDS: tuple[tuple[str, Callable[[Entry], str]], ...] = (
    ("name", lambda e: e.name),
    ("kind", lambda e: e.kind),
    ("size", lambda e: f"{e.width}x{e.height}"),
    ("fps", lambda e: f"{float(e.frame_rate):.5g}"),
    ("frames", lambda e: "?" if e.num_frames is None else str(e.num_frames)),
    ("static scene", lambda e: e.about.static),
    ("shows", lambda e: e.about.shows),
    ("motion", lambda e: e.about.motion),
    (
        "px/frame",
        lambda e: "{:.1f} ({:.1f}..{:.1f})".format(*e.about.motion_px) if e.about.motion_px else "?",
    ),
    ("purpose", lambda e: e.about.purpose),
)
