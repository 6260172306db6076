"""Figures in blue, green and red: coloured disparities, errors, titles, panels in rows."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]
Floats = NDArray[np.floating]

UNKNOWN = (128, 128, 128)
GOOD, BAD, NEAR_BAD = (255, 255, 255), (40, 40, 200), (120, 190, 250)
_BANNER_PX = 26
_GAP_PX = 8
_SCALE, _MARGIN_PX = 0.45, 5


def colour_disparity(disparity: Floats, lowest: float, highest: float) -> Picture:
    """Colour disparities from far (dark) to near (bright), readable without colour vision."""
    known = np.isfinite(disparity)
    position = (np.where(known, disparity, lowest) - lowest) / max(highest - lowest, 1e-12)
    levels = np.rint(np.clip(position, 0.0, 1.0) * 255).astype(np.uint8)
    picture = np.asarray(cv2.applyColorMap(levels, cv2.COLORMAP_VIRIDIS), np.uint8)
    picture[~known] = UNKNOWN
    return picture


def colour_error(error: Floats, counted: NDArray[np.bool_], bad_px: float = 1.0) -> Picture:
    """Draw the errors of disparities: white is good, red bad, orange above half the limit of bad."""
    picture = np.full((*error.shape, 3), UNKNOWN, np.uint8)
    picture[counted] = GOOD
    picture[counted & (error > 0.5 * bad_px)] = NEAR_BAD
    picture[counted & (error > bad_px)] = BAD
    return picture


def colour_counts(counts: NDArray[np.integer], highest: int) -> Picture:
    """Draw whole numbers from 0 (black) to `highest` (white) in even steps."""
    grey = np.rint(np.clip(counts / highest, 0.0, 1.0) * 255).astype(np.uint8)
    return np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), np.uint8)


def disparity_legend(width: int, lowest: float, highest: float) -> Picture:
    """Draw the scale of `colour_disparity` with its ends in pixels."""
    ramp = np.linspace(lowest, highest, width)[None].repeat(10, axis=0)
    bar = colour_disparity(ramp, lowest, highest)
    texts = np.full((_BANNER_PX, width, 3), 255, np.uint8)
    right = f"{highest:g} px, near"
    text_px = cv2.getTextSize(right, cv2.FONT_HERSHEY_SIMPLEX, _SCALE, 1)[0][0]
    _write(texts, f"{lowest:g}", _MARGIN_PX)
    _write(texts, right, width - text_px - _MARGIN_PX)
    return np.asarray(np.vstack([bar, texts]), np.uint8)


def with_title(picture: NDArray[np.uint8], title: str) -> Picture:
    """Add a line of text above a picture."""
    colour = np.repeat(picture[:, :, None], 3, axis=2) if picture.ndim == 2 else picture
    banner = np.full((_BANNER_PX, colour.shape[1], 3), 255, np.uint8)
    _write(banner, title, _MARGIN_PX)
    return np.asarray(np.vstack([banner, colour]), np.uint8)


def in_rows(pictures: Sequence[Picture], columns: int) -> Picture:
    """Arrange pictures in rows, with white gaps."""
    height = max(picture.shape[0] for picture in pictures)
    width = max(picture.shape[1] for picture in pictures)
    num_rows = -(-len(pictures) // columns)
    columns = min(columns, len(pictures))
    size = (num_rows * (height + _GAP_PX) - _GAP_PX, columns * (width + _GAP_PX) - _GAP_PX, 3)
    canvas = np.full(size, 255, np.uint8)
    for number, picture in enumerate(pictures):
        top, left = (number // columns) * (height + _GAP_PX), (number % columns) * (width + _GAP_PX)
        canvas[top : top + picture.shape[0], left : left + picture.shape[1]] = picture
    return canvas


def _write(banner: Picture, text: str, left: int) -> None:
    at = left, _BANNER_PX - 9
    cv2.putText(banner, text, at, cv2.FONT_HERSHEY_SIMPLEX, _SCALE, (30, 30, 30), 1, cv2.LINE_AA)
