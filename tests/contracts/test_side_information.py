"""Our side-information methods keep the contract."""

import pytest

from decoder.side_information.methods import METHODS
from dvc.contracts.test_side_information import Make, SideInformationContract


class TestMethods(SideInformationContract):
    @pytest.fixture(params=METHODS)
    def make(self, request: pytest.FixtureRequest) -> Make:
        return METHODS[request.param]
