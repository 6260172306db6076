"""The rendered scenes: what each is, how its camera moves, and how it is built."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dvc.errors import ConfigError
from sequences._kernels import Light, Surface, Textures
from sequences.cameras import Camera, intrinsics
from sequences.description import Description

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene that is built and lit, ready to be rendered from any camera.

    Attributes
    ----------
    description : Description
        Name, frame rate, motion.
    seed : int
        What textures, plants and tremor were drawn from.
    surface : Surface
        Triangles with baked light.
    textures : Textures
        Texture atlas and material table.
    light : Light
        Sun, sky, haze.
    """

    description: Description
    seed: int
    surface: Surface
    textures: Textures
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


def descriptions() -> dict[str, Description]:
    """Return the scenes that exist by name, without building them."""
    from sequences import rounds, stairway, statue, street

    return {module.DESCRIPTION.name: module.DESCRIPTION for module in (street, stairway, statue, rounds)}


def arrays() -> dict[str, Description]:
    """Return the scenes that a camera array sees, by name, without building them."""
    from sequences import toy

    return {toy.DESCRIPTION.name: toy.DESCRIPTION}


@lru_cache(maxsize=3)
def scene(name: str, seed: int = 0, detail: float = 1.0) -> Scene:
    """Build a scene; the last three are kept.

    Parameters
    ----------
    name : str
        ``"street"``, ``"stairway"``, ``"statue"``, ``"rounds"`` or ``"toy"``.
    seed : int
        Draws textures, plants, window contents and the tremor of the hand.
    detail : float
        Share of the leaves and of the sky directions, in (0, 1]; small values build fast and look coarse.

    Returns
    -------
    Scene
        Geometry, textures and light.

    Raises
    ------
    ConfigError
        If there is no scene of that name.
    ValueError
        If `detail` is out of range or `seed` negative.
    """
    from sequences.lighting import illuminate
    from sequences.textures import build

    if not 0.0 < detail <= 1.0:
        raise ValueError(f"`detail` must be in (0, 1], got {detail}")
    if seed < 0:
        raise ValueError(f"`seed` must not be negative, got {seed}")
    known = descriptions() | arrays()
    if name not in known:
        raise ConfigError(f"no scene is called {name!r}; there are {', '.join(known)}")
    description = known[name]
    mesh = description.geometry(np.random.default_rng([seed, 1]), detail)
    textures = build(used_materials(mesh.materials), seed)
    surface, light = illuminate(mesh, textures, description.weather, description.light.at(detail))
    return Scene(description, seed, surface, textures, light)


def used_materials(numbers: NDArray[np.int32]) -> list[str]:
    """Return the names of the textures whose numbers occur."""
    from sequences.textures import MATERIALS

    names = list(MATERIALS)
    return [names[i] for i in np.unique(numbers)]
