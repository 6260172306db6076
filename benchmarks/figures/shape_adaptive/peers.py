"""Other codecs of pictures on Teddy's map, each at its best within the bytes of the rate."""

from collections.abc import Mapping
from functools import cache

import numpy as np

from benchmarks.figures.harness import Figure, Measured, Setting
from benchmarks.figures.shape_adaptive.depth import AREA
from benchmarks.figures.shape_adaptive.maps import TEDDY, coded, material
from dvc.dibr.peers.intra_frames import X265_INTRA
from dvc.dibr.peers.picture_coders import AVIF, AVIF_SLOW, JPEG2000, Ladder, PictureCoder

RATES_BPP = 0.06, 0.08, 0.1, 0.15
LEVELS_PER_PX = 4.0
"""Levels of the map that peers get: quarters of a pixel, which 8 bits hold exactly."""
AVIFS: Mapping[str, PictureCoder] = {"AVIF": AVIF, "AVIF, slowest, for PSNR": AVIF_SLOW}
TO_BEAT: Mapping[str, PictureCoder] = {"JPEG 2000": JPEG2000, "x265 intra": X265_INTRA}


@cache
def _ladder(coder: PictureCoder) -> Ladder:
    return Ladder(coder, np.rint(material(TEDDY).depth * LEVELS_PER_PX).astype(np.uint8))


def peer_db(coder: PictureCoder, rate_bpp: float) -> float | None:
    """Return what a coder makes of Teddy's map."""
    found = _ladder(coder).within(rate_bpp * material(TEDDY).num_pixels / 8.0)
    return None if found is None else material(TEDDY).psnr_db(found.picture / LEVELS_PER_PX)


def depth_peers(setting: Setting, clip: str) -> Measured:
    """Code Teddy's map by all."""
    del clip
    coders = {**TO_BEAT, **AVIFS}
    values: dict[str, dict[str, float | None]] = {}
    row: dict[str, float | None]
    for rate in RATES_BPP[: setting.choose(len(RATES_BPP), 1)]:
        row = {"ours": coded(TEDDY, rate).psnr_db}
        row.update((name, peer_db(coder, rate)) for name, coder in coders.items())
        values[f"{rate:g}_bpp"] = row
    beaten = all(
        row[name] is None or float(row["ours"] or 0.0) > float(row[name] or 0.0)
        for row in values.values()
        for name in TO_BEAT
    )
    each = ("; ".join(f"{name} {_decibels(db)}" for name, db in row.items()) for row in values.values())
    text = ". ".join(f"{rate:g} bpp: {told}" for rate, told in zip(RATES_BPP, each, strict=False))
    note = (
        "peers get quarters of a pixel as 8 bits, exact but for filled holes; containers count, "
        "but not x265's, whose stream counts without messages"
    )
    return Measured(text, beaten, dict(values), note)


def _decibels(value: float | None) -> str:
    return "needs more" if value is None else f"{value:.2f} dB"


FIGURES = (
    Figure(
        AREA,
        "depth-peers",
        "Teddy's map at 0.06, 0.08, 0.10, 0.15 bpp against other codecs at their best quality that fits",
        "above JPEG 2000 and x265 intra at each; as near to AVIF as possible",
        depth_peers,
    ),
)
"""The figures of this module."""
