"""Local corrections of a rendered frame: tracks tell by how much its motion misses at their points.

Cameras and depths are never exact, and things move. Where residuals of neighbouring tracks agree, they are no
chance, and a smooth field of them moves what is fetched from each key frame.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from decoder.side_information.protocol import Interpolation
from decoder.side_information.residual_fields import NEAR, Field, corrected_positions
from dvc.geometry.sampling import sample

Floats = NDArray[np.float64]
Luma = NDArray[np.uint8]


def corrected(
    rendered: Interpolation,
    keys: tuple[Luma, Luma],
    tracks: tuple[Floats, Floats, Floats],
    fields: Sequence[Field] = NEAR,
) -> Interpolation:
    """Correct a rendered frame by the residuals of tracks."""
    before, wanted, after = tracks
    luma, compensated, moved = rendered.luma, [], []
    for key, there, positions, weight, old in zip(
        keys, (before, after), rendered.positions, rendered.weights, rendered.compensated, strict=True
    ):
        place = corrected_positions(positions, wanted, there, fields)
        change = sample(key, place) - sample(key, positions)
        luma = luma + weight * change
        compensated.append(np.clip(old + change, 0.0, 255.0))
        moved.append(place)
    return rendered._replace(
        luma=np.clip(luma, 0.0, 255.0), compensated=tuple(compensated), positions=tuple(moved)
    )
