"""Rendering of decoded pictures with disparities: any view, from one reference or from all."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.geometry.view_synthesis import PictureWithDepth, SynthesisedView, synthesise
from dvc.geometry.viewpoints import Viewpoint, distance, warp_between

NEAR_VIEW = 1e-3
"""Offset of distances, relative to the largest, before weights are taken as their inverses."""


@dataclass(frozen=True, eq=False)
class PictureAndDisparity:
    """A decoded reference."""

    picture: NDArray[np.uint8]  # gray, or red, green and blue; (H, W) or (H, W, 3)
    # pixels of the picture per unit of m and n; inverse depth for calibrated cameras; (H, W)
    disparity: NDArray[np.float64]
    viewpoint: Viewpoint  # viewpoint of its camera


class DecodedViews(Protocol):
    """A decoded stream of any kind, as rendering needs it."""

    @property
    def pairs(self) -> tuple[PictureAndDisparity, ...]:
        """Pictures with disparities, of one size."""

    @property
    def viewpoints(self) -> tuple[Viewpoint, ...]:
        """Viewpoints of all views of the stream, of one kind."""

    @property
    def step(self) -> float:
        """Distance of neighbouring disparities; 0: they are continuous."""

    @property
    def damage(self) -> str | None:
        """Description of the missing parts of the stream."""


class Blend(StrEnum):
    """Ways to combine references that see the same point."""

    NEAREST = "nearest"
    """The nearest reference that sees the point."""
    DISTANCE = "distance"
    """The mean of all that see it, weighted by inverse distance."""


def render(decoded: DecodedViews, viewpoint: Viewpoint, blend: Blend = Blend.DISTANCE) -> SynthesisedView:
    """Render a view.

    Parameters
    ----------
    decoded : DecodedViews
        Pictures and disparities.
    viewpoint : Viewpoint
        The target, of the same kind as those of the stream.
    blend : Blend, optional
        How references that see the same point are combined.

    Returns
    -------
    SynthesisedView
        The view, of the size of the pictures.
    """
    return render_pairs(decoded.pairs, viewpoint, decoded.step, blend)


def render_pairs(
    pairs: Sequence[PictureAndDisparity], viewpoint: Viewpoint, step: float, blend: Blend = Blend.DISTANCE
) -> SynthesisedView:
    """Render a view from pictures with disparities."""
    distances = [distance(pair.viewpoint, viewpoint) for pair in pairs]
    near = NEAR_VIEW * max(*distances, 1e-9)
    weights = [near / (reach + near) for reach in distances]
    if blend is Blend.NEAREST:
        weights = [float(index == int(np.argmin(distances))) for index in range(len(distances))]
    sources = []
    for pair, weight in zip(pairs, weights, strict=True):
        image, warp = (
            pair.picture.reshape(*pair.picture.shape[:2], -1),
            warp_between(pair.viewpoint, viewpoint),
        )
        sources.append(PictureWithDepth(image, pair.disparity, warp, step, weight))
    height, width = pairs[0].picture.shape[:2]
    return synthesise(sources, (height, width))


def picture_of(view: SynthesisedView) -> NDArray[np.uint8]:
    """Return a view as a picture of 8 bits."""
    levels = np.clip(np.floor(view.image + 0.5), 0.0, 255.0).astype(np.uint8)
    return levels[..., 0] if levels.shape[2] == 1 else levels


def with_margin(picture: NDArray[np.uint8], mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Fill two pixels around a mask, for interpolation, with the mean colour of their neighbours."""
    if mask.all():
        return picture
    weight, total = mask.astype(np.float32), np.where(mask[..., None], picture, 0).astype(np.float32)
    for _ in range(2):
        count = cv2.blur(weight, (3, 3), borderType=cv2.BORDER_CONSTANT)
        mean = cv2.blur(total, (3, 3), borderType=cv2.BORDER_CONSTANT) / np.maximum(count, 1e-6)[..., None]
        new = (weight == 0.0) & (count > 1e-6)
        total[new], weight[new] = mean[new], 1.0
    return np.asarray(np.clip(np.rint(total), 0, 255), np.uint8)
