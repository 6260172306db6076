"""Depth maps against the standard transform: Teddy's, others of its kind, and rendered ones."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from benchmarks.figures.harness import Figure, Measured, Setting
from benchmarks.figures.shape_adaptive.maps import (
    OTHER_TRUTHS,
    OTHERS,
    RENDERED,
    TEDDY,
    coded,
    gain_db,
)
from dvc.dibr.thesis.chapter4.curves import MAP_RATES, STANDARD

AREA = "shape-adaptive"
RATE_BPP = 0.04
ASKED_DB = 36.2, 39.9
ASKED_GAIN_DB = 5.5
ASKED_EDGES_BPP = 0.015
ASKED_MEAN_DB = 3.0
_TEDDY = "Teddy's map (disp2 / 4, holes filled, all pixels, no rounding, peak 53)"


def teddy(setting: Setting, clip: str) -> Measured:
    """Code Teddy's map by both transforms."""
    del setting, clip
    standard, adaptive = coded(TEDDY, RATE_BPP, STANDARD), coded(TEDDY, RATE_BPP)
    values = {STANDARD: standard.to_dict(), "shape-adaptive": adaptive.to_dict()}
    holds = standard.psnr_db >= ASKED_DB[0] and adaptive.psnr_db >= ASKED_DB[1]
    text = f"{standard.psnr_db:.2f} → {adaptive.psnr_db:.2f} dB"
    return Measured(text, holds, values, f"{standard.num_bytes} and {adaptive.num_bytes} bytes")


def largest_gain(setting: Setting, clip: str) -> Measured:
    """Code Teddy's map by both transforms at several rates."""
    del clip
    rates = MAP_RATES[2:3] if setting.quick else MAP_RATES
    gains = {rate: gain_db(TEDDY, rate) for rate in rates}
    best = max(gains, key=lambda rate: gains[rate])
    each = ", ".join(f"{rate:g}: {gain:+.2f}" for rate, gain in gains.items())
    values = {f"gain_db_at_{rate:g}_bpp": gain for rate, gain in gains.items()}
    return Measured(f"{gains[best]:+.2f} dB at {best:g} bpp", gains[best] >= ASKED_GAIN_DB, values, each)


def edges(setting: Setting, clip: str) -> Measured:
    """Count the bits of the edges that are selected for Teddy's map."""
    del clip
    rates = [rate for rate in MAP_RATES if rate >= RATE_BPP][: setting.choose(len(MAP_RATES), 1)]
    found = {rate: coded(TEDDY, rate).edges_bpp for rate in rates}
    note = ", ".join(f"{rate:g} bpp: {bpp:.4f}" for rate, bpp in found.items() if rate > RATE_BPP)
    values = {f"edges_bpp_at_{rate:g}_bpp": bpp for rate, bpp in found.items()}
    least = found[RATE_BPP]
    elements = coded(TEDDY, RATE_BPP).edges.count()
    return Measured(f"{least:.4f} bpp, {elements} edges", least <= ASKED_EDGES_BPP, values, note)


def gains(setting: Setting, clip: str, names: Sequence[str], asked: bool) -> Measured:
    """Code maps by both transforms at one rate."""
    del clip
    found = {name: gain_db(name, RATE_BPP) for name in names[: setting.choose(len(names), 1)]}
    mean, least = float(np.mean(list(found.values()))), min(found.values())
    values = {
        name: {"gain_db": gain, "psnr_db": coded(name, RATE_BPP).psnr_db} for name, gain in found.items()
    }
    each = ", ".join(f"{name} {gain:+.2f}" for name, gain in found.items())
    holds = mean >= ASKED_MEAN_DB and least >= 0.0 if asked else None
    return Measured(f"mean {mean:+.2f} dB, least {least:+.2f} dB", holds, values, each)


FIGURES = (
    Figure(
        AREA,
        "depth-teddy",
        f"{_TEDDY} in whole files of {RATE_BPP:g} bpp: standard 9/7 → shape-adaptive, edges selected",
        f"≥ {ASKED_DB[0]:g} → ≥ {ASKED_DB[1]:g} dB",
        teddy,
        thesis="36.21 → 39.86 dB",
    ),
    Figure(
        AREA,
        "depth-gain",
        f"{_TEDDY}: largest gain over the standard transform, 0.02 to 0.25 bpp",
        f"≥ {ASKED_GAIN_DB:g} dB",
        largest_gain,
        thesis="5.46 dB",
    ),
    Figure(
        AREA,
        "depth-edges",
        f"Teddy's map: bits of the selected edges in a file of {RATE_BPP:g} bpp",
        f"≤ {ASKED_EDGES_BPP:g} bpp",
        edges,
        thesis="0.015 bpp",
    ),
    Figure(
        AREA,
        "depth-others",
        f"six other maps of the kind of Teddy's at {RATE_BPP:g} bpp: gain over the standard transform",
        f"≥ +{ASKED_MEAN_DB:g} dB on average, none below 0",
        partial(gains, names=OTHERS, asked=True),
    ),
    Figure(
        AREA,
        "depth-rendered",
        f"exact depth of rendered scenes, of cgtoy and of antinous at {RATE_BPP:g} bpp: gain over the "
        "standard transform",
        "printed",
        partial(gains, names=(*RENDERED, *OTHER_TRUTHS), asked=False),
    ),
)
"""The figures of this module."""
