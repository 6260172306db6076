"""Results of coders of two views, and picture coders of Pillow at the best quality that fits some bytes."""

import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np
from PIL import Image

from dvc.errors import ConfigError
from dvc.images.colour import Picture
from dvc.metrics import PEAK, psnr_db

JPEG2000_STEP, JPEG2000_LEVELS = 1.03, 230
"""Ratio of consecutive compression ratios, and their number."""
AVIF_LEVELS = 101


class Quality(NamedTuple):
    """PSNR of all views of a scene."""

    pooled_db: float  # PSNR of the mean squared error over all views, the reference included (3.1)
    mean_db: float  # mean of the PSNRs
    by_view_db: tuple[float, ...]


class BaselineResult(NamedTuple):
    """Coded views."""

    num_bytes: int  # size of all files
    quality: Quality  # quality of the views, decoded or rendered
    split: float  # share of the disparities, or of the second view, in the bytes
    setting: str  # qualities that were chosen


class Baseline(Protocol):
    """A way to code two views."""

    @property
    def name(self) -> str:
        """Name in tables."""

    def best_within(self, max_bytes: int) -> BaselineResult | None:
        """Return the best result of at most a number of bytes, or None if nothing fits."""


def quality_of(views: Sequence[Picture], truths: Sequence[Picture]) -> Quality:
    """Compare views with the pictures of their cameras."""
    by_view = [
        psnr_db(view.reshape(view.shape[0], -1), truth.reshape(truth.shape[0], -1))
        for view, truth in zip(views, truths, strict=True)
    ]
    squared = float(np.mean([PEAK**2 * 10.0 ** (-psnr / 10.0) for psnr in by_view]))
    pooled = math.inf if squared == 0.0 else 10.0 * math.log10(PEAK**2 / squared)
    return Quality(pooled, float(np.mean(by_view)), tuple(by_view))


def best(results: Sequence[BaselineResult]) -> BaselineResult | None:
    """Return the result of the highest pooled PSNR."""
    return max(results, key=lambda result: result.quality.pooled_db, default=None)


@dataclass(frozen=True)
class PictureCoder:
    """A coder of gray pictures with a quality from 0 to ``num_levels - 1``."""

    name: str
    num_levels: int
    options: Callable[[int], dict[str, object]]  # options of Pillow by quality
    file_format: str  # name of the format in Pillow

    def encode(self, picture: Picture, level: int) -> bytes:
        """Code a picture."""
        file = io.BytesIO()
        try:
            Image.fromarray(picture).save(file, self.file_format, **self.options(level))
        except (KeyError, OSError, ValueError) as err:
            raise ConfigError(f"this Pillow cannot write {self.file_format}: {err}") from err
        return file.getvalue()


class CodedPicture(NamedTuple):
    """A picture in a file."""

    num_bytes: int  # size of the file
    picture: Picture  # decoded picture
    level: int  # quality


@dataclass(eq=False)
class Ladder:
    """One picture at all qualities, each coded on demand."""

    coder: PictureCoder
    picture: Picture
    _coded: dict[int, CodedPicture] = field(default_factory=dict, repr=False)

    def at(self, level: int) -> CodedPicture:
        """Return the picture at a quality."""
        if level not in self._coded:
            file = self.coder.encode(self.picture, level)
            decoded = np.asarray(Image.open(io.BytesIO(file)).convert("L"))
            self._coded[level] = CodedPicture(len(file), decoded, level)
        return self._coded[level]

    def within(self, max_bytes: float) -> CodedPicture | None:
        """Return the picture at the best quality that fits."""
        level = highest_fitting(self.coder.num_levels, lambda level: self.at(level).num_bytes, max_bytes)
        return None if level < 0 else self.at(level)


def highest_fitting(num_levels: int, size: Callable[[int], int], max_bytes: float) -> int:
    """Return the highest level with a size that fits, by bisection, or -1."""
    low, high = -1, num_levels
    while high - low > 1:
        middle = (low + high) // 2
        if size(middle) <= max_bytes:
            low = middle
        else:
            high = middle
    return low


def _jpeg2000(level: int) -> dict[str, object]:
    """Code in one layer by the 9/7 transform; ratios fall with the level."""
    ratio = JPEG2000_STEP ** (JPEG2000_LEVELS - level)
    return {"quality_mode": "rates", "quality_layers": [ratio], "irreversible": True}


_MONOCHROME = {"subsampling": "4:0:0", "max_threads": 1}
AVIF = PictureCoder("AVIF", AVIF_LEVELS, lambda level: {"quality": level, **_MONOCHROME}, "AVIF")
JPEG2000 = PictureCoder("JPEG 2000", JPEG2000_LEVELS, _jpeg2000, "JPEG2000")
PICTURE_CODERS = AVIF, JPEG2000
