"""Extensions: names that other packages register are found, tested, and written into streams."""

import os
import pickle
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import decoder.__main__
import encoder.__main__
from decoder.side_information.methods import METHODS
from dvc import extensions
from dvc.config import CODERS, VideoConfig, codec_config, decode_config, encode_config
from dvc.dibr.disparity.square_codecs import BlockCodec
from dvc.dibr.view_encoder import ViewEncoder
from dvc.dibr.view_set import views_of_pictures
from dvc.errors import ConfigError
from dvc.geometry.camera_array import DisparityLabels, LatticePosition
from dvc.geometry.label_inference import SemiGlobal
from dvc.slepian_wolf import plane_coder
from dvc.stereo.surfaces.stereo_settings import StereoSettings
from tests.clips import moving_texture, write_clip

MODULE = """
from decoder.side_information.block_motion import BlockMotionInterpolation
from dvc.config import CascadeConfig
from dvc.slepian_wolf.cascade.cascade_coder import CascadeCoder


def still(config):
    return BlockMotionInterpolation()


def hasty(seed):
    return CascadeCoder(CascadeConfig(30), seed)


def hopeless(*arguments):
    raise OSError("no weights")
"""
ENTRY_POINTS = """
[dvc3d.side_information]
still = made_up_blocks:still
hopeless = made_up_blocks:hopeless
mci = made_up_blocks:still
Not A Name = made_up_blocks:still
broken = made_up_blocks:missing
[dvc3d.plane_coders]
hasty = made_up_blocks:hasty
hopeless = made_up_blocks:hopeless
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the files of an installed package with extensions of both kinds."""
    folder = tmp_path_factory.mktemp("installed")
    (folder / "made_up_blocks.py").write_text(MODULE)
    data = folder / "made_up-1.0.dist-info"
    data.mkdir()
    (data / "METADATA").write_text("Metadata-Version: 2.1\nName: made-up\nVersion: 1.0\n")
    (data / "entry_points.txt").write_text(ENTRY_POINTS)
    return folder


@pytest.fixture
def extended(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Put that package on the path."""
    monkeypatch.syspath_prepend(folder)
    extensions.installed.cache_clear()
    yield
    monkeypatch.undo()
    extensions.installed.cache_clear()
    sys.modules.pop("made_up_blocks", None)


@pytest.mark.usefixtures("extended")
def test_names_are_listed_without_an_import(capsys: pytest.CaptureFixture[str]) -> None:
    for main in (encoder.__main__.main, decoder.__main__.main):
        with pytest.raises(SystemExit):
            main(["--help"])
    text = "".join(capsys.readouterr().out.split())
    assert "{cascade,turbo,hasty,hopeless}" in text
    assert "(mci,blocks,mesh,depth,fused,broken,hopeless,still)" in text
    assert "made_up_blocks" not in sys.modules


@pytest.mark.usefixtures("extended")
def test_registered_extensions_are_used() -> None:
    config = codec_config(VideoConfig(64, 48, 25, 1), coder=CODERS["hasty"]())
    assert config.coder.name == "hasty"
    assert plane_coder(config).by_positions
    assert type(METHODS["still"](config)).__name__ == "BlockMotionInterpolation"
    assert METHODS["mci"].__module__ == "decoder.side_information.methods"
    assert decode_config(encode_config(config)) == config
    assert pickle.loads(pickle.dumps(config)) == config


@pytest.mark.usefixtures("extended")
def test_unusable_extensions_are_named() -> None:
    """The message names the package and the reason for any exception of the extension."""
    config = codec_config(VideoConfig(64, 48, 25, 1), coder=CODERS["hopeless"]())
    with pytest.raises(ConfigError, match="extension 'broken' of made-up cannot be imported"):
        METHODS["broken"]
    for make in (METHODS["hopeless"], plane_coder):
        with pytest.raises(ConfigError, match="'hopeless' of made-up cannot be made: OSError: no weights"):
            make(config)


def run(module: str, *words: str, path: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a program, with a folder on the path of Python."""
    environment = os.environ | ({} if path is None else {"PYTHONPATH": str(path)})
    command = [sys.executable, "-m", module, *words]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=250, check=False)


@pytest.mark.parametrize(
    ("encoding", "decoding", "needed"),
    [
        (["--coder", "hasty"], [], "plane coder 'hasty' is not installed; available: cascade, turbo"),
        ([], ["--side-information", "still"], "side information 'still' is not installed; available: mci, "),
    ],
)
def test_streams_name_their_extensions(
    encoding: list[str], decoding: list[str], needed: str, folder: Path, tmp_path: Path
) -> None:
    """A decoder with the extension decodes; one without it ends in a line that names it."""
    clip = str(write_clip(tmp_path / "clip.mkv", moving_texture(3, 32, 48)))
    stream, small, output = (str(tmp_path / name) for name in ("a.dvc", "small.dvc", "out.mkv"))
    coded = run("encoder", clip, stream, "--codec", "2d", "--qp", "40", "--quiet", *encoding, path=folder)
    assert coded.returncode == 0, coded.stderr
    decoded = run("decoder", stream, output, "--punctured", small, "--quiet", *decoding, path=folder)
    assert decoded.returncode == 0, decoded.stderr
    refused = run("decoder", small, str(tmp_path / "again.mkv"), "--quiet")
    assert refused.returncode == 2
    assert needed in refused.stderr
    assert refused.stderr.count("\n") == 1
    assert not (tmp_path / "again.mkv").exists()


def test_other_methods_are_passed_as_objects() -> None:
    """Inference of labels by the settings, a codec of disparities by the encoder; wrong maps are refused."""

    class _Tiny(BlockCodec):
        def optimise(self, tensor: np.ndarray, *options: object) -> object:
            return super().optimise(tensor[:8, :8], *options)  # type: ignore[arg-type]

    inference = SemiGlobal()
    assert StereoSettings(inference=inference).inference_method(0, 1.0) is inference
    frame = moving_texture(1, 24, 40)[0].luma
    pictures = [np.repeat(frame[:, k : k + 32, None], 3, axis=2) for k in (0, 2)]
    views = views_of_pictures(pictures, [LatticePosition(0.0, 0.0), LatticePosition(1.0, 0.0)])
    encoder = ViewEncoder(views, DisparityLabels(0.0, 1.0, 5), "blocks", codec=_Tiny())
    with pytest.raises(ConfigError, match="disparity codec 'blocks': expected a label from 0 to 4 for each"):
        encoder.encode(1e-3)


def test_contracts_of_installed_extensions(folder: Path, tmp_path: Path) -> None:
    words = ["-q", "-p", "no:cacheprovider", "--rootdir", str(tmp_path), "--pyargs", "dvc.contracts", "-k"]
    good = run("pytest", *words, "(still and constant) or (hasty and sure) and not hopeless", path=folder)
    assert good.returncode == 0, good.stdout
    assert run("pytest", *words, "broken and constant", path=folder).returncode == 1
    named = run("pytest", *words, "can_be_in_streams", path=folder)
    assert named.returncode == 1
    assert "['Not A Name'] do not match" in named.stdout
