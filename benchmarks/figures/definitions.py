"""All figures that are defined, and the rows that they make."""

from dataclasses import dataclass
from types import ModuleType

from benchmarks.figures import (
    anchor_rates,
    anchors,
    codec,
    live,
    priors,
    rates,
    report,
    reproduction,
    robustness,
    turbo,
)
from benchmarks.figures.allocation import chroma, foreman, frames, planes, undetected
from benchmarks.figures.allocation import rates as allocation_rates
from benchmarks.figures.allocation import times as allocation_times
from benchmarks.figures.cost import counts, encoder_time, rate_cost, recordings, without_feedback
from benchmarks.figures.dibr import curves, exhaustive, large, peers, reference
from benchmarks.figures.geometry import reconstruction, side_information
from benchmarks.figures.harness import FOREMAN, Figure, Key, Row, Setting
from benchmarks.figures.house import emulation, golden, sources, times
from benchmarks.figures.origin import figure_digest
from benchmarks.figures.shape_adaptive import depth, images, lossless
from benchmarks.figures.shape_adaptive import identities as transform_identities
from benchmarks.figures.shape_adaptive import layers as coded_layers
from benchmarks.figures.shape_adaptive import peers as depth_peers
from benchmarks.figures.shape_adaptive import times as depth_times
from benchmarks.figures.stereo import accuracy, consistency, identities, layers, rectification, toy
from benchmarks.figures.stereo import times as stereo_times
from benchmarks.figures.tracks import costs, fallback, limits, quality
from benchmarks.figures.tracks import rates as tracks_rates
from dvc.errors import ConfigError
from dvc.rd.source_digest import Sources

MODULES: tuple[ModuleType, ...] = (
    turbo,
    codec,
    rates,
    report,
    reproduction,
    anchors,
    anchor_rates,
    allocation_rates,
    frames,
    planes,
    allocation_times,
    chroma,
    foreman,
    undetected,
    counts,
    rate_cost,
    without_feedback,
    encoder_time,
    recordings,
    priors,
    robustness,
    live,
    reconstruction,
    side_information,
    quality,
    limits,
    costs,
    fallback,
    tracks_rates,
    accuracy,
    consistency,
    layers,
    identities,
    rectification,
    toy,
    stereo_times,
    reference,
    exhaustive,
    curves,
    large,
    peers,
    depth,
    depth_peers,
    images,
    lossless,
    coded_layers,
    transform_identities,
    depth_times,
    sources,
    times,
    golden,
    emulation,
)
AREAS_BY_FRAMES = ("rd", "tracks")
ROWS_BY_FRAMES = frozenset(figure.name for figure in anchor_rates.FIGURES) | {"blind", "blind-mean"}
"""What depends on the number of frames of CIF clips."""


@dataclass(frozen=True)
class Unit:
    """One row to measure: a figure on one clip."""

    figure: Figure
    clip: str | None

    @property
    def key(self) -> Key:
        """What tells it from all other rows."""
        return self.figure.area, self.figure.name, self.clip

    @property
    def digest(self) -> str:
        """Of the code that would measure it now."""
        return figure_digest(self.figure, Sources())


def all_units() -> list[Unit]:
    """List the rows that there are."""
    return [Unit(figure, clip) for module in MODULES for figure in module.FIGURES for clip in figure.clips]


def digests() -> dict[Key, str]:
    """Digest the code that measures each row."""
    sources = Sources()
    figures = [figure for module in MODULES for figure in module.FIGURES]
    found = [(figure, figure_digest(figure, sources)) for figure in figures]
    return {(figure.area, figure.name, clip): digest for figure, digest in found for clip in figure.clips}


def selected_units(area: str | None, name: str | None, clip: str | None, quick: bool) -> list[Unit]:
    """Choose rows."""
    units = [
        unit
        for unit in all_units()
        if area in (None, unit.figure.area) and name in (None, unit.figure.name) and clip in (None, unit.clip)
    ]
    if name is None:
        units = [unit for unit in units if not (unit.figure.on_request or (quick and unit.figure.slow))]
    if quick and clip is None:
        units = [unit for unit in units if unit.clip == unit.figure.clips[0]]
    if not units:
        areas = ", ".join(dict.fromkeys(unit.figure.area for unit in all_units()))
        raise ConfigError(f"no figure of that area, name and clip; areas are {areas}; see --list")
    return units


def with_frames(row: Row, frames: int) -> Row:
    """Say in the command of a row how many frames of CIF clips it covers, where that is not the default."""
    varies = row["area"] in AREAS_BY_FRAMES or row["name"] in ROWS_BY_FRAMES
    if not varies or row["clip"] == FOREMAN or frames == Setting.frames:
        return row
    note = "; ".join(filter(None, [row["note"], f"{frames} frames"]))
    return row | {"command": f"{row['command']} --frames {frames}", "note": note}
