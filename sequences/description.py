"""A rendered scene before it is built: what it shows, how the camera moves, how it is made and lit."""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from sequences.lighting import LightMaps, Weather
from sequences.meshes import Mesh

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Description:
    """A scene as data: what is known of it, and the functions that build it."""

    name: str  # name by which it is asked for
    frame_rate: Fraction  # frames per second
    num_frames: int  # usual length of a sequence; any other works too
    field_of_view_deg: float  # horizontal
    exposure: float  # factor from radiance to the input of the tone curve
    shows: str  # one sentence each, for the catalogue
    motion: str
    purpose: str
    # mean, smallest and largest frame mean of tracked motion at 352x288, in pixels per frame
    motion_px: tuple[float, float, float]
    # function of frame number (a float) and seed to ``cam_from_world`` (3, 4), metres
    pose: Callable[[float, int], Floats]
    # function of a random generator and the share of the leaves, in (0, 1], to everything in the scene
    geometry: Callable[[np.random.Generator, float], Mesh]
    weather: Weather  # sun, sky and air
    light: LightMaps  # where and how finely light is computed
