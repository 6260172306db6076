"""A camera needs few packages; other commands say what they need besides."""

import subprocess
import sys
import tomllib
from collections.abc import Callable
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from dvc.extras import EXTRAS, of_an_extra
from dvc.video import Frame
from tests.clips import write_clip

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
OTHERS = sorted({*(name for modules in EXTRAS.values() for name in modules), "distributed", "trimesh"})
WITHOUT_OTHERS = f"""
import sys
sys.modules.update(dict.fromkeys({OTHERS!r}))
from {{module}} import main
sys.exit(main({{words!r}}))
"""
COMMANDS = {
    "decoder.__main__": (["a.dvc", "b.mkv"], "decode"),
    "sfm.__main__": (["a.png", "b.png", "--out", "c"], "decode"),
    "dvc.rd.__main__": (["report", "a", "--out", "b"], "report"),
    "dvc.stereo.__main__": (["sprites", "a", "--out", "b"], "stereo"),
    "dvc.dibr.__main__": (["info", "a"], "stereo"),
}


def run_without_others(module: str, words: list[str]) -> subprocess.CompletedProcess[str]:
    """Run a command as if packages that a camera does not need were not installed."""
    code = WITHOUT_OTHERS.format(module=module, words=words)
    return subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True, cwd=ROOT)


@pytest.mark.parametrize("delivery", [[], ["--no-feedback"]], ids=["all parity", "no feedback"])
def test_a_camera_codes_with_its_own_packages(
    delivery: list[str], moving_frames: Callable[..., list[Frame]], tmp_path: Path
) -> None:
    """To the same stream as with all others."""
    clip = write_clip(tmp_path / "clip.y4m", moving_frames(6, 96, 80))
    streams = tmp_path / "without.dvc", tmp_path / "with.dvc"
    words = [str(clip), "--quiet", *delivery]
    done = run_without_others("encoder.__main__", [*words, str(streams[0])])
    assert done.returncode == 0, done.stderr
    subprocess.run([sys.executable, "-m", "encoder", *words, str(streams[1])], check=True)
    assert streams[0].read_bytes() == streams[1].read_bytes()


def test_scenes_are_rendered_without_extras(tmp_path: Path) -> None:
    """The test material needs no other package."""
    words = ["render", "street", "--size", "32x24", "--frames", "1", "--out", str(tmp_path / "street.mkv")]
    done = run_without_others("sequences.__main__", words)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("module", COMMANDS)
def test_other_commands_say_what_they_need(module: str) -> None:
    """In one line, before they do anything; their help needs nothing."""
    words, extra = COMMANDS[module]
    done = run_without_others(module, words)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.endswith(f": needs {', '.join(EXTRAS[extra])}: pip install 'dvc3d[{extra}]'")
    assert run_without_others(module, ["--help"]).stdout.startswith("usage: ")


def test_extras_are_those_of_the_package() -> None:
    """Modules that are looked for are those of the packages that an extra brings; all brings all."""
    distributions = packages_distributions()
    listed = PROJECT["optional-dependencies"]
    for extra, modules in EXTRAS.items():
        assert sorted(distributions[name][0].lower() for name in modules) == sorted(
            required.split(">")[0] for required in listed[extra]
        )
    assert [of_an_extra(name) for name in ("scipy.linalg", "numpy", None)] == [True, False, False]
    assert listed["all"] == ["dvc3d[dask,decode,mesh,report,stereo]"]
    assert len(PROJECT["dependencies"]) <= 6
