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
    """A scene as data: what is known of it, and the functions that build it.

    Attributes
    ----------
    name : str
        Name by which it is asked for.
    frame_rate : Fraction
        Frames per second.
    num_frames : int
        Usual length of a sequence; any other works too.
    field_of_view_deg : float
        Horizontal.
    exposure : float
        Factor from radiance to the input of the tone curve.
    shows, motion, purpose : str
        One sentence each, for the catalogue.
    motion_px : tuple of float
        Mean, smallest and largest frame mean of tracked motion at 352x288, in pixels per frame.
    pose : callable
        Function of frame number (a float) and seed to ``cam_from_world`` (3, 4), metres.
    geometry : callable
        Function of a random generator and the share of the leaves, in (0, 1], to everything in the scene.
    weather : Weather
        Sun, sky and air.
    light : LightMaps
        Where and how finely light is computed.
    """

    name: str
    frame_rate: Fraction
    num_frames: int
    field_of_view_deg: float
    exposure: float
    shows: str
    motion: str
    purpose: str
    motion_px: tuple[float, float, float]
    pose: Callable[[float, int], Floats]
    geometry: Callable[[np.random.Generator, float], Mesh]
    weather: Weather
    light: LightMaps
