"""Colour: luma and chroma of pictures, full range."""

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

Picture = NDArray[np.uint8]
"""Picture of shape (H, W), gray, or (H, W, 3): red, green and blue."""

_KR, _KB = 0.299, 0.114
_KG = 1.0 - _KR - _KB
_CB_SCALE, _CR_SCALE = 2.0 * (1.0 - _KB), 2.0 * (1.0 - _KR)


def ycbcr_from_rgb(picture: ArrayLike) -> NDArray[np.float64]:
    """Return luma and chroma; the inverse of `rgb_from_ycbcr`."""
    red, green, blue = np.moveaxis(np.asarray(picture, np.float64), -1, 0)
    luma = _KR * red + _KG * green + _KB * blue
    return np.stack([luma, (blue - luma) / _CB_SCALE, (red - luma) / _CR_SCALE])


def rgb_from_ycbcr(planes: ArrayLike) -> NDArray[np.float64]:
    """Return red, green and blue; the inverse of `ycbcr_from_rgb`."""
    luma, cb, cr = np.asarray(planes, np.float64)
    blue, red = luma + _CB_SCALE * cb, luma + _CR_SCALE * cr
    return np.stack([red, (luma - _KR * red - _KB * blue) / _KG, blue], axis=-1)


def luma(picture: Picture) -> Picture:
    """Return the luma of a picture."""
    if picture.ndim == 2:
        return picture
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), np.uint8)
