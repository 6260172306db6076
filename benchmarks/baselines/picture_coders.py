"""Picture coders of Pillow, AVIF and JPEG 2000, at the best quality that fits a number of bytes."""

import io
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from PIL import Image

from dvc.errors import ConfigError
from dvc.images.colour import Picture

JPEG2000_STEP, JPEG2000_LEVELS = 1.03, 230
"""Ratio of consecutive compression ratios, and their number."""
AVIF_LEVELS = 101


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


def _avif(level: int) -> dict[str, object]:
    """Code in monochrome and full range, by the settings that Pillow has."""
    return {"quality": level, "subsampling": "4:0:0", "max_threads": 1}


def _jpeg2000(level: int) -> dict[str, object]:
    """Code in one layer by the 9/7 transform; ratios fall with the level."""
    ratio = JPEG2000_STEP ** (JPEG2000_LEVELS - level)
    return {"quality_mode": "rates", "quality_layers": [ratio], "irreversible": True}


AVIF = PictureCoder("AVIF", AVIF_LEVELS, _avif, "AVIF")
JPEG2000 = PictureCoder("JPEG 2000", JPEG2000_LEVELS, _jpeg2000, "JPEG2000")
PICTURE_CODERS = AVIF, JPEG2000
