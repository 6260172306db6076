"""Projective cameras: pixels and normalised coordinates, projection, and pairs of views.

Convention: a camera is a 3x4 matrix in *normalised coordinates* of the image (`PixelFrame`), of any scale and
sign. Pixel centres are at whole numbers. Depth is projective: positive before the camera once the matrix has
the sign that gives its left part a positive determinant; inverse depth is 0 at infinity and grows towards the
camera.
"""

from dataclasses import dataclass

import numpy as np

from dvc.arrays import Floats

COLMAP_FIRST_PIXEL_PX = 0.5
"""Position of the centre of the first pixel in COLMAP, both ways; here it is 0."""
RANGE_QUANTILES = (0.005, 0.995)
"""Quantiles of known inverse depths that bound the range of a view: a few wrong points do not stretch it."""


def homogeneous(points: Floats) -> Floats:
    """Append a third coordinate 1."""
    return np.column_stack([points, np.ones(len(points))])


def project(camera: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Project 3D points."""
    image = points @ camera.T
    with np.errstate(divide="ignore", invalid="ignore"):
        return image[:, :2] / image[:, 2:], image[:, 2]


@dataclass(frozen=True)
class PixelFrame:
    """Coordinates in which a whole image has about unit size, for the algebra of cameras."""

    width_px: int  # size of the image
    height_px: int

    @property
    def scale_px(self) -> float:
        """Pixels per unit."""
        return float(max(self.width_px, self.height_px))

    @property
    def normalized_from_pixel(self) -> Floats:
        """Homography (3, 3) from pixels to normalised coordinates."""
        s, (x, y) = 1.0 / self.scale_px, self._centre
        return np.array([[s, 0.0, -s * x], [0.0, s, -s * y], [0.0, 0.0, 1.0]])

    @property
    def pixel_from_normalized(self) -> Floats:
        """Homography (3, 3) from normalised coordinates to pixels."""
        s, (x, y) = self.scale_px, self._centre
        return np.array([[s, 0.0, x], [0.0, s, y], [0.0, 0.0, 1.0]])

    def to_normalized(self, points: Floats) -> Floats:
        """Convert points from pixels."""
        return np.asarray((points - self._centre) / self.scale_px)

    def to_pixels(self, points: Floats) -> Floats:
        """Convert points to pixels; inverse of `to_normalized`."""
        return np.asarray(points * self.scale_px + self._centre)

    @property
    def _centre(self) -> Floats:
        return np.array([0.5 * (self.width_px - 1), 0.5 * (self.height_px - 1)])


def oriented(camera: Floats) -> Floats:
    """Give a camera the sign that gives points before it a positive depth."""
    return -camera if np.linalg.det(camera[:, :3]) < 0 else camera


def inverse_depth_range(known: Floats) -> tuple[float, float]:
    """Return the range of the inverse depths of known points."""
    finite = known[np.isfinite(known)]
    if not finite.size:
        return 0.0, 0.0
    lowest, highest = np.quantile(finite, RANGE_QUANTILES)
    return float(lowest), float(highest)


@dataclass(frozen=True, eq=False)
class ViewPair:
    """Cameras and depth ranges of two views of a static scene."""

    pixel_frame: PixelFrame  # size of both pictures
    cameras: tuple[Floats, Floats]  # in normalised coordinates
    # lowest and highest inverse depth of the scene in each view
    inverse_depth_ranges: tuple[tuple[float, float], tuple[float, float]]
