"""Structure from motion between key frames: accuracy against rendered truth, and what real clips give."""

import time
from typing import Any

import numpy as np

from benchmarks.figures.geometry.key_pairs import clip_pairs, scene_pairs, true_correspondences, truth
from benchmarks.figures.harness import SCENES, STATIC_CLIPS, Figure, Measured, Setting
from dvc.config import SFM_BACKENDS
from sfm.cameras.bundle_adjustment import bundle_adjustment
from sfm.estimation.epipolar import symmetric_distances
from sfm.pipeline import reconstruct

NUM_GOPS = 5
COARSE_QP = 42


def _epipolar_error(setting: Setting, clip: str, qp: int | None) -> list[tuple[float, float]]:
    """Return median and 95th percentile of each group of pictures, infinite without a model."""
    errors = []
    for pair in scene_pairs(clip, setting.choose(NUM_GOPS, 1), qp):
        model = reconstruct(pair.first, pair.second).model
        if model is None:
            errors.append((float("inf"), float("inf")))
            continue
        distances = symmetric_distances(model.fundamental, *true_correspondences(clip, pair))
        errors.append((float(np.median(distances)), float(np.percentile(distances, 95))))
    return errors


def _error_values(errors: list[tuple[float, float]]) -> dict[str, Any]:
    return {
        "median_px": [round(median, 4) for median, _ in errors],
        "percentile_95_px": [round(most, 4) for _, most in errors],
    }


def epipolar_error(setting: Setting, clip: str) -> Measured:
    """Measure how far true correspondences are from the estimated epipolar lines, with lossless key frames.
    Measure how far true correspondences are from the estimated epipolar lines, with lossless key frames.
    """
    errors = _epipolar_error(setting, clip, None)
    median, most = (max(column) for column in zip(*errors, strict=True))
    text = f"median {median:.3f} px, 95 % within {most:.3f} px (worst of {len(errors)} GOPs)"
    return Measured(text, median <= 0.1 and most <= 0.5, _error_values(errors))


def epipolar_error_coarse(setting: Setting, clip: str) -> Measured:
    """Measure the same with coarsely quantised key frames."""
    errors = _epipolar_error(setting, clip, COARSE_QP)
    median = max(median for median, _ in errors)
    return Measured(
        f"median {median:.3f} px (worst of {len(errors)} GOPs)", median <= 0.5, _error_values(errors)
    )


def num_correspondences(setting: Setting, clip: str) -> Measured:
    """Count correspondences after weak calibration and after propagation, and those that are right."""
    calibrated, propagated, shares = [], [], []
    for pair in scene_pairs(clip, setting.choose(NUM_GOPS, 1)):
        stages = reconstruct(pair.first, pair.second).stages
        matches = stages["propagation"]
        right = truth(clip, pair, matches.first).points_b
        offset = np.linalg.norm(matches.second - np.nan_to_num(right, nan=1e9), axis=1)
        calibrated.append(len(stages["weak calibration"]))
        propagated.append(len(matches))
        shares.append(float((offset <= 1.0).mean()))
    holds = min(calibrated) >= 300 and min(propagated) >= 6000 and min(shares) >= 0.98
    values = {"calibrated": calibrated, "propagated": propagated, "share_within_1_px": shares}
    text = f"{min(calibrated)} → {min(propagated)}, {100 * min(shares):.1f} % (fewest of {len(shares)} GOPs)"
    return Measured(text, holds, values)


def adjustment_speed(setting: Setting, clip: str) -> Measured:
    """Give the bundle adjustment of a key pair to `scipy.optimize.least_squares` as well."""
    from benchmarks.figures.geometry.adjustment_peer import peer_adjustment

    pair = scene_pairs(clip, 1)[0]
    model = reconstruct(pair.first, pair.second).model
    assert model is not None
    chosen = np.random.default_rng(0).permutation(len(model.depths))[: setting.choose(600, 60)]
    matches, depths = model.correspondences[chosen], model.depths[chosen]
    rng = np.random.default_rng(1)
    noisy = matches.second + rng.normal(0.0, 0.3, matches.second.shape)
    problem = type(matches)(matches.first, noisy, matches.error)
    start = model.second_camera + rng.normal(0.0, 1e-4, (3, 4))
    bundle_adjustment(problem, start, depths, model.pixel_frame, np.random.default_rng(2))  # loads the code
    began = time.process_time()
    ours = bundle_adjustment(problem, start, depths, model.pixel_frame, np.random.default_rng(2))
    ours_s = time.process_time() - began
    depths[ours.fixed] = ours.depths[ours.fixed]  # settled before they were fixed
    began = time.process_time()
    peer_rms_px = peer_adjustment(problem, start, depths, model.pixel_frame, ours.fixed)
    peer_s = time.process_time() - began
    difference = abs(ours.rms_px**2 - peer_rms_px**2) / peer_rms_px**2
    ratio = peer_s / ours_s
    values = {"rms_px": ours.rms_px, "peer_rms_px": peer_rms_px, "cpu_s": ours_s, "peer_cpu_s": peer_s}
    text = f"costs differ by {difference:.1e}; {ratio:.0f} times faster ({len(chosen)} points)"
    return Measured(text, difference <= 1e-6 and ratio >= 10, values)


def reconstruction_time(setting: Setting, clip: str) -> Measured:
    """Time the reconstruction of key pairs on one core."""
    pairs = scene_pairs(clip, setting.choose(NUM_GOPS, 1)) if clip in SCENES else list(clip_pairs(clip))
    times_s = []
    reconstruct(pairs[0].first, pairs[0].second)  # loads the compiled kernels
    for pair in pairs[: setting.choose(10, 1)]:
        began = time.process_time()
        reconstruct(pair.first, pair.second)
        times_s.append(time.process_time() - began)
    text = f"{np.mean(times_s):.2f} s (slowest {max(times_s):.2f} s)"
    return Measured(text, float(np.mean(times_s)) <= 5.0, {"cpu_s": times_s})


def backends_agree(setting: Setting, clip: str) -> Measured:
    """Compare both backends on true correspondences."""
    medians: dict[str, list[float]] = {name: [] for name in SFM_BACKENDS}
    for pair in scene_pairs(clip, setting.choose(NUM_GOPS, 1)):
        points = true_correspondences(clip, pair)
        for name in SFM_BACKENDS:
            model = reconstruct(pair.first, pair.second, backend=name).model
            error = (
                np.inf if model is None else float(np.median(symmetric_distances(model.fundamental, *points)))
            )
            medians[name].append(error)
    text = ", ".join(f"{name} {np.mean(values):.3f} px" for name, values in medians.items())
    return Measured(text, None, medians)


FIGURES = (
    Figure(
        "sfm",
        "epipolar-error",
        "true correspondences against the estimated F, lossless keys 10 apart, symmetric distance",
        "median ≤ 0.1 px, 95 % ≤ 0.5 px in all GOPs",
        epipolar_error,
        SCENES,
    ),
    Figure(
        "sfm",
        "epipolar-error-qp42",
        "the same with keys at QP 42",
        "median ≤ 0.5 px",
        epipolar_error_coarse,
        SCENES,
        "“behaves well”",
    ),
    Figure(
        "sfm",
        "correspondences",
        "correspondences after weak calibration → after propagation; within 1 px of the truth",
        "≥ 300 → ≥ 6,000; ≥ 98 %",
        num_correspondences,
        SCENES,
        "394 → 9,982; 327 → 6,931",
    ),
    Figure(
        "sfm",
        "bundle-adjustment",
        "bundle adjustment against scipy.optimize.least_squares",
        "same minimum to 1e-6, ≥ 10 times faster",
        adjustment_speed,
        SCENES,
    ),
    Figure(
        "sfm",
        "time",
        "reconstruction of a key pair, CIF, one core",
        "≤ 5 s",
        reconstruction_time,
        (*SCENES, *STATIC_CLIPS),
    ),
    Figure(
        "sfm",
        "backends",
        "median epipolar error by backend, mean over GOPs",
        "the true figures",
        backends_agree,
        SCENES,
    ),
)
"""The figures of this module."""
