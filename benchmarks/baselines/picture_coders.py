"""Picture coders of Pillow, AVIF and JPEG 2000, at the best quality that fits a number of bytes."""

import io
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from dvc.errors import ConfigError
from dvc.images.colour import Picture

JPEG2000_STEP = 1.03
"""From one compression ratio to the next."""
JPEG2000_LEVELS = 230
AVIF_LEVELS = 101


def decoded(file: bytes) -> Picture:
    """Decode a file of a gray picture."""
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(file)).convert("L"))


@dataclass(frozen=True)
class PictureCoder:
    """A coder of gray pictures, whose files grow with a whole number."""

    name: str  # of the format
    num_levels: int  # qualities are from 0 to ``num_levels - 1``
    encode: Callable[[Picture, int], bytes]  # from a picture (H, W), uint8, and a quality to a file
    decode: Callable[[bytes], Picture] = decoded  # from a file to a picture; by default Pillow's


class CodedPicture(NamedTuple):
    """A picture in a file."""

    num_bytes: int  # of the file
    picture: Picture  # decoded
    level: int  # quality


@dataclass(eq=False)
class Ladder:
    """One picture at all qualities, each coded when it is asked for."""

    coder: PictureCoder  # by what
    picture: Picture  # the original
    _known: dict[int, CodedPicture] = field(default_factory=dict, repr=False)

    def at(self, level: int) -> CodedPicture:
        """Return the picture at a quality."""
        if level not in self._known:
            file = self.coder.encode(self.picture, level)
            self._known[level] = CodedPicture(len(file), self.coder.decode(file), level)
        return self._known[level]

    def within(self, max_bytes: float) -> CodedPicture | None:
        """Return the picture at the best quality that fits."""
        low, high = -1, self.coder.num_levels
        while high - low > 1:
            middle = (low + high) // 2
            if self.at(middle).num_bytes <= max_bytes:
                low = middle
            else:
                high = middle
        return None if low < 0 else self.at(low)


def _avif(picture: Picture, level: int) -> bytes:
    """Code as monochrome AVIF, full range, by the settings that Pillow has."""
    return _saved(picture, "AVIF", quality=level, subsampling="4:0:0", max_threads=1)


def _jpeg2000(picture: Picture, level: int) -> bytes:
    """Code as JPEG 2000, 9/7, one layer; ratios fall with the level."""
    ratio = JPEG2000_STEP ** (JPEG2000_LEVELS - level)
    options = {"quality_mode": "rates", "quality_layers": [ratio], "irreversible": True}
    return _saved(picture, "JPEG2000", **options)


def _saved(picture: Picture, file_format: str, **options: object) -> bytes:
    from PIL import Image

    file = io.BytesIO()
    try:
        Image.fromarray(picture).save(file, file_format, **options)
    except (KeyError, OSError, ValueError) as err:
        raise ConfigError(f"this Pillow cannot write {file_format}: {err}") from err
    return file.getvalue()


AVIF = PictureCoder("AVIF", AVIF_LEVELS, _avif)
JPEG2000 = PictureCoder("JPEG 2000", JPEG2000_LEVELS, _jpeg2000)
PICTURE_CODERS = AVIF, JPEG2000
