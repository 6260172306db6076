"""How far predictions of P-type frames are from block motion that is found with the original.

Clips are coded with the default codec, and their P-type frames decoded in one process. The PSNR of each is
that of the prediction by tracks alone, of the prediction that is used, of the last one while it was decoded,
and of block motion as an encoder would find it that knows the frame: 8x8 blocks from the same decoded
references, displaced by quarter samples, each by the vector and from the reference of the least squared
error, whatever it costs to send them. Last comes which share of the way from tracks alone to block motion the
prediction used goes.
"""

import json
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from itertools import chain, islice, product
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from benchmarks.results.harness import CLIPS, clip_source
from benchmarks.stages import coded, decoded_groups, enter_baseline_environment
from decoder.side_information.block_motion.compensation import Luma, Offsets, phase_planes
from decoder.side_information.block_motion.refinement import BLOCK, BlockRefiner
from decoder.side_information.extrapolation import LongTerm, TrackedExtrapolation
from decoder.side_information.protocol import Prediction, ReferenceFrame
from decoder.side_information.scene.extrapolated import Scene
from decoder.tasks import DecodedFrame, DecodedGroup, GroupTask
from dvc import cli
from dvc.config import MAX_QP
from dvc.metrics import mean_psnr_db, psnr_db
from dvc.tracks import FeaturePoints, PointTracks
from dvc.video import open_video
from dvc.wynerziv.hierarchy import Around
from dvc.wynerziv.transform import to_uint8
from encoder import intra_decision

PROG = "python -m benchmarks.p_type_prediction"
EXAMPLES = f"""\
  {PROG}                                  all nine clips
  {PROG} box desk --frames 33 --all-p-type
"""
BLOCK_PX = 8
"""Side of the blocks that move."""
REACH_PX, MARGIN_PX = 48, 64
"""Displacements that are all tried, and by how much the border of a reference is repeated around it."""
NEAR = ((8, 4), (2, 2), (1, 1))
"""Displacements to each side that are tried near the best of these, and near where the prediction has a block
from; and the distance between them in quarter samples."""


class Sources(NamedTuple):
    """What a P-type frame may be predicted from."""

    by_tracks: Luma
    references: tuple[Luma, ...]
    starts: tuple[Offsets, ...]  # where the prediction has blocks from, in each of them


class Row(NamedTuple):
    """PSNR of the predictions of a P-type frame, or the mean of several, in dB."""

    by_tracks: float
    used: float
    refined: float
    block_motion: float

    @property
    def closed(self) -> float:
        """Share of the way from tracks to block motion that the prediction used goes."""
        way = self.block_motion - self.by_tracks
        return (self.used - self.by_tracks) / way if way else 0.0

    @classmethod
    def mean(cls, rows: "Sequence[Row]") -> "Row":
        """Average rows."""
        return cls(*map(mean_psnr_db, zip(*rows, strict=True)))


class RecordingExtrapolation(TrackedExtrapolation):
    """Predicts as usual, and keeps from what."""

    def __init__(self) -> None:
        self.sources: dict[int, Sources] = {}

    def predict(
        self,
        earlier: Sequence[ReferenceFrame],
        points: PointTracks | FeaturePoints | None,
        first_index: int,
        instant: int,
        scene: Scene | None = None,
        long_term: LongTerm | None = None,
    ) -> Prediction:
        """Predict one frame."""
        self.take(earlier, scene, instant)
        used = super().predict(earlier, points, first_index, instant, scene, long_term)
        alone = super().predict(earlier, points, first_index, instant)
        refiner = used.refiner
        assert isinstance(refiner, BlockRefiner)
        factor = BLOCK_PX // BLOCK
        self.sources[instant] = Sources(
            to_uint8(alone.luma),
            tuple(frame.luma for frame in refiner.references),
            tuple(offsets[::factor, ::factor].copy() for offsets in refiner.offsets),
        )
        return used

    def take(self, earlier: Sequence[ReferenceFrame], scene: Scene | None, instant: int) -> None:
        """Do what else is to be done with what a frame is predicted from; here, nothing."""


def block_motion(original: Luma, references: Sequence[Luma], starts: Sequence[Offsets]) -> Luma:
    """Predict a frame by block motion that is found with the original: near some places, and all around."""
    rows, columns = starts[0].shape[:2]
    height, width = original.shape
    padding = (0, rows * BLOCK_PX - height), (0, columns * BLOCK_PX - width)
    padded = np.pad(original, padding, mode="edge").astype(np.int16)
    blocks = padded.reshape(rows, BLOCK_PX, columns, BLOCK_PX).swapaxes(1, 2)
    found = []
    for reference, start in zip(references, starts, strict=True):
        planes = phase_planes(reference, MARGIN_PX)
        found += [_best_blocks(blocks, planes, near) for near in (start, _full_search(padded, planes[0, 0]))]
    best = np.array([errors for errors, _ in found]).argmin(axis=0)
    predicted = np.array([samples for _, samples in found])
    chosen = np.take_along_axis(predicted, best[None, :, :, None, None], axis=0)[0]
    return np.ascontiguousarray(chosen.swapaxes(1, 2).reshape(padded.shape)[:height, :width])


def _full_search(original: NDArray[np.int16], plane: Luma) -> Offsets:
    """Find where in the plane of a reference each block has least squared error, in whole samples."""
    height, width = original.shape
    rows, columns = height // BLOCK_PX, width // BLOCK_PX
    samples = np.pad(plane, ((0, BLOCK_PX), (0, BLOCK_PX)), mode="edge").astype(np.int16)
    vectors = np.zeros((rows, columns, 2), np.int64)
    least = np.full((rows, columns), np.iinfo(np.uint64).max)
    for displacement in product(range(-REACH_PX, REACH_PX + 1), repeat=2):
        row, column = MARGIN_PX + np.array(displacement)
        difference = original - samples[row : row + height, column : column + width]
        strips = _squares(difference).reshape(rows, BLOCK_PX, width).sum(axis=1)
        errors = strips.reshape(rows, columns, BLOCK_PX).sum(axis=2)
        better = errors < least
        least[better], vectors[better] = errors[better], 4 * np.array(displacement)
    return vectors


def _best_blocks(
    blocks: NDArray[np.int16], planes: NDArray[np.uint8], starts: Offsets
) -> tuple[NDArray[np.uint64], NDArray[np.uint8]]:
    """Return the least squared errors of blocks near some places of a reference, and what is there."""
    windows = np.lib.stride_tricks.sliding_window_view(planes, (BLOCK_PX, BLOCK_PX), axis=(2, 3))
    last = 4 * (np.array(windows.shape[2:4]) - 1)
    corners = 4 * (MARGIN_PX + BLOCK_PX * np.moveaxis(np.indices(blocks.shape[:2]), 0, -1))
    vectors, found = starts.copy(), np.zeros(blocks.shape, np.uint8)
    least = np.full(blocks.shape[:2], np.iinfo(np.uint64).max)
    for radius, step in NEAR:
        centres = vectors.copy()
        for displacement in product(range(-radius, radius + 1), repeat=2):
            offsets = centres + step * np.array(displacement)
            row, column = np.moveaxis(np.clip(corners + offsets, 0, last), -1, 0)
            samples = windows[row & 3, column & 3, row >> 2, column >> 2]
            errors = _squares(blocks - samples).sum(axis=(2, 3))
            better = errors < least
            least[better], vectors[better], found[better] = errors[better], offsets[better], samples[better]
    return least, found


def _squares(difference: NDArray[np.int16]) -> NDArray[np.uint16]:
    """Square differences of samples, which fit where there is no sign."""
    return (difference * difference).view(np.uint16)


def measure(clip: str, qp: int, num_frames: int, all_p_type: bool = False) -> dict[int, Row]:
    """Code and decode a clip; return what its P-type frames are predicted like."""
    forced = mock.patch.object(intra_decision, "MAX_LOST_SHARE", np.inf) if all_p_type else nullcontext()
    with forced, tempfile.TemporaryDirectory() as folder:
        stream = coded(clip, qp, num_frames, Path(folder))
    with open_video(clip_source(clip).path) as video:
        originals = [frame.luma for frame in islice(video, num_frames)]
    return dict(_rows(stream, originals))


def _rows(stream: bytes, originals: Sequence[Luma]) -> Iterator[tuple[int, Row]]:
    recording = RecordingExtrapolation()
    for frame in decoded_p_types(stream, recording):
        original, sources = originals[frame.index], recording.sources.pop(frame.index)
        predictions = (
            sources.by_tracks,
            frame.side_information,
            frame.refined_side_information,
            block_motion(original, sources.references, sources.starts),
        )
        yield frame.index, Row(*(psnr_db(original, one) for one in predictions))


def decoded_p_types(stream: bytes, extrapolation: TrackedExtrapolation) -> Iterator[DecodedFrame]:
    """Decode the P-type frames of a stream, and no others."""
    with (
        mock.patch("decoder.group.TrackedExtrapolation", return_value=extrapolation),
        mock.patch("decoder.group.levels", _p_type_levels),
        mock.patch.object(DecodedGroup, "of", _p_type_frames),
    ):
        yield from chain.from_iterable(group.wyner_ziv for group in decoded_groups(stream))


def _p_type_levels(order: Sequence[tuple[int, Around]]) -> list[list[tuple[int, Around]]]:
    """Leave out the frames between P-type frames, which are decoded before them."""
    return [[place] for place in order if place[1][1] is None]


def _p_type_frames(task: GroupTask, frames: Sequence[DecodedFrame]) -> DecodedGroup:
    """Return a group of which no more is decoded."""
    return DecodedGroup(task.first_index, tuple(frames), task.key, task.record)


def table(found: dict[str, dict[int, Row]]) -> str:
    """Return the means of clips, and the mean of these."""
    lines = [f"{'clip':<12} P-type by scene  tracks    used refined  blocks  closed"]
    means = {clip: Row.mean([*rows.values()]) for clip, rows in found.items() if rows}
    for clip, rows in found.items():
        lines.append(_line(clip, [*rows.values()], means[clip]) if rows else f"{clip:<12}   none")
    if means:
        every = [row for rows in found.values() for row in rows.values()]
        lines.append(_line("mean", every, Row.mean([*means.values()])))
    return "\n".join(lines)


def _line(name: str, rows: Sequence[Row], mean: Row) -> str:
    by_scene = sum(row.used != row.by_tracks for row in rows)
    values = "".join(f"{value:8.2f}" for value in mean)
    return f"{name:<12} {len(rows):6d} {by_scene:8d}{values}{100 * mean.closed:6.0f} %"


def _parser() -> cli.ArgumentParser:
    parser = cli.ArgumentParser(PROG, __doc__, EXAMPLES)
    parser.add_argument("clips", nargs="*", metavar="CLIP", help="default: all nine")
    parser.add_argument("--frames", type=cli.integer(2, 10**6), default=65, help="of each clip (default: 65)")
    parser.add_argument("--qp", type=cli.integer(1, MAX_QP), default=32, help="quality (default: 32)")
    parser.add_argument(
        "--all-p-type", action="store_true", help="no key frame where a group may do without, however hard"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the PSNRs of all frames to a file")
    return parser


def main(words: Sequence[str] | None = None) -> int:
    """Measure clips, and print a table."""
    arguments = _parser().parse_intermixed_args(words)
    clips = arguments.clips or list(CLIPS)
    found: dict[str, dict[int, Row]] = {}
    with cli.progress_bar("clips", len(clips)) as progress:
        for clip in clips:
            found[clip] = measure(clip, arguments.qp, arguments.frames, arguments.all_p_type)
            progress(1)
    keys = "as few key frames as may be" if arguments.all_p_type else "the usual key frames"
    print(f"{arguments.frames} frames, QP {arguments.qp}, {keys}; PSNR of P-type frames in dB\n")
    print(table(found))
    if arguments.json:
        told = {clip: {k: row._asdict() for k, row in rows.items()} for clip, rows in found.items()}
        arguments.json.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    enter_baseline_environment("benchmarks.p_type_prediction")
    sys.exit(main())
