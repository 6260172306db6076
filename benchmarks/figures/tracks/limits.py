"""Side information by tracked points against a prototype, against its ceiling, and from lossy key frames."""

from collections.abc import Sequence
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.figures.harness import (
    SCENES,
    STATIC_CLIPS,
    Figure,
    Measured,
    Setting,
    mean_over_clips,
)
from benchmarks.figures.tracks.points import quality
from benchmarks.figures.tracks.prediction import mean_db, received_groups
from benchmarks.figures.tracks.quality import AREA, QUICK_FRAMES, REAL_CLIPS, fixed_gop
from benchmarks.figures.tracks.runs import TE_DEPTH, Run
from dvc.metrics import psnr_db
from dvc.wynerziv.transform import to_uint8

PROTOTYPE_DB = {"tree": 27.4, "box": 33.4, "stone": 27.9}
"""What a quick prototype reached, and on how many frames, at `fixed_gop`, every second frame."""
PROTOTYPE_FRAMES = {"stone": 51}
OTHER_FRAMES = 31
KEY_QPS = (26, 34, 42)
LOSSY_FRAMES = 21
Luma = NDArray[np.uint8]
Floats = NDArray[np.float64]


def prototype_run(setting: Setting, clip: str) -> Run:
    """Return the run that the prototype was measured on, or such a run on another clip."""
    frames = setting.choose(min(setting.frames, PROTOTYPE_FRAMES.get(clip, OTHER_FRAMES)), QUICK_FRAMES)
    return Run(clip, TE_DEPTH, frames, fixed_gop(clip), every=2)


def against_prototype(setting: Setting, clip: str) -> Measured:
    """Measure what the prototype was measured on."""
    found = mean_db(prototype_run(setting, clip), setting.folder)
    text = f"{found:.2f} dB, prototype {PROTOTYPE_DB[clip]:.1f} dB"
    return Measured(text, found >= PROTOTYPE_DB[clip], {"si_psnr_db": found})


def against_prototype_mean(setting: Setting, clip: str) -> Measured:
    """Average the difference from the prototype."""
    del clip

    def difference(name: str) -> float:
        return mean_db(prototype_run(setting, name), setting.folder) - PROTOTYPE_DB[name]

    return mean_over_clips(setting, tuple(PROTOTYPE_DB), difference, "{:+.2f} dB", lambda mean: mean >= 1.0)


def motion_ceiling(original: Luma, keys: tuple[Luma, Luma], temporal_position: float) -> Floats:
    """Warp both key frames by the motion measured on the original frame itself, which no decoder has."""
    flow_between = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    flow_between.setFinestScale(0)  # these find more than any preset on tree and box, by 1 to 2 dB
    flow_between.setPatchStride(2)
    flow_between.setGradientDescentIterations(50)
    flow_between.setVariationalRefinementAlpha(5.0)
    rows, columns = np.indices(original.shape, dtype=np.float32)
    warped = []
    for key in keys:
        flow = flow_between.calc(original, key, np.zeros((*original.shape, 2), np.float32))
        columns_there, rows_there = columns + flow[..., 0], rows + flow[..., 1]
        warped.append(
            cv2.remap(
                key.astype(np.float32),
                columns_there,
                rows_there,
                cv2.INTER_CUBIC,
                borderMode=cv2.BORDER_REPLICATE,
            ).astype(np.float64)
        )
    blended: Floats = (1.0 - temporal_position) * warped[0] + temporal_position * warped[1]
    return blended


@cache
def ceiling_db(run: Run) -> float:
    """Return the mean PSNR of the frames of a run, predicted by their own motion."""
    values = []
    for group in received_groups(run):
        first, last = group.keys
        for index in range(first.index + 1, last.index, run.every):
            original = group.originals[index - first.index - 1].luma
            temporal_position = (index - first.index) / (last.index - first.index)
            predicted = motion_ceiling(original, (first.frame.luma, last.frame.luma), temporal_position)
            values.append(psnr_db(original, to_uint8(predicted)))
    return float(np.mean(values))


def below_ceiling(setting: Setting, clip: str) -> Measured:
    """Compare with both key frames warped by the motion measured on the original frame."""
    run = prototype_run(setting, clip)
    found, highest = mean_db(run, setting.folder), ceiling_db(run)
    values = {"si_psnr_db": found, "ceiling_db": highest}
    return Measured(f"{highest - found:.2f} dB ({found:.2f}, ceiling {highest:.2f})", None, values)


def below_ceiling_mean(setting: Setting, clip: str) -> Measured:
    """Average the distance to the ceiling."""
    del clip

    def gap(name: str) -> float:
        run = prototype_run(setting, name)
        return ceiling_db(run) - mean_db(run, setting.folder)

    return mean_over_clips(setting, STATIC_CLIPS, gap, "{:.2f} dB", lambda mean: mean <= 4.0)


def lossy_keys(setting: Setting, clip: str) -> Measured:
    """Coarsen the key frames, and compare what they and the side information lose."""
    qps = KEY_QPS if not setting.quick else (KEY_QPS[0], KEY_QPS[-1])
    frames = setting.choose(min(setting.frames, LOSSY_FRAMES), QUICK_FRAMES)
    found = [quality(setting, Run(clip, TE_DEPTH, frames, fixed_gop(clip), qp)) for qp in qps]
    keys_db = [one.key_db for one in found if one.key_db is not None]
    found_db = [one.mean_db for one in found]
    lost_keys, lost = keys_db[0] - keys_db[-1], found_db[0] - found_db[-1]
    text = f"−{lost:.1f} dB ({_spaced(found_db)}), key frames −{lost_keys:.1f} dB ({_spaced(keys_db)}), "
    text = text.replace("−-", "+") + f"QP {qps[0]} to {qps[-1]}"
    return Measured(text, lost < lost_keys, {"key_qp": qps, "key_db": keys_db, "si_psnr_db": found_db})


def _spaced(values_db: Sequence[float]) -> str:
    return " → ".join(f"{value:.1f}" for value in values_db)


def _prototype_asked() -> str:
    return ", ".join(f"{name} {value} dB" for name, value in PROTOTYPE_DB.items())


_CEILING = "below both lossless keys warped by the motion of the original, GOP 10 (stone 2)"
_PROTOTYPE = "TE (depth), lossless keys, GOP 10 (frames 0–30), stone GOP 2 (0–50), every second frame"
_LOSSY = "TE (depth) from lossy keys, GOP 10 (stone 2)"
FIGURES = (
    Figure(
        AREA,
        "te-prototype",
        _PROTOTYPE,
        f"≥ prototype: {_prototype_asked()}",
        against_prototype,
        tuple(PROTOTYPE_DB),
    ),
    Figure(
        AREA,
        "te-prototype-mean",
        "the same, above the prototype on the mean",
        "≥ +1 dB",
        against_prototype_mean,
    ),
    Figure(
        AREA,
        "lossy-keys",
        _LOSSY,
        "falls more slowly than the key frames' PSNR",
        lossy_keys,
        (*REAL_CLIPS, *SCENES),
        "figure 5.13",
    ),
    Figure(AREA, "ceiling", _CEILING, "≤ 4 dB on the mean", below_ceiling, STATIC_CLIPS),
    Figure(AREA, "ceiling-mean", "the same, mean over these", "≤ 4 dB", below_ceiling_mean),
)
"""The figures of this module."""
