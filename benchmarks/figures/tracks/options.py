"""Options of tracked coding that are off by default, and what each gains in side information."""

from functools import partial

from benchmarks.figures.harness import SCENES, STATIC_CLIPS, Figure
from benchmarks.figures.tracks.prediction import TE_MESH, Way
from benchmarks.figures.tracks.quality import AREA, Comparison, gain, mean_gain

_CLIPS = (*STATIC_CLIPS, *SCENES)
_WHOLE_PIXELS = Way("3d-te", "mesh", subpixel_bits=0)
_OPTIONS = {
    "fused": ("`--side-information fused` in place of mesh", TE_MESH, Way("3d-te", "fused")),
    "corrections": ("`--track-corrections`", TE_MESH, Way("3d-te", "mesh", track_corrections=True)),
    "regularity": ("`--path-regularity 0.03`", TE_MESH, Way("3d-te", "mesh", path_regularity=0.03)),
    "subpixel": ("`--subpixel 1` (the default) in place of whole pixels", _WHOLE_PIXELS, TE_MESH),
}
"""What each does, the way without it, and the way with it, by name."""


def _figures(name: str) -> tuple[Figure, Figure]:
    """Return the rows of an option: one per clip, and the mean."""
    what, baseline, other = _OPTIONS[name]
    comparison = Comparison(baseline, other)
    title = f"{what}: PSNR of the side information, TE, lossless keys, GOP 10 (stone 2), every second frame"
    each = partial(gain, comparison=comparison, least_db=None)
    mean = partial(mean_gain, comparison=comparison, clips=_CLIPS, least_db=0.0)
    return (
        Figure(AREA, f"option-{name}", title, "the true figure", each, _CLIPS),
        Figure(AREA, f"option-{name}-mean", "the same, mean over static clips and scenes", "> 0 dB", mean),
    )


FIGURES = tuple(figure for name in _OPTIONS for figure in _figures(name))
"""The figures of this module."""
