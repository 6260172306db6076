"""Rendering of decoded pictures with disparities: any view, from one of them or from all."""

from collections.abc import Sequence
from enum import StrEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dvc.dibr.codec.decoder import PictureAndDisparity
from dvc.multiview.view_synthesis import PictureWithDepth, SynthesisedView, synthesise
from dvc.multiview.viewpoints import Viewpoint, distance, warp_between

NEAR_VIEW = 1e-3
"""Added to distances, relative to the largest, before weights are their inverses."""


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
