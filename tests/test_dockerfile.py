"""The images of camera and receiver: their steps, run as scripts, give programs that work."""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from dvc.video import Frame, open_video
from tests.clips import write_clip

ROOT = Path(__file__).resolve().parents[1]
NUM_FRAMES = 4


@dataclass
class Stage:
    """A stage of a Dockerfile: an environment of its own, and a folder in place of the root."""

    root: Path
    folder: Path = field(init=False)
    entry_point: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.folder = self.root
        subprocess.run([sys.executable, "-m", "venv", self.root / "venv"], check=True)

    def run(self, words: Sequence[object], folder: Path | None = None) -> subprocess.CompletedProcess[str]:
        """Run a program of the environment, in a home that nobody can write to."""
        path = os.pathsep.join([str(self.root / "venv" / "bin"), str(self.root / "bin"), os.environ["PATH"]])
        own = {"PATH": path, "HOME": str(self.root / "nothing"), "NUMBA_CACHE_DIR": str(self.root / "cache")}
        kept = {
            name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "NUMBA_"))
        }
        return subprocess.run(
            list(map(str, words)),
            cwd=folder or self.folder,
            env=kept | own,
            capture_output=True,
            text=True,
            check=False,
        )

    def at(self, path: str) -> Path:
        """Return what a path of the image is here."""
        return self.root / path.lstrip("/") if path.startswith("/") else self.folder / path


def steps() -> list[tuple[str, str]]:
    """Return the instructions of the Dockerfile and their arguments."""
    text = (ROOT / ".ci" / "Dockerfile").read_text(encoding="utf-8").replace("\\\n", " ")
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    return [(line.split()[0], line.partition(" ")[2].strip()) for line in lines]


def copy(stages: dict[str, Stage], stage: Stage, arguments: str) -> None:
    """Copy what another stage made, or the files of the repository."""
    *options, source, target = arguments.split()
    if options:
        other = stages[options[0].removeprefix("--from=")]
        shutil.copytree(other.at(source), stage.at(target))
        return
    assert (source, target) == (".", ".")
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True)
    for name in filter(None, listed.stdout.split("\0")):
        (stage.folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, stage.folder / name)


def built(folder: Path) -> dict[str, Stage]:
    """Run all steps; users are made in name only."""
    stages, stage = dict[str, Stage](), None
    for instruction, arguments in steps():
        if instruction == "FROM":
            stage = stages.setdefault(arguments.split()[-1], Stage(folder / arguments.split()[-1]))
            (stage.root / "bin").mkdir()
            (stage.root / "bin" / "useradd").symlink_to(shutil.which("true") or "/bin/true")
            continue
        assert stage is not None
        match instruction:
            case "WORKDIR":
                stage.folder = stage.at(arguments)
                stage.folder.mkdir(parents=True)
            case "COPY":
                copy(stages, stage, arguments)
            case "RUN":
                done = stage.run(["sh", "-c", re.sub(r"(?<=\s)/(?=\w)", f"{stage.root}/", arguments)])
                assert done.returncode == 0, f"{arguments}\n{done.stderr[-2000:]}"
            case "ENTRYPOINT":
                stage.entry_point = json.loads(arguments)
            case _:
                assert instruction == "USER"
    return stages


def test_what_git_ignores_is_not_copied_into_images() -> None:
    ignored = (ROOT / ".gitignore").read_text(encoding="utf-8").split()
    found = {
        line.removeprefix("**/")
        for line in (ROOT / ".ci" / "Dockerfile.dockerignore").read_text(encoding="utf-8").split()
    }
    assert {name.removeprefix("/") for name in ignored} | {".git/"} <= found


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_images_code_and_decode(tmp_path: Path, moving_frames: Callable[..., list[Frame]]) -> None:
    """The receiver's image decodes a stream of the camera's; both compile nothing any more."""
    index = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--dest", tmp_path, "codespell"]
    if subprocess.run(index, capture_output=True, check=False).returncode != 0:
        pytest.skip("there is no package index")
    stages = built(tmp_path)
    clip = write_clip(tmp_path / "clip.y4m", moving_frames(NUM_FRAMES, 48, 64))
    stream, video = tmp_path / "clip.dvc", tmp_path / "decoded.y4m"
    for name, words in (("camera", (clip, stream)), ("receiver", (stream, video))):
        stage = stages[name]
        compiled = set((stage.root / "cache").rglob("*.nbc"))
        help_ = stage.run([*stage.entry_point, "--help"], tmp_path)
        assert help_.stdout.startswith("usage: dvc-")
        done = stage.run([*stage.entry_point, *words, "--quiet"], tmp_path)
        assert (done.returncode, done.stderr) == (0, "")
        assert compiled == set((stage.root / "cache").rglob("*.nbc")) != set()
    with open_video(video) as frames:
        assert len(list(frames)) == NUM_FRAMES
