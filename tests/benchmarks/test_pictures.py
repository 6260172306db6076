"""Pictures of tracked coding, and the table of their page."""

from pathlib import Path

import numpy as np

from benchmarks.pictures import drawing, tracks
from benchmarks.pictures.drawing import Line
from dvc.tracks import PointTracks


def test_rows_replace_those_of_the_same_sequence() -> None:
    """A row takes the place of an older one of its sequence, and rows keep the order of the sequences."""
    page = f"text\n\n{tracks.BEGIN}\n{tracks.END}\n\nmore\n"
    page = tracks.with_rows(page, ["| tree | 1 |", "| street | 2 |"])
    page = tracks.with_rows(page, ["| tree | 3 |", "| stone (GOP 2) | 4 |"])
    lines = page.splitlines()
    start = lines.index(tracks.BEGIN)
    assert lines[start + 3 : start + 6] == ["| street | 2 |", "| stone (GOP 2) | 4 |", "| tree | 3 |"]
    assert lines[start + 6] == tracks.END
    assert (lines[0], lines[-1]) == ("text", "more")


def test_lines_are_cut_at_key_frames() -> None:
    """Frames on both sides of a key frame are not joined, whether all frames are there or not."""
    quality = dict.fromkeys((1, 2, 4, 5), 30.0)
    assert [list(part) for part in drawing._parts(Line("a", quality, 0))] == [[1, 2], [4, 5]]
    second = dict.fromkeys((1, 3, 5, 7), 30.0)
    assert [list(part) for part in drawing._parts(Line("b", second, 0, gop=4))] == [[1, 3], [5, 7]]
    [through] = drawing._parts(Line("c", {1: 30.0}, 0, peaks={0: 40.0, 2: 41.0}))
    assert list(through) == [0, 1, 2]


def test_tracks_are_drawn_until_they_are_lost() -> None:
    """A lost track ends in orange, and one that goes on does not; other pixels stay grey."""
    positions = np.full((2, 3, 2), np.nan)
    positions[0] = [[4, 4], [6, 4], [8, 4]]
    positions[1, :2] = [[20, 10], [22, 10]]
    drawn = drawing.draw_tracks(np.full((24, 32), 90, np.uint8), PointTracks(positions)).astype(int)
    assert drawn.shape == (72, 96, 3)
    coloured = np.ptp(drawn, axis=2) > 60
    assert coloured[13, 13]
    assert coloured[13, 25]
    assert coloured[31, 67]
    assert not coloured[40:].any()


def test_page_has_a_table() -> None:
    """The page that the table goes into has its marks."""
    page = (Path(__file__).parents[2] / tracks.PAGE).read_text(encoding="utf-8")
    assert page.count(tracks.BEGIN) == page.count(tracks.END) == 1


def test_snakes_are_drawn() -> None:
    """Even motion is green, the path magenta and found positions red; other pixels stay grey."""
    tracks = PointTracks(np.array([[[4.0, 4.0], [14.0, 16.0], [24.0, 4.0]]]))
    drawn = drawing.draw_snakes(np.full((24, 32), 90, np.uint8), tracks).astype(int)
    assert drawn.shape == (72, 96, 3)
    assert tuple(drawn[49, 43]) == drawing._RED
    assert drawn[13, 43, 1] > drawn[13, 43, 2] + 60
    assert not (np.ptp(drawn, axis=2) > 60)[54:].any()
    assert drawing.draw_snakes(np.full((24, 32), 90, np.uint8), PointTracks.none(4)).shape == drawn.shape
