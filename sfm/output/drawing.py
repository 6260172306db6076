"""Pictures of correspondences and epipolar geometry, as figures 5.3 and 5.10 of the thesis."""

import numpy as np
from numpy.typing import NDArray

from sfm.estimation.epipolar import epipolar_lines
from sfm.model import Correspondences

Floats = NDArray[np.float64]
Picture = NDArray[np.uint8]

ZOOM = 3
_SHIFT = 4  # fractional bits of drawn positions
_RED, _MAGENTA, _GREEN = (40, 40, 235), (220, 60, 220), (70, 200, 40)  # blue, green, red
_HALF_LINE_PX = 9.0
_TITLE_PX = 36


def draw_correspondences(
    luma: NDArray[np.uint8], matches: Correspondences, fundamental: Floats | None, title: str
) -> Picture:
    """Draw points, their motion and their epipolar lines over the second key frame."""
    import cv2

    height, width = luma.shape
    grey = cv2.resize(luma, (ZOOM * width, ZOOM * height), interpolation=cv2.INTER_CUBIC)
    faded = (96 + grey.astype(np.int64) * 150 // 255).astype(np.uint8)
    canvas = np.repeat(faded[:, :, None], 3, axis=2)
    if fundamental is not None and len(matches):
        along = _directions(epipolar_lines(fundamental, matches.first))
        _draw_lines(
            canvas, matches.second - _HALF_LINE_PX * along, matches.second + _HALF_LINE_PX * along, _GREEN
        )
    _draw_lines(canvas, matches.first, matches.second, _MAGENTA)
    radius = 2 if len(matches) < 2000 else 1
    for x, y in _fixed_point(matches.second):
        cv2.circle(canvas, (x, y), radius << _SHIFT, _RED, -1, cv2.LINE_AA, _SHIFT)
    banner = np.full((_TITLE_PX, canvas.shape[1], 3), 255, dtype=np.uint8)
    cv2.putText(banner, title, (8, 25), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (30, 30, 30), 1, cv2.LINE_AA)
    picture: Picture = np.vstack([banner, canvas])
    return picture


def _directions(lines: Floats) -> Floats:
    """Return unit vectors along lines."""
    along = np.column_stack([-lines[:, 1], lines[:, 0]])
    norms = np.linalg.norm(along, axis=1, keepdims=True)
    unit: Floats = along / np.where(norms > 0, norms, 1.0)
    return unit


def _fixed_point(points: Floats) -> NDArray[np.int64]:
    """Convert image points to positions on the enlarged canvas, in 1/16 pixels."""
    bounded = np.clip(np.nan_to_num(points), -1e4, 1e4)
    fixed: NDArray[np.int64] = np.rint((bounded * ZOOM + 0.5 * (ZOOM - 1)) * (1 << _SHIFT)).astype(np.int64)
    return fixed


def _draw_lines(canvas: Picture, starts: Floats, ends: Floats, colour: tuple[int, int, int]) -> None:
    import cv2

    for (x0, y0), (x1, y1) in zip(_fixed_point(starts), _fixed_point(ends), strict=True):
        cv2.line(canvas, (x0, y0), (x1, y1), colour, 1, cv2.LINE_AA, _SHIFT)


def side_by_side(pictures: list[Picture]) -> Picture:
    """Put pictures of one height beside each other with a white gap."""
    gap = np.full((pictures[0].shape[0], 12, 3), 255, dtype=np.uint8)
    parts = [pictures[0]]
    for picture in pictures[1:]:
        parts += [gap, picture]
    joined: Picture = np.hstack(parts)
    return joined
