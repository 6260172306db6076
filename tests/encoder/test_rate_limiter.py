"""What a live decoder is told it may ask for."""

from hypothesis import given
from hypothesis import strategies as st

from dvc.wynerziv.lengths import length_of_code
from encoder.rate_limiter import _limits


@given(st.lists(st.floats(0.0, 900_000.0), min_size=1, max_size=16))
def test_frames_together_are_told_what_is_allowed(allowed: list[float]) -> None:
    """Never more; what codes of one frame leave goes to those that follow."""
    told = [length_of_code(code[0]) for code in _limits(allowed)]
    assert len(told) == len(allowed)
    assert sum(told) <= sum(allowed) + 1e-6
    assert sum(told) >= sum(allowed) - max(16.0, max(allowed) / 8.0 + 1.0) or max(told) > 900_000
