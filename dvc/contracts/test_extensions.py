"""Contracts of all extensions that are installed: ``pytest --pyargs dvc.contracts``."""

import pytest

from decoder.side_information.methods import METHODS
from dvc import extensions
from dvc.contracts.disparity_codecs import DisparityCodecContract
from dvc.contracts.inference import InferenceContract
from dvc.contracts.noise_models import NoiseModelContract
from dvc.contracts.plane_coders import PlaneCoderContract
from dvc.contracts.side_information import Make, SideInformationContract
from dvc.dibr.disparity.disparity_codec import DisparityCodec
from dvc.dibr.disparity.methods import METHODS as DISPARITY_CODECS
from dvc.geometry.volumes.inference import Inference
from dvc.slepian_wolf import PlaneCoder
from dvc.wynerziv.noise import MODELS, NoiseModel

METHOD_NAMES = [
    *extensions.installed(extensions.SIDE_INFORMATION),
    *extensions.installed(extensions.SCENE_INTERPOLATORS),
]
SEED = 1


@pytest.mark.parametrize("group", extensions.GROUPS)
def test_names_can_stand_in_streams(group: str) -> None:
    """Other names are left aside: neither options nor streams can have them."""
    from importlib.metadata import entry_points

    names = {entry.name for entry in entry_points(group=group)}
    aside = sorted(names - set(extensions.installed(group)))
    assert not aside, f"{group}: {aside} do not match {extensions.NAME.pattern}"


class TestSideInformation(SideInformationContract):
    """Methods, and scene interpolators as methods."""

    @pytest.fixture(params=METHOD_NAMES)
    def make(self, request: pytest.FixtureRequest) -> Make:
        """Return what builds a method."""
        return METHODS[request.param]


class TestPlaneCoders(PlaneCoderContract):
    """Coders of planes."""

    @pytest.fixture(params=extensions.installed(extensions.PLANE_CODERS))
    def coder(self, request: pytest.FixtureRequest) -> PlaneCoder:
        """Return a coder."""
        coder: PlaneCoder = extensions.make(extensions.PLANE_CODERS, request.param, SEED)
        return coder


class TestInference(InferenceContract):
    """Inference of labels."""

    @pytest.fixture(params=extensions.installed(extensions.INFERENCE))
    def method(self, request: pytest.FixtureRequest) -> Inference:
        """Return a method."""
        method: Inference = extensions.make(extensions.INFERENCE, request.param)
        return method


class TestDisparityCodecs(DisparityCodecContract):
    """Codecs of disparity maps."""

    @pytest.fixture(params=extensions.installed(extensions.DISPARITY_CODECS))
    def codec(self, request: pytest.FixtureRequest) -> DisparityCodec:
        """Return a codec."""
        return DISPARITY_CODECS[request.param]


class TestNoiseModels(NoiseModelContract):
    """Models of correlation noise."""

    @pytest.fixture(params=extensions.installed(extensions.NOISE_MODELS))
    def model(self, request: pytest.FixtureRequest) -> NoiseModel:
        """Return a model."""
        return MODELS[request.param]
