"""Lengths in one byte."""

from itertools import pairwise

from dvc.wynerziv.lengths import length_code, length_of_code, lengths


def test_lengths_are_told_on_a_fine_scale() -> None:
    """Every code is longer than the one before, by 1/16 or 16 bits at most."""
    assert lengths()[:3] == (0, 16, 17)
    assert all(0 < after - before <= max(before / 16, 16) for before, after in pairwise(lengths()))
    for bits in (1, 16, 17, 100.5, 4095, 4097, 100_000):
        code = length_code(bits)
        assert length_of_code(code - 1) < bits <= length_of_code(code)
    assert length_code(0) == 0
    assert length_code(1e12) == 255
