"""Extensions: what other packages register is found by name, tested, and asked for by streams."""

import json
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
from decoder.side_information.methods import INTERPOLATORS, METHODS
from decoder.side_information.scene_interpolators import AveragedDepthInterpolator
from dvc import extensions
from dvc.config import CODERS, NOISE_MODELS, VideoConfig, codec_config, decode_config, encode_config
from dvc.dibr.disparity.methods import METHODS as DISPARITY_CODECS
from dvc.dibr.views.encoder import ViewEncoder
from dvc.dibr.views.views import views_of_pictures
from dvc.errors import ConfigError, DvcError
from dvc.geometry.camera_array import DisparityLabels, LatticePosition
from dvc.picture_files import write_png
from dvc.slepian_wolf import plane_coder
from dvc.stereo.surfaces.settings import StereoSettings
from dvc.wynerziv.noise import MODELS
from tests.clips import moving_texture, write_clip

MODULE = """
import numpy as np

from decoder.side_information.block_motion import BlockMotionInterpolation
from decoder.side_information.scene_interpolators import AveragedDepthInterpolator
from dvc.config import CascadeConfig
from dvc.dibr.disparity.blocks import BlockCodec
from dvc.geometry.volumes.inference import SemiGlobal
from dvc.slepian_wolf.cascade.cascade_coder import CascadeCoder
from dvc.wynerziv.noise import MODELS


def still(config):
    return BlockMotionInterpolation()


class Near(AveragedDepthInterpolator):
    name = "near"


def calm(residual):
    return MODELS["band"](residual)


def hasty(seed):
    return CascadeCoder(CascadeConfig(30), seed)


def hopeless(*arguments):
    raise OSError("no weights")


def unsure(residual):
    return np.full(residual.shape, np.nan)


class Tiny(BlockCodec):
    def _best(self, tensor, multiplier, known, distortion):
        return super()._best(tensor[:8, :8], multiplier, known, distortion)


Smooth = SemiGlobal
Squares = BlockCodec
"""
ENTRY_POINTS = """
[dvc3d.side_information]
still = made_up_blocks:still
hopeless = made_up_blocks:hopeless
mci = made_up_blocks:still
Not A Name = made_up_blocks:still
broken = made_up_blocks:missing
[dvc3d.scene_interpolators]
near = made_up_blocks:Near
[dvc3d.noise_models]
calm = made_up_blocks:calm
unsure = made_up_blocks:unsure
[dvc3d.plane_coders]
hasty = made_up_blocks:hasty
hopeless = made_up_blocks:hopeless
[dvc3d.inference]
hopeless = made_up_blocks:hopeless
smooth = made_up_blocks:Smooth
[dvc3d.disparity_codecs]
squares = made_up_blocks:Squares
hopeless = made_up_blocks:hopeless
tiny = made_up_blocks:Tiny
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write what an installer leaves of a package with an extension of each kind."""
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
def test_names_are_known_without_an_import(capsys: pytest.CaptureFixture[str]) -> None:
    """Help has the names; nothing of the extension is imported for that, nor to look for one of ours."""
    for main in (encoder.__main__.main, decoder.__main__.main):
        with pytest.raises(SystemExit):
            main(["--help"])
    told = "".join(capsys.readouterr().out.split())
    assert "{cascade,turbo,hasty,hopeless}" in told
    assert "{frame,band,coefficient,local,calm,unsure}" in told
    assert "(mci,blocks,mesh,depth,fused,broken,hopeless,still,near)" in told
    assert list(MODELS) == list(NOISE_MODELS)
    assert "near" in INTERPOLATORS
    assert "made_up_blocks" not in sys.modules


@pytest.mark.usefixtures("extended")
def test_what_is_registered_is_used() -> None:
    """Each kind is made as its group says; names of ours stay ours."""
    video = VideoConfig(64, 48, 25, 1)
    config = codec_config(video, coder=CODERS["hasty"](), wyner_ziv={"noise_model": "calm"})
    assert config.coder.name == "hasty"
    assert plane_coder(config).by_positions
    assert MODELS["calm"].__module__ == "made_up_blocks"
    assert type(METHODS["still"](config)).__name__ == "BlockMotionInterpolation"
    assert METHODS["mci"].__module__ == "decoder.side_information.methods"
    assert INTERPOLATORS["near"] is not AveragedDepthInterpolator
    assert type(DISPARITY_CODECS["squares"]).__name__ == "BlockCodec"
    assert type(StereoSettings(inference="smooth").inference_method(0, 1.0)).__name__ == "SemiGlobal"
    assert decode_config(encode_config(config)) == config
    assert pickle.loads(pickle.dumps(config)) == config


@pytest.mark.usefixtures("extended")
def test_extensions_that_cannot_be_imported_are_told() -> None:
    """The message names the package."""
    with pytest.raises(ConfigError, match="extension 'broken' of made-up cannot be imported"):
        METHODS["broken"]


@pytest.mark.usefixtures("extended")
def test_extensions_that_cannot_be_made_are_told() -> None:
    """As those that cannot be imported, whatever they raise."""
    config = codec_config(VideoConfig(64, 48, 25, 1), coder=CODERS["hopeless"]())
    for make in (
        lambda: METHODS["hopeless"](config),
        lambda: plane_coder(config),
        lambda: StereoSettings(inference="hopeless").inference_method(0, 1.0),
        lambda: DISPARITY_CODECS["hopeless"],
    ):
        with pytest.raises(ConfigError, match="'hopeless' of made-up cannot be made: OSError: no weights"):
            make()


def run(module: str, *words: str, path: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a program, with a folder on the path of Python."""
    environment = os.environ | ({} if path is None else {"PYTHONPATH": str(path)})
    command = [sys.executable, "-m", module, *words]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=250, check=False)


@pytest.mark.parametrize(
    ("encoding", "decoding", "needed"),
    [
        (["--coder", "hasty"], [], "plane coder 'hasty' is not installed; there are cascade, turbo"),
        (["--noise-model", "calm"], [], "noise model 'calm' is not installed; there are frame, band,"),
        ([], ["--side-information", "still"], "side information 'still' is not installed; there are mci, "),
    ],
)
def test_streams_say_what_they_need(
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


def test_streams_of_views_say_what_they_need(folder: Path, tmp_path: Path) -> None:
    """A decoder with the codec of disparities renders; one without it ends in a line that names it."""
    names = [str(tmp_path / name) for name in ("left.png", "right.png")]
    picture = moving_texture(1, 24, 40)[0].luma
    for name, shift in zip(names, (0, 2), strict=True):
        write_png(Path(name), picture[:, shift : shift + 32])
    stream, view = str(tmp_path / "pair.dibr"), str(tmp_path / "decoded")
    words = ["encode", *names, stream, "--disparities", "0:4", "--bpp", "2", "--disparity", "squares"]
    coded = run("dvc.dibr", *words, path=folder)
    assert coded.returncode == 0, coded.stderr
    told = run("dvc.dibr", "info", stream, "--json", "-", path=folder)
    assert json.loads(told.stdout)["disparity"] == "squares"
    assert run("dvc.dibr", "decode", stream, "--out", view, path=folder).returncode == 0
    refused = run("dvc.dibr", "decode", stream, "--out", str(tmp_path / "again"))
    assert refused.returncode == 2
    assert "disparity codec 'squares' is not installed; there are l, s, quadtree, blocks" in refused.stderr
    assert refused.stderr.count("\n") == 1


@pytest.mark.usefixtures("extended")
def test_extensions_that_return_nonsense_are_named() -> None:
    """Scales that are none, and maps that are too small."""
    with pytest.raises(DvcError, match=r"noise model 'unsure': expected a scale of at least 0\.3"):
        MODELS["unsure"](np.ones((16, 2, 3)))
    frame = moving_texture(1, 24, 40)[0].luma
    pictures = [np.repeat(frame[:, k : k + 32, None], 3, axis=2) for k in (0, 2)]
    views = views_of_pictures(pictures, [LatticePosition(0.0, 0.0), LatticePosition(1.0, 0.0)])
    encoder = ViewEncoder(views, DisparityLabels(0.0, 1.0, 5), "tiny")
    with pytest.raises(ConfigError, match="disparity codec 'tiny': expected a label from 0 to 4 for each"):
        encoder.encode(1e-3)


def test_contracts_of_what_is_installed(folder: Path, tmp_path: Path) -> None:
    """`pytest --pyargs dvc.contracts` tests each extension, and tells one that fails."""
    words = ["-q", "-p", "no:cacheprovider", "--rootdir", str(tmp_path), "--pyargs", "dvc.contracts", "-k"]
    chosen = "(calm or smooth or squares or hasty and sure) and not hopeless"
    good = run("pytest", *words, chosen, path=folder)
    assert good.returncode == 0, good.stdout
    assert run("pytest", *words, "broken and constant", path=folder).returncode == 1
    named = run("pytest", *words, "can_stand", path=folder)
    assert named.returncode == 1
    assert "['Not A Name'] do not match" in named.stdout
