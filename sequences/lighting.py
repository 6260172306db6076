"""Light that does not move: the sun's shadow map, and the share of the sky that each vertex sees."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sequences import _kernels
from sequences._kernels import LEAF, Light, Surface, Textures
from sequences.cameras import look_at
from sequences.meshes import Mesh

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

DISTANCE_M = 2000.0


@dataclass(frozen=True)
class Weather:
    """Sun, sky and air of a scene; colours are linear RGB, relative to each other."""

    # where the sun stands: azimuth clockwise from forward (y), elevation above the horizon
    azimuth_deg: float
    elevation_deg: float
    # irradiance of the sun, of the open sky, and light thrown back by the ground
    sun: tuple[float, float, float] = (2.9, 2.62, 2.2)
    sky: tuple[float, float, float] = (0.72, 0.86, 1.06)
    ground: tuple[float, float, float] = (0.34, 0.31, 0.27)
    # radiance of the horizon, of the sky overhead and of clouds
    haze: tuple[float, float, float] = (0.66, 0.76, 0.90)
    zenith: tuple[float, float, float] = (0.15, 0.29, 0.62)
    cloud: tuple[float, float, float] = (1.55, 1.52, 1.50)
    haze_per_m: float = 0.0014  # extinction of the air

    @property
    def to_sun(self) -> Floats:
        """Unit vector towards the sun, shape (3,)."""
        azimuth, elevation = math.radians(self.azimuth_deg), math.radians(self.elevation_deg)
        flat = math.cos(elevation)
        return np.array([math.sin(azimuth) * flat, math.cos(azimuth) * flat, math.sin(elevation)])


@dataclass(frozen=True)
class LightMaps:
    """Where and how finely light is computed."""

    centre: tuple[float, float, float]  # middle of the region that the camera sees from near, metres
    radius_m: float  # its radius; outside, everything is in full light
    shadow_size: int = 1536  # side of the sun's shadow map in texels
    sky_size: int = 512  # side of the depth map of each sky direction in texels
    directions: int = 40  # number of sky directions

    def at(self, detail: float) -> "LightMaps":
        """Return what a scene of less detail gets: fewer directions, and below 0.3 coarser maps."""
        if detail > 0.3:
            return replace(self, directions=max(8, round(self.directions * detail)))
        return replace(self, shadow_size=self.shadow_size // 2, sky_size=self.sky_size // 2, directions=8)


def sky_directions(count: int) -> Floats:
    """Return `count` unit vectors (count, 3) spread evenly over the upper hemisphere (a golden spiral)."""
    k = np.arange(count) + 0.5
    up = k / count
    azimuth = k * math.pi * (3.0 - math.sqrt(5.0))
    flat = np.sqrt(1.0 - up**2)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), up], axis=-1)


def distant_view(direction: ArrayLike, centre: ArrayLike, radius_m: float, size: int) -> Floats:
    """Return the projection (3, 4) of a far camera that looks at a ball from a direction."""
    middle = np.asarray(centre, dtype=np.float64)
    focal = 0.5 * size * DISTANCE_M / radius_m
    half = (size - 1) / 2
    k = np.array([[focal, 0.0, half], [0.0, focal, half], [0.0, 0.0, 1.0]])
    projection: Floats = k @ look_at(middle + DISTANCE_M * np.asarray(direction, dtype=np.float64), middle)
    return projection


def depth_map(mesh: Mesh, projection: Floats, size: int) -> Singles:
    """Return the inverse depth (size, size) of a mesh in a distant view, 0 where there is nothing."""
    projected = np.empty_like(mesh.points)
    _kernels.transform(projection, mesh.points, projected)
    inverse = np.zeros((size, size), dtype=np.float32)
    _kernels.rasterize(projected, mesh.triangles, inverse, np.full((size, size), -1, dtype=np.int32))
    return inverse


def sky_visibility(mesh: Mesh, thin: NDArray[np.bool_], maps: LightMaps) -> Floats:
    """Return the cosine-weighted share of the sky that each vertex sees, shape (N,), in [0, 1]."""
    texel_m = 2 * maps.radius_m / maps.sky_size
    lifted = mesh.points + np.where(thin, 0.0, 0.04)[:, None] * mesh.normals
    seen, total = np.zeros(len(lifted)), np.full(len(lifted), 1e-9)
    projected = np.empty_like(lifted)
    for direction in sky_directions(maps.directions):
        projection = distant_view(direction, maps.centre, maps.radius_m, maps.sky_size)
        inverse = depth_map(mesh, projection, maps.sky_size)
        _kernels.transform(projection, lifted, projected)
        cosine = mesh.normals[:, 0] * direction[0] + mesh.normals[:, 1] * direction[1]
        weight = np.where(thin, 0.5, np.maximum(cosine + mesh.normals[:, 2] * direction[2], 0.0))
        _kernels.add_visibility(projected, inverse, weight, 1.2 * texel_m, seen, total)
    return np.asarray(seen / total)


def illuminate(mesh: Mesh, textures: Textures, weather: Weather, maps: LightMaps) -> tuple[Surface, Light]:
    """Compute the light of a scene that stands still."""
    thin = np.zeros(len(mesh.points), dtype=np.bool_)
    thin[mesh.triangles[textures.kind[mesh.materials] == LEAF].ravel()] = True
    ambient = sky_visibility(mesh, thin, maps)
    shadow_from_world = distant_view(weather.to_sun, maps.centre, maps.radius_m, maps.shadow_size)
    inverse = depth_map(mesh, shadow_from_world, maps.shadow_size)
    with np.errstate(divide="ignore"):
        shadow_depth = (np.float32(1.0) / inverse).astype(np.float32)
    surface = Surface(mesh.points, mesh.normals, mesh.uv, mesh.tint, ambient, mesh.triangles, mesh.materials)
    colours = (weather.sun, weather.sky, weather.ground, weather.haze)
    sun, sky, ground, haze = (np.array(colour, dtype=np.float64) for colour in colours)
    zenith, cloud = np.array(weather.zenith, dtype=np.float64), np.array(weather.cloud, dtype=np.float64)
    light = Light(
        weather.to_sun,
        sun,
        sky,
        ground,
        haze,
        weather.haze_per_m,
        shadow_from_world,
        shadow_depth,
        zenith,
        cloud,
    )
    return surface, light
