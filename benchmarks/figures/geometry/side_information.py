"""Side information by the geometry of the scene: against 2D block motion, with true cameras, and its time."""

import filecmp
import os
import tempfile
import time
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.figures.codec import encode
from benchmarks.figures.geometry.key_pairs import HEIGHT, WIDTH, scene_pairs
from benchmarks.figures.harness import (
    FOREMAN,
    SCENES,
    STATIC_CLIPS,
    Figure,
    Measured,
    Setting,
    mean_over_clips,
    run_module,
)
from benchmarks.figures.rates import measured
from benchmarks.figures.tracks.points import QUANTISER, Quality, side_information_quality
from decoder.side_information.methods import INTERPOLATORS
from decoder.side_information.protocol import SceneInterpolatorType
from dvc.metrics import psnr_db
from dvc.multiview.cameras import PixelFrame
from dvc.multiview.triangulation import triangulate_depth
from dvc.rd.points import Point
from dvc.wynerziv.transform import to_uint8
from sequences.cameras import Camera, intrinsics
from sequences.renderer import render_frame
from sequences.scenes import descriptions, scene
from sfm.model import Correspondences, Model
from sfm.pipeline import reconstruct

GOP = 10
LEAST_DB = {"depth": 32.0, "blocks": 31.0}
LIMIT_S = {"depth": 0.15, "blocks": 0.5}
Luma = NDArray[np.uint8]
Floats = NDArray[np.float64]


def _build(name: str) -> SceneInterpolatorType:
    return INTERPOLATORS[name]


@cache
def blind_quality(setting: Setting, clip: str) -> tuple[Quality, Quality]:
    """Read the side information of block motion and of the scene, between lossless key frames."""
    frames = GOP + 1 if setting.quick else None if clip == FOREMAN else setting.frames
    points = [Point(clip, codec, QUANTISER, "lossless", GOP, frames=frames) for codec in ("2d", "3d")]
    flat, found = (side_information_quality(one) for one in measured(setting, clip, points))
    return flat, found


def blind(setting: Setting, clip: str) -> Measured:
    """Compare the scene's prediction of one clip with that of 2D block motion."""
    flat, found = blind_quality(setting, clip)
    gained_db, served, count = found.mean_db - flat.mean_db, found.num_served, found.num_frames
    text = f"{gained_db:+.2f} dB ({flat.mean_db:.2f} → {found.mean_db:.2f}"
    text += f"; the scene served {served} of {count} frames)"
    values = {"mci_db": flat.mean_db, "depth_db": found.mean_db, "num_served": served, "num_frames": count}
    return Measured(text, gained_db >= -0.2, values)


def blind_mean(setting: Setting, clip: str) -> Measured:
    """Average the difference over the real static clips."""
    del clip

    def gain(name: str) -> float:
        flat, found = blind_quality(setting, name)
        return found.mean_db - flat.mean_db

    return mean_over_clips(setting, STATIC_CLIPS, gain, "{:+.2f} dB", lambda mean: mean >= 0.3)


def _camera(name: str, index: int) -> Camera:
    description = descriptions()[name]
    k = intrinsics(WIDTH, HEIGHT, description.field_of_view_deg)
    return Camera(k, description.pose(float(index), 0), WIDTH, HEIGHT)


def _in_frame_of(first: Camera, camera: Camera, frame: PixelFrame) -> Floats:
    """Express a true camera in normalised coordinates of the first one, Frobenius norm sqrt(3)."""
    to_normalized = frame.normalized_from_pixel
    rotation = camera.cam_from_world[:, :3] @ first.cam_from_world[:, :3].T
    shift = camera.cam_from_world[:, 3] - rotation @ first.cam_from_world[:, 3]
    k = to_normalized @ camera.K
    matrix = np.column_stack([k @ rotation @ np.linalg.inv(to_normalized @ first.K), k @ shift])
    unit: Floats = matrix * np.sqrt(3.0) / np.linalg.norm(matrix)
    return unit


def _model_with_true_cameras(matches: Correspondences, second: Floats, frame: PixelFrame) -> Model:
    """Triangulate estimated correspondences with the true second camera."""
    points = frame.to_normalized(matches.first), frame.to_normalized(matches.second)
    depth_first, depth_second = triangulate_depth(points[0], second, points[1])
    good = np.isfinite(depth_first) & (np.nan_to_num(depth_first) > 0) & (np.nan_to_num(depth_second) > 0)
    return Model(frame, np.eye(3), second, matches[good], depth_first[good])


def _true_cameras(setting: Setting, clip: str, method: str) -> Measured:
    built, frame = scene(clip), PixelFrame(WIDTH, HEIGHT)
    per_gop = []
    for pair in scene_pairs(clip, setting.choose(5, 1)):
        first = _camera(clip, pair.index)
        found = reconstruct(pair.first, pair.second)
        second = _in_frame_of(first, _camera(clip, pair.index + GOP), frame)
        model = _model_with_true_cameras(found.stages["propagation"], second, frame)
        interpolator = _build(method)(model, pair.first, pair.second)
        psnrs = []
        for step in range(1, GOP, setting.choose(1, 4)):
            original = render_frame(built, pair.index + step, WIDTH, HEIGHT).frame.luma
            camera = _in_frame_of(first, _camera(clip, pair.index + step), frame)
            psnrs.append(psnr_db(original, to_uint8(interpolator.interpolate(camera, step / GOP).luma)))
        per_gop.append(float(np.mean(psnrs)))
    mean = float(np.mean(per_gop))
    text = f"{mean:.2f} dB (GOPs {min(per_gop):.1f} to {max(per_gop):.1f})"
    return Measured(text, mean >= LEAST_DB[method], {"per_gop_db": per_gop})


def depth_with_true_cameras(setting: Setting, clip: str) -> Measured:
    """Predict by dense depth from the true cameras of all frames."""
    return _true_cameras(setting, clip, "depth")


def blocks_with_true_cameras(setting: Setting, clip: str) -> Measured:
    """Predict by epipolar blocks from the true cameras of all frames."""
    return _true_cameras(setting, clip, "blocks")


def frame_time(setting: Setting, clip: str) -> Measured:
    """Time both motion models, per frame and per key pair, on one core."""
    pair = scene_pairs(clip, 1)[0]
    model = reconstruct(pair.first, pair.second).model
    assert model is not None
    values: dict[str, float] = {}
    for name in LIMIT_S:
        build = _build(name)
        build(model, pair.first, pair.second).interpolate(model.second_camera, 0.9)  # loads the kernels
        began = time.process_time()
        interpolator = build(model, pair.first, pair.second)
        values[f"{name}_pair_s"] = time.process_time() - began
        count = setting.choose(5, 1)
        began = time.process_time()
        for step in range(count):
            position = (step + 1) / (count + 1)
            camera = (1 - position) * model.first_camera + position * model.second_camera
            interpolator.interpolate(camera, position)
        values[f"{name}_s"] = (time.process_time() - began) / count
    text = ", ".join(
        f"{name} {values[f'{name}_s']:.2f} s (and {values[f'{name}_pair_s']:.1f} s once per key pair)"
        for name in LIMIT_S
    )
    return Measured(text, all(values[f"{name}_s"] <= limit for name, limit in LIMIT_S.items()), values)


def determinism(setting: Setting, clip: str) -> Measured:
    """Decode a 3D stream with one and two jobs, again, and with an empty cache of compiled kernels."""
    frames = setting.choose(21, 11)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        encode(clip, folder / "s.dvc", "--codec", "3d", "--gop", 5, "--wz-q", 3, "--frames", frames)
        runs = {"one": 1, "again": 1, "two jobs": 2, "cold cache": 1}
        before = os.environ.get("NUMBA_CACHE_DIR")
        for number, (name, jobs) in enumerate(runs.items()):
            if name == "cold cache":
                os.environ["NUMBA_CACHE_DIR"] = str(folder / "cache")
            outputs = [folder / f"{number}.y4m", "--punctured", folder / f"{number}.dvc", "--jobs", jobs]
            run_module("decoder", [folder / "s.dvc", *outputs, "--quiet"])
        os.environ.pop("NUMBA_CACHE_DIR")
        if before is not None:
            os.environ["NUMBA_CACHE_DIR"] = before
        same = [
            filecmp.cmp(folder / f"0{end}", folder / f"{number}{end}", shallow=False)
            for number in range(1, len(runs))
            for end in (".y4m", ".dvc")
        ]
    values = {"runs": list(runs), "frames": frames}
    text = "the same bytes: " if all(same) else "OTHER bytes: "
    return Measured(text + ", ".join(runs), all(same), values)


FIGURES = (
    Figure(
        "side information",
        "blind",
        "3D without tracks (depth) against our 2D, lossless keys, GOP 10, mean PSNR",
        "no clip below −0.2 dB",
        blind,
        (*STATIC_CLIPS, "cube", FOREMAN),
    ),
    Figure(
        "side information",
        "blind-mean",
        "the same, mean over the real static clips",
        "≥ +0.3 dB",
        blind_mean,
        thesis="+1.0 dB",
    ),
    Figure(
        "side information",
        "depth-true-cameras",
        "depth, lossless keys 10 apart, true cameras given",
        "≥ 32 dB",
        depth_with_true_cameras,
        SCENES,
        "29 dB with tracks",
    ),
    Figure(
        "side information",
        "blocks-true-cameras",
        "epipolar blocks, lossless keys 10 apart, true cameras given",
        "≥ 31 dB",
        blocks_with_true_cameras,
        SCENES,
    ),
    Figure(
        "side information",
        "time",
        "prediction of a CIF frame, one core",
        "depth ≤ 0.15 s, blocks ≤ 0.5 s",
        frame_time,
        SCENES,
    ),
    Figure(
        "side information",
        "determinism",
        "3D decoding with any number of jobs, again, warm and cold kernel cache",
        "the same bytes",
        determinism,
        ("box",),
    ),
)
"""The figures of this module."""
