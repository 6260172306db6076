"""Rendered sequences as videos: the reader protocol, jobs, files, nothing half-written."""

import json
from collections.abc import Iterator
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from dvc.errors import ConfigError, DvcError, VideoError
from dvc.picture_files import read_pfm, write_pfm
from dvc.video import open_video
from sequences.rendered_scenes import scene
from sequences.rendered_sequence import RenderedSequence, render
from sequences.renderer import RenderedFrame, render_frame
from tests.clips import same_frame


def short(**options: int) -> RenderedSequence:
    return RenderedSequence("stairway", 32, 25, **{"num_frames": 5, **options})


def test_sequence_keeps_the_reader_protocol() -> None:
    """A sequence has an info, yields its frames once, and nothing after it is closed."""
    sequence = short()
    assert sequence.info.size == (32, 25)
    assert (sequence.info.frame_rate, sequence.info.num_frames) == (Fraction(30), 5)
    with sequence as reader:
        assert next(iter(reader)).width == 32
        assert len(list(reader)) == 4
        assert list(reader) == []
    closed = short()
    closed.close()
    closed.close()
    assert list(closed) == []


@pytest.mark.parametrize("jobs", [2, 3, 8])
def test_jobs_do_not_change_the_frames(jobs: int) -> None:
    """Any number of threads gives the same frames in the same order."""
    for one, many in zip(short(), short(jobs=jobs), strict=True):
        assert same_frame(one, many)


def test_start_skips_frames() -> None:
    """Frame `start` of the scene comes first, even beyond the usual length."""
    late = next(iter(short(start=120, num_frames=1)))
    assert same_frame(late, render_frame(scene("stairway"), 120, 32, 25).frame)


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        (("beach",), {}, "beach"),
        (("street",), {"num_frames": 0}, "0 frames"),
        (("street",), {"start": -1}, "start -1"),
        (("street",), {"jobs": 0}, "0 jobs"),
        (("street",), {"noise_sigma": float("nan")}, "noise"),
        (("street", 0, 10), {}, "0x10"),
    ],
)
def test_wrong_arguments_are_refused_at_once(
    arguments: tuple[Any, ...], options: dict[str, Any], message: str
) -> None:
    """A user's mistake is a DvcError, raised before anything is built."""
    with pytest.raises(DvcError, match=message):
        RenderedSequence(*arguments, **options)


def test_files_hold_what_was_rendered(tmp_path: Path) -> None:
    """Video, depth and cameras read back are those of `render_frame`."""
    done: list[int] = []
    video, cameras, depth = tmp_path / "s.mkv", tmp_path / "s.json", tmp_path / "depth"
    render(short(start=3), video, cameras=cameras, depth=depth, progress=done.append)
    assert done == [1] * 5
    document = json.loads(cameras.read_text())
    assert (document["scene"], document["frame_rate"]) == ("stairway", "30")
    with open_video(video) as reader:
        assert reader.info.frame_rate == 30
        for frame, view in zip(reader, document["frames"], strict=True):
            truth = render_frame(scene("stairway"), view["index"], 32, 25)
            assert same_frame(frame, truth.frame)
            np.testing.assert_array_equal(view["cam_from_world"], truth.camera.cam_from_world)
            np.testing.assert_array_equal(view["K"], truth.camera.K)
            stored = read_pfm(depth / f"{view['index']:04d}.pfm")
            np.testing.assert_array_equal(stored, truth.depth)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["depth", "s.json", "s.mkv"]


class _Failing(RenderedSequence):
    def rendered(self) -> Iterator[RenderedFrame]:
        """Yield one frame, then fail."""
        yield render_frame(scene("stairway"), 0, *self.info.size)
        raise VideoError("no more")


def test_failure_leaves_nothing_behind(tmp_path: Path) -> None:
    """If rendering stops half way, no file or folder appears."""
    failing = _Failing("stairway", 32, 25)
    with pytest.raises(VideoError, match="no more"):
        render(failing, tmp_path / "s.mkv", cameras=tmp_path / "s.json", depth=tmp_path / "depth")
    assert list(tmp_path.iterdir()) == []


def test_outputs_must_differ(tmp_path: Path) -> None:
    """One name for two files is refused."""
    with pytest.raises(ConfigError, match="both"):
        render(short(), tmp_path / "s.mkv", cameras=tmp_path / "s.mkv")


@given(arrays(np.float32, array_shapes(min_dims=2, max_dims=2, max_side=9)))
def test_pfm_round_trip(tmp_path_factory: pytest.TempPathFactory, plane: np.ndarray) -> None:
    """Any plane, with inf and nan, comes back."""
    path = tmp_path_factory.getbasetemp() / "plane.pfm"
    write_pfm(path, plane)
    np.testing.assert_array_equal(read_pfm(path), plane)


def test_pfm_of_the_other_byte_order_is_read(tmp_path: Path) -> None:
    """A positive scale means big-endian."""
    path = tmp_path / "big.pfm"
    path.write_bytes(b"Pf\n2 1\n1.0\n" + np.array([1.5, -2.0], dtype=">f4").tobytes())
    np.testing.assert_array_equal(read_pfm(path), [[1.5, -2.0]])


@given(st.binary(max_size=60) | st.binary(max_size=40).map(lambda b: b"Pf\n2 2\n-1.0\n" + b))
def test_damaged_pfm_raises_video_error_or_reads(
    tmp_path_factory: pytest.TempPathFactory, content: bytes
) -> None:
    """Arbitrary bytes raise only VideoError."""
    path = tmp_path_factory.getbasetemp() / "damaged.pfm"
    path.write_bytes(content)
    with suppress(VideoError):
        assert read_pfm(path).ndim == 2
