"""Tracked points, rate and quality: against 2D and H.264 intra, and frames predicted hierarchically."""

from collections.abc import Callable
from functools import partial

from benchmarks.figures import rates as rd_figures
from benchmarks.figures.harness import SCENES, STATIC_CLIPS, Figure, Measured, Setting, mean_over_clips
from benchmarks.figures.tracks.curves import FAR_KEYS, FINEST, HIERARCHICAL, PRESETS, difference, te_curve
from benchmarks.figures.tracks.quality import AREA, REAL_CLIPS
from dvc.metrics import BdResult
from dvc.rd.differences import bd_text

HIGHEST_DB = 36.0
"""Upper end of the range of the thesis's curves (20 to 36 dB)."""
MEAN = f"the same, mean over {', '.join(STATIC_CLIPS)}"
Limits = dict[str, float]


def _against_flat(setting: Setting, clip: str, references: str) -> BdResult:
    flat = next(curve for curve in rd_figures.experiment(setting, clip).curves if not curve.is_anchor)
    return difference(flat, te_curve(setting, clip, references, PRESETS), HIGHEST_DB)


def _against_intra(setting: Setting, clip: str, references: str) -> BdResult:
    anchor = rd_figures.experiment(setting, clip).anchor()
    assert anchor is not None
    return difference(anchor, te_curve(setting, clip, references, PRESETS))


def _against_keys(setting: Setting, clip: str) -> BdResult:
    keys, levels = (te_curve(setting, clip, references, PRESETS) for references in ("keys", HIERARCHICAL))
    return difference(keys, levels)


_DIFFERENCES: dict[str, Callable[[Setting, str], BdResult]] = {
    "2d": partial(_against_flat, references="keys"),
    "hierarchical-2d": partial(_against_flat, references=HIERARCHICAL),
    "intra": partial(_against_intra, references="keys"),
    "hierarchical-intra": partial(_against_intra, references=HIERARCHICAL),
    "keys": _against_keys,
}
"""What is compared, by name."""


def rate_difference(setting: Setting, clip: str, against: str, limits: Limits) -> Measured:
    """Compare the curves of one clip."""
    found = _DIFFERENCES[against](setting, clip)
    values = {"bd_rate_percent": found.value, "overlap_db": list(found.overlap)}
    holds = found.value < limits[clip] if clip in limits else None
    return Measured(bd_text(found), holds, values)


def mean_rate_difference(
    setting: Setting, clip: str, against: str, clips: tuple[str, ...], limit: float
) -> Measured:
    """Average the BD-rates of clips."""
    del clip

    def difference(name: str) -> float:
        return _DIFFERENCES[against](setting, name).value

    return mean_over_clips(setting, clips, difference, "{:+.1f} %", lambda mean: mean <= limit)


def _si_psnrs_db(setting: Setting, clip: str, baseline: str) -> tuple[float, float]:
    """Return the mean PSNR of the side information at the finest quantiser: of `baseline`, hierarchical."""
    values = []
    for references in (baseline, HIERARCHICAL):
        [point] = te_curve(setting, clip, references, (FINEST,)).points
        found = point.total("si_psnr_y_db")
        assert found is not None
        values.append(found)
    return values[0], values[1]


def hierarchical_gain(setting: Setting, clip: str, baseline: str) -> Measured:
    """Compare side information from key frames and from all levels of a hierarchy, as decoded."""
    keys_db, levels_db = _si_psnrs_db(setting, clip, baseline)
    values = {"keys_db": keys_db, "hierarchical_db": levels_db}
    return Measured(f"{levels_db - keys_db:+.2f} dB ({keys_db:.2f} → {levels_db:.2f})", None, values)


def hierarchical_gain_mean(setting: Setting, clip: str, baseline: str) -> Measured:
    """Average the gain of the hierarchy over the real static clips."""
    del clip

    def gain(name: str) -> float:
        keys_db, levels_db = _si_psnrs_db(setting, name, baseline)
        return levels_db - keys_db

    return mean_over_clips(setting, STATIC_CLIPS, gain, "{:+.2f} dB", lambda mean: mean >= 3.0)


_ALL = (*REAL_CLIPS, *SCENES)
_AGAINST_2D = "TE against 2D (GOP 2), key-only, Q1 to Q8, up to 36 dB: BD-rate"
_LEVELS_AGAINST_2D = "TE against 2D (GOP 2), hierarchical, Q1 to Q8, up to 36 dB: BD-rate"
_INTRA = "TE against H.264 intra, key-only, Q1 to Q8: BD-rate"
_LEVELS_INTRA = "TE against H.264 intra, hierarchical, Q1 to Q8: BD-rate"
_LEVELS = "TE, hierarchical against key-only references, Q1 to Q8: BD-rate"


def _figures(
    name: str, against: str, title: str, asked: tuple[str, str], limits: Limits, limit: float
) -> tuple[Figure, Figure]:
    """Return the rows of a comparison: one per clip, and the mean over all static clips."""
    each = partial(rate_difference, against=against, limits=limits)
    mean = partial(mean_rate_difference, against=against, clips=STATIC_CLIPS, limit=limit)
    return (
        Figure(AREA, name, title, asked[0], each, _ALL),
        Figure(AREA, f"{name}-mean", MEAN, asked[1], mean),
    )


FIGURES = (
    Figure(
        AREA,
        "hierarchical-si",
        "TE, hierarchical against key-only references, with key frames of its own, Q8: PSNR predicted",
        "≥ +3 dB on the mean",
        partial(hierarchical_gain, baseline="keys"),
        _ALL,
    ),
    Figure(
        AREA,
        "hierarchical-si-mean",
        "the same, mean over the real static clips",
        "≥ +3 dB",
        partial(hierarchical_gain_mean, baseline="keys"),
    ),
    Figure(
        AREA,
        "hierarchical-si-same-keys",
        "TE, hierarchical against key-only references with the same key frames, Q8: PSNR predicted",
        "≥ +3 dB on the mean",
        partial(hierarchical_gain, baseline=FAR_KEYS),
        _ALL,
    ),
    Figure(
        AREA,
        "hierarchical-si-same-keys-mean",
        "the same, mean over the real static clips",
        "≥ +3 dB",
        partial(hierarchical_gain_mean, baseline=FAR_KEYS),
    ),
    *_figures("hierarchical", "keys", _LEVELS, ("≤ −20 % on the mean", "≤ −20 %"), {}, -20.0),
    *_figures(
        "te-2d",
        "2d",
        _AGAINST_2D,
        ("negative on every static clip", "≤ −30 %"),
        dict.fromkeys(STATIC_CLIPS, 0.0),
        -30.0,
    ),
    *_figures(
        "te-hierarchical-2d",
        "hierarchical-2d",
        _LEVELS_AGAINST_2D,
        ("negative on every static clip", "≤ −30 %"),
        dict.fromkeys(STATIC_CLIPS, 0.0),
        -30.0,
    ),
    Figure(
        AREA,
        "te-intra",
        _INTRA,
        "negative on every static clip",
        partial(rate_difference, against="intra", limits=dict.fromkeys(STATIC_CLIPS, 0.0)),
        _ALL,
    ),
    *_figures(
        "te-hierarchical-intra",
        "hierarchical-intra",
        _LEVELS_INTRA,
        ("≤ −35 % on the mean", "≤ −35 %"),
        {},
        -35.0,
    ),
)
"""The figures of this module."""
