"""What a map says of itself."""

import pytest

from sfm.mapping.scene_map import MapPiece, SceneMap
from tests.sfm.plane_map import map_of, piece_of

SIZE = (12, 9)


@pytest.mark.parametrize(
    ("pieces", "summary"),
    [
        ((), "map: no frame of 12 located: few points, or no parallax"),
        ((piece_of(range(5), *SIZE),), "map: 1 piece, 5 of 12 frames located"),
        (
            (piece_of(range(5), *SIZE), piece_of(range(7, 12), *SIZE)),
            "map: 2 pieces, 10 of 12 frames located",
        ),
    ],
)
def test_summary_counts_pieces_and_frames(pieces: tuple[MapPiece, ...], summary: str) -> None:
    """In one line, and in the right number."""
    scene: SceneMap = map_of(*pieces, size=SIZE)
    assert scene.summary == summary
