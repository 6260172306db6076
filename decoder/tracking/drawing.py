"""Pictures of snakes between two key frames."""

import numpy as np
from numpy.typing import NDArray

from dvc.tracks.points import PointTracks

Floats = NDArray[np.float64]
Picture = NDArray[np.uint8]

ZOOM = 3
_SHIFT = 4  # fractional bits of drawn positions
_RED, _MAGENTA, _GREEN = (40, 40, 235), (220, 60, 220), (70, 200, 40)  # blue, green, red


def draw_snakes(luma: NDArray[np.uint8], tracks: PointTracks) -> Picture:
    """Draw tracks over a key frame: where points were found, and the even motion that they do not follow.

    Parameters
    ----------
    luma : ndarray of shape (H, W), uint8
        First key frame.
    tracks : PointTracks
        Even motion in green, the path in magenta, known positions in red.

    Returns
    -------
    ndarray of shape (3 * H, 3 * W, 3), uint8
        Blue, green and red.
    """
    import cv2

    height, width = luma.shape
    grey = cv2.resize(luma, (ZOOM * width, ZOOM * height), interpolation=cv2.INTER_CUBIC)
    faded = (96 + grey.astype(np.int64) * 150 // 255).astype(np.uint8)
    canvas = np.repeat(faded[:, :, None], 3, axis=2)
    for track in tracks.positions:
        known = track[np.isfinite(track).all(axis=1)]
        _draw_path(canvas, track[[0, -1]], _GREEN)
        _draw_path(canvas, known, _MAGENTA)
        for x, y in _fixed_point(known):
            cv2.circle(canvas, (int(x), int(y)), 2 << _SHIFT, _RED, -1, cv2.LINE_AA, _SHIFT)
    return canvas


def _draw_path(canvas: Picture, points: Floats, colour: tuple[int, int, int]) -> None:
    import cv2

    corners = _fixed_point(points).astype(np.int32).reshape(-1, 1, 2)
    cv2.polylines(canvas, [corners], isClosed=False, color=colour, lineType=cv2.LINE_AA, shift=_SHIFT)


def _fixed_point(points: Floats) -> NDArray[np.int64]:
    """Scale to the enlarged picture, whose pixel centres are between those of the frame."""
    return np.rint((ZOOM * (points + 0.5) - 0.5) * (1 << _SHIFT)).astype(np.int64)
