"""Tracks between two frames, refined below the pixel by the pictures."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sfm.correspondences.densification import neighbourhood_variances
from sfm.correspondences.matching import MatchingSettings
from sfm.correspondences.refinement import refine
from sfm.model import Correspondences

Image = NDArray[np.uint8]

MAX_TRACK_ERROR_PX = 1.0
"""Farther than this from where a track was rounded to, something else is found."""


def refined_tracks(
    first: Image, second: Image, tracked: Correspondences, settings: MatchingSettings | None = None
) -> Correspondences:
    """Move the second points of tracks to where neighbourhoods are most alike, if that is near."""
    how = settings or MatchingSettings()
    at = np.rint(tracked.first)
    start = tracked.second + at - tracked.first
    moved, _, found = refine(first, second, at, start, how.refinement)
    moved, error, also = refine(first, second, at, moved, replace(how.refinement, affine=True))
    variance = neighbourhood_variances(first, at, how.refinement.radius_px)
    found &= also & (error <= how.min_error + how.refined_error_share * variance)
    found &= ((moved - start) ** 2).sum(axis=1) <= MAX_TRACK_ERROR_PX**2
    return Correspondences(at, np.where(found[:, None], moved, start), np.where(found, error, tracked.error))
