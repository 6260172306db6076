"""Pictures for people, in blue, green and red: disparities in colours, errors, titles, panels in rows."""

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
    """Colour disparities from far (dark) to near (bright), readable without colour vision.

    Parameters
    ----------
    disparity : ndarray of shape (H, W), float
        In pixels; not finite: unknown.
    lowest, highest : float
        Disparities of the darkest and the brightest colour.

    Returns
    -------
    ndarray of shape (H, W, 3), uint8
        Unknown pixels are grey.
    """
    known = np.isfinite(disparity)
    place = (np.where(known, disparity, lowest) - lowest) / max(highest - lowest, 1e-12)
    levels = np.rint(np.clip(place, 0.0, 1.0) * 255).astype(np.uint8)
    picture = np.asarray(cv2.applyColorMap(levels, cv2.COLORMAP_VIRIDIS), np.uint8)
    picture[~known] = UNKNOWN
    return picture


def colour_error(error: Floats, counted: NDArray[np.bool_], bad_px: float = 1.0) -> Picture:
    """Draw the errors of disparities: white is right, orange half as far off as counts as bad, red bad.

    Parameters
    ----------
    error : ndarray of shape (H, W), float
        Magnitude in pixels; infinite where there is no value.
    counted : ndarray of shape (H, W), bool
        Where the truth is known and counts; grey elsewhere.
    bad_px : float, optional
        Larger errors are bad.

    Returns
    -------
    ndarray of shape (H, W, 3), uint8
        The picture.
    """
    picture = np.full((*error.shape, 3), UNKNOWN, np.uint8)
    picture[counted] = GOOD
    picture[counted & (error > 0.5 * bad_px)] = NEAR_BAD
    picture[counted & (error > bad_px)] = BAD
    return picture


def colour_counts(counts: NDArray[np.integer], highest: int) -> Picture:
    """Draw whole numbers from 0 (black) to `highest` (white) in even steps.

    Parameters
    ----------
    counts : ndarray of shape (H, W), int
        Such as values of a layered image by pixel.
    highest : int
        What is white, at least 1.

    Returns
    -------
    ndarray of shape (H, W, 3), uint8
        Grey levels.
    """
    grey = np.rint(np.clip(counts / highest, 0.0, 1.0) * 255).astype(np.uint8)
    return np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), np.uint8)


def disparity_legend(width: int, lowest: float, highest: float) -> Picture:
    """Draw the scale of `colour_disparity` with its ends in pixels.

    Parameters
    ----------
    width : int
        In pixels.
    lowest, highest : float
        Disparities of the ends.

    Returns
    -------
    ndarray of shape (h, width, 3), uint8
        A strip to be put below a picture.
    """
    ramp = np.linspace(lowest, highest, width)[None].repeat(10, axis=0)
    bar = colour_disparity(ramp, lowest, highest)
    texts = np.full((_BANNER_PX, width, 3), 255, np.uint8)
    right = f"{highest:g} px, near"
    text_px = cv2.getTextSize(right, cv2.FONT_HERSHEY_SIMPLEX, _SCALE, 1)[0][0]
    _write(texts, f"{lowest:g}", _MARGIN_PX)
    _write(texts, right, width - text_px - _MARGIN_PX)
    return np.asarray(np.vstack([bar, texts]), np.uint8)


def with_title(picture: NDArray[np.uint8], title: str) -> Picture:
    """Put a line of text above a picture.

    Parameters
    ----------
    picture : ndarray of shape (H, W) or (H, W, 3), uint8
        Grey levels, or blue, green and red.
    title : str
        ASCII; what does not fit is cut.

    Returns
    -------
    ndarray of shape (H + 26, W, 3), uint8
        The picture with its title.
    """
    colour = np.repeat(picture[:, :, None], 3, axis=2) if picture.ndim == 2 else picture
    banner = np.full((_BANNER_PX, colour.shape[1], 3), 255, np.uint8)
    _write(banner, title, _MARGIN_PX)
    return np.asarray(np.vstack([banner, colour]), np.uint8)


def in_rows(pictures: Sequence[Picture], columns: int) -> Picture:
    """Put pictures beside and below each other, with white gaps.

    Parameters
    ----------
    pictures : sequence of ndarray of shape (h, w, 3), uint8
        At least one; smaller ones are filled up with white.
    columns : int
        Pictures of a row.

    Returns
    -------
    ndarray of shape (H, W, 3), uint8
        One picture.
    """
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
