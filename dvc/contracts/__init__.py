"""Contracts of what can be extended: tests that authors run on their own classes, and we on ours."""

import pytest

for _name in (
    "disparity_codecs",
    "inference",
    "noise_models",
    "plane_coders",
    "plane_exchange",
    "side_information",
):
    pytest.register_assert_rewrite(f"dvc.contracts.{_name}")
