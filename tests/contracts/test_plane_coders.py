"""Our coders of planes keep the contract."""

import pytest

from dvc.config import CODERS, CascadeConfig
from dvc.contracts.plane_coders import PlaneCoderContract
from dvc.slepian_wolf import PlaneCoder
from tests.coders import coder_of

ALL: dict[str, PlaneCoder] = {name: coder_of(name) for name in CODERS} | {
    "cascade one by one": coder_of("cascade", CascadeConfig(0)),
    "cascade few bits": coder_of("cascade", CascadeConfig(0)),
}


class TestCoders(PlaneCoderContract):
    """All coders."""

    @pytest.fixture(params=ALL.values(), ids=ALL)
    def coder(self, request: pytest.FixtureRequest) -> PlaneCoder:
        """Return a coder."""
        coder: PlaneCoder = request.param
        return coder
