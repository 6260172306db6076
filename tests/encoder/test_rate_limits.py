"""Limits of a stream: what makes sense."""

import pytest

from dvc.errors import ConfigError
from encoder.rate_limits import RateLimits


@pytest.mark.parametrize("name", ["bits_per_s", "bits_per_frame"])
def test_limits_are_numbers_of_bits(name: str) -> None:
    """From one to a terabit."""
    assert RateLimits().is_none
    assert not RateLimits(**{name: 10**12}).is_none
    for bits in (0, 10**12 + 1):
        with pytest.raises(ConfigError, match=name):
            RateLimits(**{name: bits})
