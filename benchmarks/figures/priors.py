"""What priors that learn save of the ideal code length of bit planes, with the same predictions."""

from functools import cache

from benchmarks.figures.codec import encode
from benchmarks.figures.harness import STATIC_CLIPS, Figure, Measured, Setting, mean_over_clips
from benchmarks.figures.tracks.rates import MEAN
from benchmarks.recorded_planes import measure_priors

AREA = "allocation"
FRAMES = 17
QP = 30
LEAST_PERCENT = -5.0
_ASKED = "≤ −5 %"


@cache
def _lengths(setting: Setting, clip: str) -> dict[str, tuple[float, float]]:
    """Decode a clip, and add up ideal code lengths by class of planes."""
    folder = setting.folder / "priors"
    folder.mkdir(parents=True, exist_ok=True)
    stream = folder / f"{clip}.dvc"
    encode(clip, stream, "--frames", setting.choose(FRAMES, 5), "--qp", QP)
    return measure_priors(stream)


def _change(setting: Setting, clip: str) -> float:
    before, after = (sum(length[which] for length in _lengths(setting, clip).values()) for which in (0, 1))
    return 100.0 * (after / before - 1.0)


def learned_priors(setting: Setting, clip: str) -> Measured:
    """Compare ideal code lengths by learned priors with those by the noise model alone."""
    change = _change(setting, clip)
    classes = {
        name: 100.0 * (after / before - 1.0) for name, (before, after) in _lengths(setting, clip).items()
    }
    note = ", ".join(f"{name} {value:+.1f} %" for name, value in classes.items())
    return Measured(f"{change:+.1f} %", change <= LEAST_PERCENT, {"all": change} | classes, note)


def mean_of_learned_priors(setting: Setting, clip: str) -> Measured:
    """Average the change of ideal code lengths by learned priors over clips."""
    del clip
    return mean_over_clips(
        setting,
        STATIC_CLIPS,
        lambda name: _change(setting, name),
        "{:+.1f} %",
        lambda mean: mean <= LEAST_PERCENT,
    )


_TITLE = "learned priors against the noise model alone, same predictions, 17 frames, QP 30: ideal code length"

FIGURES = (
    Figure(AREA, "learned-priors", _TITLE, _ASKED, learned_priors, STATIC_CLIPS),
    Figure(AREA, "learned-priors-mean", MEAN, _ASKED, mean_of_learned_priors),
)
"""The figures of this module."""
