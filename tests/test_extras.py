"""A camera needs few packages; other commands name the extra that they require."""

import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

from dvc.picture_files import write_png
from dvc.video import Frame
from tests.clips import write_clip

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
OTHERS = ["distributed", "jinja2", "matplotlib", "plotly", "pycolmap", "scipy", "skimage", "trimesh"]
WITHOUT_OTHERS = f"""
import sys
sys.modules.update(dict.fromkeys({OTHERS!r}))
from {{module}} import main
sys.exit(main({{words!r}}))
"""
COMMANDS = {
    "sfm.__main__": (["clip.y4m", "--out", "map"], "decode"),
    "dvc.stereo.__main__": (
        ["reconstruct", "a.png", "b.png", "--disparities", "0:2", "--out", "c"],
        "stereo",
    ),
}


def run_without_others(module: str, words: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a command as if packages that a camera does not need were not installed."""
    code = f"import sys; sys.path.insert(0, {str(ROOT)!r})\n" + WITHOUT_OTHERS.format(
        module=module, words=words
    )
    return subprocess.run(
        [sys.executable, "-c", code], check=False, capture_output=True, text=True, cwd=folder
    )


@pytest.mark.parametrize("delivery", [[], ["--no-feedback"]], ids=["all parity", "no feedback"])
def test_a_camera_codes_with_its_own_packages(
    delivery: list[str], moving_frames: Callable[..., list[Frame]], tmp_path: Path
) -> None:
    clip = write_clip(tmp_path / "clip.y4m", moving_frames(6, 96, 80))
    streams = tmp_path / "without.dvc", tmp_path / "with.dvc"
    words = [str(clip), "--quiet", *delivery]
    done = run_without_others("encoder.__main__", [*words, str(streams[0])], tmp_path)
    assert done.returncode == 0, done.stderr
    subprocess.run([sys.executable, "-m", "encoder", *words, str(streams[1])], check=True)
    assert streams[0].read_bytes() == streams[1].read_bytes()


@pytest.mark.parametrize("module", COMMANDS)
def test_other_commands_say_what_they_need(
    module: str, moving_frames: Callable[..., list[Frame]], tmp_path: Path
) -> None:
    words, extra = COMMANDS[module]
    write_clip(tmp_path / "clip.y4m", moving_frames(3, 64, 48))
    for name in ("a.png", "b.png"):
        write_png(tmp_path / name, moving_frames(1, 64, 48)[0].luma)
    done = run_without_others(module, words, tmp_path)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert any(f": needs {name}: pip install 'dvc3d[{extra}]'" in line for name in OTHERS)
    assert run_without_others(module, ["--help"], tmp_path).stdout.startswith("usage: ")


def test_a_camera_needs_few_packages() -> None:
    assert len(PROJECT["dependencies"]) <= 6
    assert PROJECT["optional-dependencies"]["all"] == ["dvc3d[dask,decode,mesh,report,stereo]"]
