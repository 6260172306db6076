"""Side information out of the files of points, with key frames where one wants them."""

from dataclasses import dataclass
from functools import cache

from benchmarks.figures import rates as rd_figures
from benchmarks.figures.harness import Setting
from benchmarks.figures.tracks.runs import BLOCK_MOTION, GOP, Run, Way
from dvc.rd.point_result import PointResult
from dvc.rd.points import Point

QUANTISER = 1
"""Of the Wyner-Ziv frames, which play no part where only key frames are references."""
_SELDOM = (("longest-track", "10000"), ("lost-tracks", "1"), ("scene-change", "1"))


@dataclass(frozen=True)
class Quality:
    """What the side information of a sequence is worth."""

    mean_db: float  # mean PSNR of the predicted frames
    key_db: float | None  # that of the key frames, 100 where they are lossless; None where nothing was coded
    num_served: int  # frames that the method served, and all that were predicted
    num_frames: int


def point_of(run: Run) -> Point:
    """Return the point whose decoder predicts the frames of a run."""
    way, codec = run.way, run.coding
    options = [("references", "keys")]
    if codec == "3d-te" and run.gop is not None:
        options += [("min-gop", str(run.gop)), *_SELDOM]
    if way.subpixel_bits is not None:
        options.append(("subpixel", str(way.subpixel_bits)))
    return Point(
        run.clip,
        codec,
        QUANTISER,
        "lossless" if run.key_qp is None else str(run.key_qp),
        run.gop or GOP[codec],
        frames=run.num_frames,
        options=tuple(sorted(options)),
        side_information=way.method,
        decoder=_decoder_options(way),
    )


def _decoder_options(way: Way) -> tuple[tuple[str, str], ...]:
    regular = [("path-regularity", f"{way.path_regularity:g}")] if way.path_regularity else []
    return (*regular, *([("track-corrections", "true")] if way.track_corrections else []))


@cache
def quality(setting: Setting, run: Run) -> Quality:
    """Read the side information of a run from the file of its point, which is measured if there is none."""
    [result] = rd_figures.measured(setting, run.clip, [point_of(run)])
    return side_information_quality(result)


def side_information_quality(result: PointResult) -> Quality:
    """Return the side information of a point, before decoding refines it."""
    rows = [row for row in result.frame_rows if row["type"] == "wz"]
    served = [row for row in rows if row["side_information"] != BLOCK_MOTION.method]
    mean_db, key_db = result.total("si_psnr_y_db"), result.total("key_psnr_y_db")
    assert mean_db is not None
    return Quality(mean_db, key_db, len(served), len(rows))
