"""What all tests share: the hypothesis profile, and the real sequences where they are present."""

from pathlib import Path

import pytest
from hypothesis import settings

# The first call of a compiled kernel can take seconds.
settings.register_profile("dvc", deadline=None, derandomize=True)
settings.load_profile("dvc")


@pytest.fixture(scope="session")
def shared_sequences() -> Path:
    """Return the folder of real sequences beside the project; skip the test where there is none."""
    folder = Path(__file__).resolve().parents[1].parent / "shared" / "sequences"
    if not folder.is_dir():
        pytest.skip(f"no real sequences in {folder}")
    return folder
