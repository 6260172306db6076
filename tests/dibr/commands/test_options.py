"""What subcommands share."""

import argparse

import pytest

from dvc.dibr.commands import dibr_options as options


@pytest.mark.parametrize("text", ["1e-300", "1e300", "0", "-1", "nan", "x"])
def test_multipliers_out_of_range_are_refused(text):
    with pytest.raises(argparse.ArgumentTypeError):
        options.parse_multiplier(text)


def test_multipliers_in_range_are_numbers():
    assert [options.parse_multiplier(text) for text in ("1e-8", "2e-3", "10")] == [1e-8, 2e-3, 10.0]
