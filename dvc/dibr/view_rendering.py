"""Rendering of decoded pictures with disparities: any view, from one of them or from all."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.geometry.view_synthesis import PictureWithDepth, SynthesisedView, synthesise
from dvc.geometry.viewpoints import Viewpoint, distance, warp_between

Floats = NDArray[np.float64]

NEAR_VIEW = 1e-3
"""Added to distances, relative to the largest, before weights are their inverses."""


@dataclass(frozen=True, eq=False)
class PictureAndDisparity:
    """A decoded reference."""

    picture: NDArray[np.uint8]  # gray, or red, green and blue; (H, W) or (H, W, 3)
    # in pixels of the picture per unit of m and n; of calibrated cameras, inverse depth; (H, W)
    disparity: Floats
    viewpoint: Viewpoint  # of its camera


class DecodedViews(Protocol):
    """What there is to render of a decoded stream, of any kind."""

    @property
    def pairs(self) -> tuple[PictureAndDisparity, ...]:
        """Pictures with disparities, of one size."""

    @property
    def viewpoints(self) -> tuple[Viewpoint, ...]:
        """Of all views of the stream, of one kind."""

    @property
    def step(self) -> float:
        """Distance of the disparities that are distinguished; 0: all are."""

    @property
    def damage(self) -> str | None:
        """What is missing of the stream."""


class Blend(StrEnum):
    """What is shown where several references see a point."""

    NEAREST = "nearest"
    """The nearest of them that sees anything there."""
    DISTANCE = "distance"
    """All that see it, by the inverse of their distance."""


def render(decoded: DecodedViews, viewpoint: Viewpoint, blend: Blend = Blend.DISTANCE) -> SynthesisedView:
    """Render a view.

    Parameters
    ----------
    decoded : DecodedViews
        Pictures and disparities.
    viewpoint : Viewpoint
        The wanted one, of the kind of the others.
    blend : Blend, optional
        What is shown where several references see a point.

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
    away = [distance(pair.viewpoint, viewpoint) for pair in pairs]
    near = NEAR_VIEW * max(*away, 1e-9)
    weights = [near / (reach + near) for reach in away]
    if blend is Blend.NEAREST:
        weights = [float(index == int(np.argmin(away))) for index in range(len(away))]
    sources = [
        PictureWithDepth(
            pair.picture.reshape(*pair.picture.shape[:2], -1),
            pair.disparity,
            warp_between(pair.viewpoint, viewpoint),
            step,
            weight,
        )
        for pair, weight in zip(pairs, weights, strict=True)
    ]
    shape = pairs[0].picture.shape
    return synthesise(sources, (shape[0], shape[1]))


def picture_of(view: SynthesisedView) -> NDArray[np.uint8]:
    """Return the picture of a view, as files have it."""
    levels = np.clip(np.floor(view.image + 0.5), 0.0, 255.0).astype(np.uint8)
    return levels[..., 0] if levels.shape[2] == 1 else levels


def continued(picture: NDArray[np.uint8], mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Give two pixels beside a mask the mean colour of their neighbours: interpolation reaches so far."""
    if mask.all():
        return picture
    known, total = mask.astype(np.float32), np.where(mask[..., None], picture, 0).astype(np.float32)
    for _ in range(2):
        count = cv2.blur(known, (3, 3), borderType=cv2.BORDER_CONSTANT)
        mean = cv2.blur(total, (3, 3), borderType=cv2.BORDER_CONSTANT) / np.maximum(count, 1e-6)[..., None]
        new = (known == 0.0) & (count > 1e-6)
        total[new], known[new] = mean[new], 1.0
    return np.asarray(np.clip(np.rint(total), 0, 255), np.uint8)
