"""What chapter 5 of the thesis compares: methods of side information, and rate-distortion curves."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

from benchmarks.thesis.chapter import Way
from dvc.rd.specification import Point, Sweep

THESIS_SEQUENCES = ("street", "stairway", "statue")
LOSSLESS_GOP = 10
SEEN_QP = 26
"""QP of the key frames of figure 5.14; the point nearest to it is shown."""
Options = tuple[tuple[str, str], ...]
KEYS: Options = (("references", "keys"),)
TURBO: Options = (("coder", "turbo"), ("noise-model", "coefficient"))
"""Classical turbo codes with punctured parity, and the noise of each coefficient by that of its band."""
CAMERAS: Options = (("sfm", "thesis"),)
"""What the decoder is told: self-calibration and bundle adjustment to the letter."""


@dataclass(frozen=True)
class Preset:
    """How much is measured."""

    frames: int  # most frames of each sequence
    wz_q: tuple[int, ...]  # DISCOVER matrices of the curves as they are written
    qp: tuple[int, ...]  # qualities of ours
    anchor_qp: tuple[int, ...]  # QPs of the anchors
    scenes: tuple[str, ...]  # rendered sequences
    clips: tuple[str, ...]  # real sequences, of which those are taken that the folder of video files has


QUICK = Preset(9, (1, 4, 7), (22, 30, 38), (20, 28, 36, 44), ("street",), ("box",))
FULL = Preset(
    17,
    (1, 2, 4, 6, 8),
    (22, 26, 30, 34, 38),
    tuple(range(20, 45, 4)),
    THESIS_SEQUENCES,
    ("box", "desk", "river", "stone", "tree"),
)
"""The thesis has 50 frames of each sequence; 17 are the longest group of pictures: hours already."""


class Method(NamedTuple):
    """One row of table 5.1."""

    name: str  # as the thesis calls it
    codec: str  # of ours
    side_information: str | None  # what the decoder is told to predict with; None for block motion
    thesis_db: tuple[float, float, float]  # what the thesis has for its street, stairway and statue

    def point(self, sequence: str, frames: int, way: Way) -> Point:
        """Return the point that measures it: predicted from lossless key frames, and from nothing else."""
        method = self.side_information if way is Way.THESIS else None
        options = KEYS if self.codec in ("3d-td", "3d-te") else ()
        sweep = Sweep(
            (sequence,),
            self.codec,
            (1,),
            ("lossless",),
            LOSSLESS_GOP,
            frames=frames,
            luma_only=True,
            options=options,
            side_information=method,
        )
        return _to_the_letter(next(sweep.points()), way)


METHODS = (
    Method("2D-DVC (classical block matching)", "2d", None, (22.3, 19.0, 21.3)),
    Method("3D-DVC (epipolar blocks)", "3d", "blocks", (23.3, 20.0, 22.2)),
    Method("3D-DVC (mesh)", "3d", "mesh", (23.3, 20.1, 22.3)),
    Method("3D-DVC-TD (epipolar blocks)", "3d-td", "blocks", (28.4, 24.7, 25.5)),
    Method("3D-DVC-TD (mesh)", "3d-td", "mesh", (28.9, 25.0, 25.6)),
    Method("3D-DVC-TE (epipolar blocks)", "3d-te", "blocks", (28.6, 28.0, 27.4)),
    Method("3D-DVC-TE (mesh)", "3d-te", "mesh", (29.3, 28.5, 27.6)),
)
"""Rows of table 5.1 of [Maitre2008], with its numbers."""
OURS_METHODS = tuple(method for method in METHODS if method.side_information != "blocks")
"""Ours predict from dense depth: one row for each codec."""

CODECS = {"2D-DVC": "2d", "3D-DVC": "3d", "3D-DVC-TD": "3d-td", "3D-DVC-TE": "3d-te"}
ANCHORS = {"H.264 intra": "intra", "H.264 IPPP": "x264-ippp"}
"""Codecs of figure 5.15, by the names that it has for them."""


def _to_the_letter(point: Point, way: Way) -> Point:
    has_cameras = way is Way.THESIS and point.side_information is not None
    return replace(point, decoder=CAMERAS) if has_cameras else point


def sweeps(sequence: str, preset: Preset, frames: int, way: Way) -> dict[str, list[Point]]:
    """Return the curves of figure 5.15 by name."""
    found = {}
    for name, codec in CODECS.items():
        if way is Way.OURS:
            sweep = Sweep((sequence,), codec, frames=frames, luma_only=True, qp=preset.qp)
        else:
            tracked = codec in ("3d-td", "3d-te")
            options = TURBO + (KEYS if tracked else ())
            sweep = Sweep(
                (sequence,),
                codec,
                preset.wz_q,
                gop=LOSSLESS_GOP if codec in ("3d", "3d-td") else None,
                frames=frames,
                luma_only=True,
                options=tuple(sorted(options)),
                side_information=None if codec == "2d" else "mesh",
            )
        found[name] = [_to_the_letter(point, way) for point in sweep.points()]
    for name, anchor in ANCHORS.items():
        sweep = Sweep(
            (sequence,),
            "2d",
            preset.wz_q,
            gop=1,
            frames=frames,
            luma_only=True,
            anchors=(anchor,),
            anchor_qp=preset.anchor_qp,
        )
        found[name] = [point for point in sweep.points() if not point.has_wyner_ziv and point.codec != "2d"]
    return found


@dataclass(frozen=True)
class Duel:
    """Two curves of figure 5.15, and what the thesis says of them, by sequence."""

    codec: str
    reference: str
    printed: Mapping[str, str]


def _everywhere(text: str) -> dict[str, str]:
    return dict.fromkeys(THESIS_SEQUENCES, text)


_ALL = "better at all rates"
DUELS = (
    Duel("3D-DVC-TE", "2D-DVC", _everywhere(_ALL)),
    Duel(
        "3D-DVC-TD",
        "2D-DVC",
        {"street": _ALL, "stairway": "better up to 990 kbit/s", "statue": "better up to 740 kbit/s"},
    ),
    Duel("3D-DVC-TE", "3D-DVC", _everywhere("better")),
    Duel("3D-DVC-TD", "3D-DVC", _everywhere("better")),
    Duel("3D-DVC-TE", "H.264 intra", _everywhere("better")),
    Duel("3D-DVC-TD", "H.264 intra", _everywhere("better")),
    Duel("3D-DVC-TE", "H.264 IPPP", _everywhere("worse")),
)
"""Comparisons that section 5.5.4 of [Maitre2008] makes."""
