"""Views to be coded: pictures of one size, each with its viewpoint."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dvc.errors import ConfigError
from dvc.geometry.camera_array import CameraArray
from dvc.geometry.viewpoints import Viewpoint, distance
from dvc.images.colour import Picture, luma


@dataclass(frozen=True, eq=False)
class Views:
    """Pictures of one scene."""

    pictures: tuple[Picture, ...]  # gray, or red, green and blue; all alike; tuple of (H, W) or (H, W, 3)
    viewpoints: tuple[Viewpoint, ...]  # of each, of one kind
    references: tuple[int, ...] = (0,)  # numbers of the views that are coded; the others are predicted

    def __post_init__(self) -> None:
        if len(self.pictures) < 2 or len(self.pictures) != len(self.viewpoints):
            raise ConfigError(f"{len(self.pictures)} views: at least two are accepted, with a position each")
        if any(picture.shape != self.pictures[0].shape for picture in self.pictures):
            raise ConfigError("views of different sizes: one size is accepted")
        if not self.references or not set(self.references) <= set(range(len(self.pictures))):
            raise ConfigError(f"references {self.references} of {len(self.pictures)} views")

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""
        return self.pictures[0].shape[0], self.pictures[0].shape[1]

    def predicted_from(self, reference: int) -> list[int]:
        """Return the views that a reference is to predict: all that are not nearer to another one."""
        views = []
        for view, viewpoint in enumerate(self.viewpoints):
            reach = {other: distance(self.viewpoints[other], viewpoint) for other in self.references}
            if view != reference and reach[reference] <= min(reach.values()):
                views.append(view)
        return views or [view for view in range(len(self.pictures)) if view != reference]


def views_of_array(array: CameraArray, references: Sequence[int] = (0,), *, gray: bool = False) -> Views:
    """Return the views of a camera array."""
    return views_of_pictures(
        [view.image for view in array], [view.position for view in array], references, gray=gray
    )


def views_of_pictures(
    pictures: Sequence[Picture],
    viewpoints: Sequence[Viewpoint],
    references: Sequence[int] = (0,),
    *,
    gray: bool = False,
) -> Views:
    """Return views; where no picture has any colour, of luma alone."""
    gray = gray or all(picture.ndim == 2 or not np.ptp(picture, axis=2).any() for picture in pictures)
    kept = tuple(luma(picture) if gray else picture for picture in pictures)
    return Views(kept, tuple(viewpoints), tuple(references))
