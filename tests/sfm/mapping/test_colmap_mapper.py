"""Key frames and pictures that COLMAP's mapper gets."""

from pathlib import Path

import numpy as np
import pytest

from dvc.video import Frame
from sfm.mapping.colmap_mapper import MAX_FRAMES, _reach, _spaced, _write_pictures


@pytest.mark.parametrize(
    ("first", "last", "reach"),
    [(8, 12, range(5, 21)), (0, 30, range(31)), (3, 20, range(2, 31)), (21, 29, range(20, 31))],
)
def test_pieces_reach_to_the_key_frames_around(first: int, last: int, reach: range) -> None:
    """Or to their own ends without key frames there."""
    assert _reach([0, 2, 5, 20, 30], first, last) == reach


def test_pictures_that_cannot_be_written_are_an_error(tmp_path: Path) -> None:
    """COLMAP never gets fewer pictures than chosen."""
    frames = [Frame(np.full((8, 8), level, np.uint8)) for level in (10, 20)]
    assert _write_pictures(tmp_path, frames, [1]) == ["00000001.png"]
    with pytest.raises(OSError, match="No such file"):
        _write_pictures(tmp_path / "nowhere", frames, [1])


def test_many_key_frames_are_thinned_evenly() -> None:
    """From the first to the last."""
    assert _spaced([]) == []
    assert _spaced([4, 9, 11]) == [4, 9, 11]
    chosen = _spaced(range(0, 6 * MAX_FRAMES, 2))
    assert len(chosen) == MAX_FRAMES
    assert (chosen[0], chosen[-1]) == (0, 6 * MAX_FRAMES - 2)
