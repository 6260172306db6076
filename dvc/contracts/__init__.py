"""Contracts of extensions as tests that authors run on their classes: ``pytest --pyargs dvc.contracts``."""

import pytest

pytest.register_assert_rewrite("dvc.contracts.plane_coders", "dvc.contracts.side_information")
