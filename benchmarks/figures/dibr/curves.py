"""Rate-distortion curves of chapter 3: trees against quadtrees and blocks, layers, split, times."""

import time
from functools import cache, partial

import numpy as np

from benchmarks.figures.dibr.rendered import RENDERED, rendered_array
from benchmarks.figures.harness import Figure, Measured, Setting
from benchmarks.figures.stereo.runs import MOTORCYCLE, data_folder
from dvc.dibr.codec.encoder import ViewEncoder
from dvc.dibr.stream.header import DisparityMethod
from dvc.dibr.thesis.curves import (
    Point,
    curve,
    differences,
    layered_points,
    psnr_at,
    reference_slopes,
    worst_loss,
)
from dvc.dibr.thesis.decomposition import stopped_early
from dvc.dibr.thesis.scenes import FREE_SCENES, Scene, load_scenes, scene_of_array
from dvc.multiview.camera_array import DisparityLabels
from dvc.stereo.thesis import real_sets

AREA = "dibr"
SLOPES = 1.2e-2, 4e-3, 1.5e-3, 4e-4
"""Of files of about 0.1 to 1 bpp."""
MIDDLE_SLOPE = 2e-3
CONES_PAIR = "cones-pair"
OTHERS = "cones", "cgtoy", "toy", *RENDERED
PAIRS = "venus", CONES_PAIR, MOTORCYCLE
LAYERED = "teddy", "tsukuba"
NUM_LAYERS = 4
EARLY_LEVELS = 3, 5
REFERENCE_BPP = 0.1, 0.5, 1.0


@cache
def _scene(name: str) -> Scene:
    if name in RENDERED:
        return rendered_array(name)
    if name == CONES_PAIR:
        one = real_sets.PAIRS["cones"]
        return scene_of_array(name, one.pair(data_folder("cones")), one.labels)
    (scene,) = load_scenes(None if name in FREE_SCENES else data_folder(name), [name])
    return scene


@cache
def _curve(name: str, method: str, slopes: tuple[float, ...] = SLOPES) -> list[Point]:
    scene = _scene(name)
    return curve(scene.views, scene.labels, DisparityMethod[method.upper()], slopes)


def _gains(name: str, methods: tuple[str, ...]) -> dict[str, float]:
    """Return BD-PSNR and BD-rate of methods against the quadtree, by name."""
    gains = {}
    for method in methods:
        found = differences(_curve(name, method), _curve(name, "quadtree"))
        if found is not None:
            gains[f"{name}_{method}_bd_psnr_db"], gains[f"{name}_{method}_bd_rate_percent"] = found
    return gains


def against_quadtree(
    setting: Setting, clip: str, names: tuple[str, ...], methods: tuple[str, ...], asked_db: float
) -> Measured:
    """Compare with quadtrees at equal slopes."""
    del clip
    values: dict[str, float] = {}
    for name in names[: setting.choose(len(names), 1)]:
        values |= _gains(name, methods)
    gains = {key.removesuffix("_bd_psnr_db"): gain for key, gain in values.items() if key.endswith("_db")}
    texts = (
        f"{key} {gain:+.2f} dB ({values[f'{key}_bd_rate_percent']:+.0f} %)" for key, gain in gains.items()
    )
    mean = float(np.mean(list(gains.values())))
    return Measured(", ".join(texts), mean >= asked_db, values, f"mean {mean:+.2f} dB")


def against_blocks(setting: Setting, clip: str) -> Measured:
    """Compare L and S with blocks at the rates of all files that have blocks."""
    del clip
    values = {}
    for name in LAYERED[: setting.choose(2, 1)]:
        for method in ("l", "s"):
            gains = [
                found - point.quality.pooled_db
                for point in _curve(name, "blocks")
                if (found := psnr_at(_curve(name, method), point.rate_bpp)) is not None
            ]
            values[f"{name}_{method}_least_gain_db"] = min(gains)
    texts = (f"{key.removesuffix('_least_gain_db')} {gain:+.2f} dB" for key, gain in values.items())
    return Measured(", ".join(texts) + " at least", min(values.values()) > 0.0, values)


def layers_cost(setting: Setting, clip: str) -> Measured:
    """Compare files cut after each quality layer with files of one layer, at equal rates."""
    del clip
    values = {}
    for name in LAYERED[: setting.choose(2, 1)]:
        scene = _scene(name)
        for method in ("l", "s"):
            kind = DisparityMethod[method.upper()]
            points = layered_points(scene.views, scene.labels, kind, SLOPES[-1], NUM_LAYERS)
            loss = worst_loss(points, _curve(name, method))
            if loss is not None:
                values[f"{name}_{method}_loss_db"] = loss
    texts = (f"{key.removesuffix('_loss_db')} {loss:.2f} dB" for key, loss in values.items())
    return Measured(", ".join(texts), max(values.values()) <= 0.3, values, f"{NUM_LAYERS} layers")


def shares(setting: Setting, clip: str) -> Measured:
    """Split the rate of Teddy and Tsukuba where the reference has 0.1, 0.5 and 1 bpp, in L."""
    del clip
    values, texts = {}, []
    for name in LAYERED[: setting.choose(2, 1)]:
        slopes = tuple(reference_slopes(_scene(name).views, REFERENCE_BPP))
        for rate, point in zip(REFERENCE_BPP, _curve(name, "l", slopes), strict=True):
            values[f"{name}_{rate:g}_bpp_slope"] = point.slope
            values[f"{name}_{rate:g}_bpp_share"] = point.share
            texts.append(f"{name} {rate:g} bpp: {100 * point.share:.0f} % at {point.slope:.1e}")
    found = [value for key, value in values.items() if key.endswith("share")]
    return Measured(", ".join(texts), min(found) >= 0.1 and max(found) <= 0.25, values)


def early_stop(setting: Setting, clip: str) -> Measured:
    """End the decomposition of Teddy's disparities earlier than at one pixel, at one slope, in L."""
    del setting, clip
    scene = _scene("teddy")
    values, texts = {}, []
    for levels in (None, *reversed(EARLY_LEVELS)):
        point = stopped_early(scene.views, scene.labels, MIDDLE_SLOPE, levels)
        told = "one pixel" if levels is None else f"{levels} levels"
        key = "all" if levels is None else str(levels)
        values[f"levels_{key}_bytes"] = float(point.disparity_bytes)
        values[f"levels_{key}_db"] = point.quality.pooled_db
        texts.append(f"{told}: {point.disparity_bytes} bytes, {point.quality.pooled_db:.2f} dB")
    return Measured("; ".join(texts), None, values)


def _encoding_s(method: DisparityMethod, num_labels: int) -> float:
    scene = _scene("teddy")
    labels = DisparityLabels(scene.labels.lowest, scene.labels.step, num_labels)
    encoder = ViewEncoder(scene.views, labels, method)
    encoder.encode(MIDDLE_SLOPE)
    started = time.process_time()
    encoder.encode(MIDDLE_SLOPE)
    return time.process_time() - started


def encoding_time(
    setting: Setting, clip: str, method: DisparityMethod, most_s: float, power: int
) -> Measured:
    """Encode Teddy at one slope with 60 labels, and with fewer; kernels compiled."""
    del clip
    labels = (60, 45, 30, 15)[: setting.choose(4, 2)]
    seconds = [_encoding_s(method, count) for count in labels]
    slope, constant = np.polyfit(np.array(labels, np.float64) ** power, seconds, 1)
    values = {f"labels_{count}_s": taken for count, taken in zip(labels, seconds, strict=True)}
    power_text = "labels" if power == 1 else f"labels^{power}"
    text = f"{seconds[0]:.1f} s; {constant:.2f} s + {1e3 * slope:.3g} ms x {power_text}"
    return Measured(text, seconds[0] <= most_s, values)


FIGURES = (
    *(
        Figure(
            AREA,
            f"bd-teddy-{method}",
            f"Teddy, two views, {method.upper()} against quadtrees at equal slopes, BD-PSNR (BD-rate)",
            "≥ +0.8 dB",
            partial(against_quadtree, names=("teddy",), methods=(method,), asked_db=0.8),
            thesis=thesis,
            slow=True,
        )
        for method, thesis in (("l", "+0.84 dB"), ("s", "+0.70 dB"))
    ),
    Figure(
        AREA,
        "bd-tsukuba",
        "Tsukuba, nine views, L and S against quadtrees at equal slopes, BD-PSNR (BD-rate)",
        "≥ 0 dB",
        partial(against_quadtree, names=("tsukuba",), methods=("l", "s"), asked_db=0.0),
        thesis="-0.09 dB and -0.12 dB",
        slow=True,
    ),
    Figure(
        AREA,
        "bd-others",
        "cones (9 views), cgtoy (3x3) and three rendered arrays (2x2), L and S against quadtrees, BD-PSNR",
        "≥ +0.3 dB on average",
        partial(against_quadtree, names=OTHERS, methods=("l", "s"), asked_db=0.3),
        slow=True,
    ),
    Figure(
        AREA,
        "bd-pairs",
        "Venus, Cones and Motorcycle, two views, L against quadtrees, BD-PSNR (BD-rate)",
        "≥ +0.5 dB on average of such pairs",
        partial(against_quadtree, names=PAIRS, methods=("l",), asked_db=0.5),
        slow=True,
    ),
    Figure(
        AREA,
        "blocks",
        "L and S against 8x8 blocks at every rate that blocks reach, least difference of PSNR",
        "> 0 dB",
        against_blocks,
        slow=True,
    ),
    Figure(
        AREA,
        "layers-cost",
        f"{NUM_LAYERS} quality layers against files of one layer, largest loss at equal rates",
        "≤ 0.3 dB",
        layers_cost,
        thesis="Tsukuba 0.29 dB; Teddy 0.34 (L) and 0.47 dB (S)",
        slow=True,
    ),
    Figure(
        AREA,
        "share",
        "share of the disparities and slope where the reference has 0.1, 0.5 and 1 bpp, L",
        "10 to 25 %",
        shares,
        thesis="13 to 23 %; 1e-2, 2e-3, 4e-4",
        slow=True,
    ),
    Figure(
        AREA,
        "decomposition",
        f"Teddy in L at slope {MIDDLE_SLOPE:g}: down to one pixel, or stopped earlier",
        "printed: why not earlier",
        early_stop,
        slow=True,
    ),
    *(
        Figure(
            AREA,
            f"time-{method.name.lower()}",
            f"encoding Teddy in {method.name} at one slope, 60 labels, one core, and its growth with labels",
            f"≤ {most_s:g} s",
            partial(encoding_time, method=method, most_s=most_s, power=power),
            slow=True,
        )
        for method, most_s, power in ((DisparityMethod.L, 2.0, 1), (DisparityMethod.S, 15.0, 2))
    ),
)
"""The figures of this module."""
