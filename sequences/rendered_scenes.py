"""Scenes that are built and lit, ready to be rendered."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dvc.errors import ConfigError
from sequences import _kernels
from sequences._kernels import Light, Materials, Surface
from sequences.scene_cameras import Camera, intrinsics, look_at, transformed
from sequences.scene_layouts import ARRAY_SCENES, VIDEO_SCENES
from sequences.scenery import Description
from sequences.shapes import MATERIALS, Colour, Mesh

Floats = NDArray[np.float64]

SUN_DISTANCE_M = 2000.0
SUN: Colour = (2.7, 2.4, 1.95)
SKY: Colour = (0.62, 0.74, 0.92)
GROUND: Colour = (0.3, 0.27, 0.23)
HAZE: Colour = (0.66, 0.76, 0.90)
ZENITH: Colour = (0.15, 0.29, 0.62)


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene that is built and lit, ready to be rendered from any camera.

    Attributes
    ----------
    description : Description
        Name, frame rate, motion.
    seed : int
        Seed of textures, plants and tremor.
    surface : Surface
        Triangles.
    materials : Materials
        Table of textures.
    light : Light
        Sun, sky, haze.
    """

    description: Description
    seed: int
    surface: Surface
    materials: Materials
    light: Light

    def camera(self, index: float, width: int = 352, height: int = 288) -> Camera:
        """Return the camera of a frame.

        Parameters
        ----------
        index : float
            Frame number, from 0; fractions lie between frames.
        width, height : int
            Image size in pixels.

        Returns
        -------
        Camera
            Intrinsics and pose.
        """
        k = intrinsics(width, height, self.description.field_of_view_deg)
        return Camera(k, self.description.pose(index, self.seed), width, height)


@lru_cache(maxsize=3)
def scene(name: str, seed: int = 0) -> Scene:
    """Build a scene; the last three are cached.

    Parameters
    ----------
    name : str
        ``"street"``, ``"stairway"``, ``"statue"``, ``"rounds"`` or ``"toy"``.
    seed : int
        Seed of textures, plants and the tremor of the hand.

    Returns
    -------
    Scene
        Geometry, textures and light.

    Raises
    ------
    ConfigError
        If there is no scene of that name.
    ValueError
        If `seed` is negative.
    """
    if seed < 0:
        raise ValueError(f"`seed` must not be negative, got {seed}")
    described = VIDEO_SCENES | ARRAY_SCENES
    if name not in described:
        raise ConfigError(f"no scene is called {name!r}; the scenes are {', '.join(described)}")
    description = described[name]
    mesh = description.geometry(np.random.default_rng([seed, 1]))
    surface = Surface(mesh.points, mesh.normals, mesh.uv, mesh.triangles, mesh.materials, mesh.tints)
    table = (np.array(column, dtype=np.float64) for column in zip(*MATERIALS.values(), strict=True))
    return Scene(
        description, seed, surface, Materials._make([*table, 1009 * seed]), illuminate(mesh, description)
    )


def illuminate(mesh: Mesh, description: Description) -> Light:
    """Return the light of a scene, with the shadows of its mesh."""
    azimuth, elevation = np.radians(description.sun_deg)
    flat = math.cos(elevation)
    to_sun = np.array([math.sin(azimuth) * flat, math.cos(azimuth) * flat, math.sin(elevation)])
    centre, radius_m = np.array(description.shadows[0]), description.shadows[1]
    size = description.shadow_size
    focal, half = 0.5 * size * SUN_DISTANCE_M / radius_m, (size - 1) / 2
    k = np.array([[focal, 0.0, half], [0.0, focal, half], [0.0, 0.0, 1.0]])
    shadow_from_world = k @ look_at(centre + SUN_DISTANCE_M * to_sun, centre)
    inverse, ids = np.zeros((size, size), dtype=np.float32), np.full((size, size), -1, dtype=np.int32)
    _kernels.rasterize(transformed(shadow_from_world, mesh.points), mesh.triangles, inverse, ids)
    with np.errstate(divide="ignore"):
        shadow_depth = np.float32(1.0) / inverse
    colours = (np.array(colour, dtype=np.float64) for colour in (SUN, SKY, GROUND, HAZE, ZENITH))
    return Light._make([to_sun, *colours, shadow_from_world, shadow_depth])
