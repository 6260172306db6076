"""Tests of all installed extensions."""

from importlib.metadata import entry_points

import pytest

from decoder.side_information.methods import METHODS
from dvc import extensions
from dvc.contracts.plane_coders import PlaneCoderContract
from dvc.contracts.side_information import Make, SideInformationContract
from dvc.slepian_wolf import PlaneCoder

SEED = 1


@pytest.mark.parametrize("group", extensions.GROUPS)
def test_names_can_be_in_streams(group: str) -> None:
    """Options and streams ignore all other names."""
    names = {entry.name for entry in entry_points(group=group)}
    ignored = sorted(names - set(extensions.installed(group)))
    assert not ignored, f"{group}: {ignored} do not match {extensions.NAME.pattern}"


class TestSideInformation(SideInformationContract):
    """Methods of side information."""

    @pytest.fixture(params=extensions.installed(extensions.SIDE_INFORMATION))
    def make(self, request: pytest.FixtureRequest) -> Make:
        """Return the factory of a method."""
        return METHODS[request.param]


class TestPlaneCoders(PlaneCoderContract):
    """Coders of planes."""

    @pytest.fixture(params=extensions.installed(extensions.PLANE_CODERS))
    def coder(self, request: pytest.FixtureRequest) -> PlaneCoder:
        """Return a coder."""
        coder: PlaneCoder = extensions.make(extensions.PLANE_CODERS, request.param, SEED)
        return coder
