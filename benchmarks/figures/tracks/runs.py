"""Ways to predict the frames of tracked coding, and what is predicted in that way."""

from dataclasses import dataclass, replace

from dvc.config import VARIANTS

GOP = {name: VARIANTS[name].groups("keys").length for name in ("3d-te", "3d-td")}
"""Largest distance of key frames, as the encoder chooses it where only they are references."""
HIERARCHICAL_GOP = VARIANTS["3d-te"].groups("hierarchical").length
"""The same for 3d-te where decoded frames are references, too."""
FIXED_GOP = 10
"""Distance of key frames in the thesis."""
FAST_CLIPS = {"stone": 2}
"""Distance of key frames on clips whose motion leaves no choice."""


@dataclass(frozen=True)
class Way:
    """A way to predict."""

    codec: str  # codec, and the method of side information
    method: str
    track_corrections: bool = False  # whether tracks correct what is rendered
    path_regularity: float = 0.0  # weight of second differences of the camera's path
    subpixel_bits: int | None = None  # precision of the tracks; None: the encoder's default

    @property
    def name(self) -> str:
        """As it is called in tables, such as ``3D-DVC-TE (depth)``."""
        variant = {"2d": "2D-DVC", "3d": "3D-DVC", "3d-td": "3D-DVC-TD", "3d-te": "3D-DVC-TE"}[self.codec]
        return f"{variant} ({'block motion' if self.method == 'mci' else self.method})"


BLOCK_MOTION = Way("2d", "mci")
BLIND_BLOCKS, BLIND_DEPTH = Way("3d", "blocks"), Way("3d", "depth")
TD_BLOCKS, TD_DEPTH = Way("3d-td", "blocks"), Way("3d-td", "depth")
TE_BLOCKS, TE_DEPTH = Way("3d-te", "blocks"), Way("3d-te", "depth")
TE_MESH = Way("3d-te", "mesh")
WAYS = (BLOCK_MOTION, BLIND_BLOCKS, BLIND_DEPTH, TD_BLOCKS, TD_DEPTH, TE_BLOCKS, TE_DEPTH)
"""Those of table 5.1, in its order; dense depth stands where the thesis has its mesh."""


@dataclass(frozen=True)
class Run:
    """What is predicted, from what, and how."""

    clip: str  # sequence
    way: Way  # how the frames are predicted
    num_frames: int  # frames of the sequence, from its first
    gop: int | None = None  # fixed distance of the key frames; None where the tracks choose them
    key_qp: int | None = None  # quantisation parameter of the key frames; None: lossless
    every: int = 1  # 2: only every second frame of a group, from its first

    @property
    def coding(self) -> str:
        """Codec that chooses the key frames."""
        return self.way.codec if self.way.codec in GOP else "3d-te"

    @property
    def stem(self) -> str:
        """Name for a file."""
        keys = "adaptive" if self.gop is None else f"gop{self.gop}"
        quality = "lossless" if self.key_qp is None else f"qp{self.key_qp}"
        way = self.way
        parts = [self.clip, way.codec, way.method, keys, quality, self.num_frames, self.every]
        if replace(way, codec=BLOCK_MOTION.codec, method=BLOCK_MOTION.method) != BLOCK_MOTION:
            parts += [int(way.track_corrections), way.path_regularity, way.subpixel_bits]
        return "_".join(map(str, parts))
