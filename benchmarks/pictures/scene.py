"""Draw every stage from a key pair to a predicted frame: figures 5.3, 5.7, 5.10."""

from fractions import Fraction
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.pictures.drawing import Picture, correlation_noise, panel, write_picture
from benchmarks.results.harness import clip_source
from decoder.side_information.block_motion import BlockMotionInterpolation
from decoder.side_information.methods import INTERPOLATORS
from decoder.side_information.protocol import Interpolation, ReferenceFrame
from dvc.geometry.depth_maps import estimate_depths
from dvc.metrics import psnr_db
from dvc.video import Frame, open_video
from dvc.wynerziv.transform import to_uint8
from sfm.cameras.camera_path import intermediate_cameras, linear_points
from sfm.correspondences.point_matching import detect_corners
from sfm.output.map_files import draw_correspondences, side_by_side
from sfm.pipeline import reconstruct
from sfm.scene_model import Correspondences, Model, Reconstruction

FOLDER = Path("docs") / "scene"
SHOWN = {
    "stairway": ("correspondences", "motion"),
    "statue": ("correspondences",),
    "street": ("stages",),
}
"""Pictures of the chapter page, by scene."""
GOP = 10
Luma = NDArray[np.uint8]
Floats = NDArray[np.float64]


def _coloured(values: Floats, highest: float) -> Picture:
    """Colour a plane from 0 (dark) to `highest` (bright), readable without colour vision."""
    scaled = np.clip(255.0 * values / max(highest, 1e-12), 0, 255).astype(np.uint8)
    return np.asarray(cv2.applyColorMap(scaled, cv2.COLORMAP_VIRIDIS), dtype=np.uint8)


def _correspondences(found: Reconstruction, second: Luma, clip: str) -> Picture:
    """Figures 5.3 and 5.10: after weak calibration, and after propagation."""
    assert found.model is not None
    return side_by_side(
        [
            draw_correspondences(
                second, matches, found.model.fundamental, f"{clip}, {name}: {len(matches)} correspondences"
            )
            for name, matches in found.stages.items()
            if name in ("weak calibration", "propagation")
        ]
    )


def _stages(frames: list[Luma], found: Reconstruction) -> Picture:
    """Key frames, corners, matches, depth, prediction and error, in rows of three."""
    assert found.model is not None
    first, middle, second = frames[0], frames[GOP // 2], frames[GOP]
    corners = detect_corners(first)
    dots = Correspondences(corners, corners, np.zeros(len(corners)))
    matched = found.stages["matching"]
    depth = estimate_depths(found.model.view_pair, first, second)[0].depth.inverse_depth
    rendered = _interpolations(found.model, first, second)["depth"]
    flat = _block_motion(first, second)
    doubt = _coloured(rendered.expected_error, 25.0)
    panels = [
        panel(first, "first key frame"),
        panel(middle, "frame in the middle, which the decoder does not have"),
        panel(second, "second key frame"),
        panel(draw_correspondences(first, dots, None, "")[36:], f"{len(corners)} corners"),
        panel(draw_correspondences(second, matched, None, "")[36:], f"{len(matched)} matches"),
        panel(_coloured(depth, float(np.percentile(depth, 99.5))), "inverse depth of the first key frame"),
        panel(to_uint8(rendered.luma), f"depth: {psnr_db(middle, to_uint8(rendered.luma)):.1f} dB"),
        panel(correlation_noise(rendered.luma, middle), "its error, twice"),
        panel(doubt, "its expected error (bright: 25 levels)"),
        panel(to_uint8(flat), f"2D block motion: {psnr_db(middle, to_uint8(flat)):.1f} dB"),
        panel(correlation_noise(flat, middle), "its error, twice"),
    ]
    panels.append(np.full_like(panels[0], 255))
    rows = [side_by_side(panels[k : k + 3]) for k in range(0, len(panels), 3)]
    picture: Picture = np.vstack(rows)
    return picture


def _interpolations(model: Model, first: Luma, second: Luma) -> dict[str, Interpolation]:
    """Predict the frame in the middle by every motion model, the camera moving evenly."""
    [camera] = intermediate_cameras(model, [linear_points(model, 0.5)])
    return {
        name: build(model, first, second).interpolate(camera.camera, 0.5)
        for name, build in INTERPOLATORS.items()
    }


def _block_motion(first: Luma, second: Luma) -> Floats:
    keys = [ReferenceFrame(0, Frame(first, None)), ReferenceFrame(GOP, Frame(second, None))]
    [prediction] = BlockMotionInterpolation().predict(keys, None, [GOP // 2])
    return prediction.luma


def _motion_norms(found: Reconstruction, first: Luma, second: Luma) -> Picture:
    """Figure 5.7: norm of the motion between the key frames, by each motion model."""
    from decoder.side_information.block_motion import estimate_motion

    assert found.model is not None
    norms = {}
    for name, rendered in _interpolations(found.model, first, second).items():
        motion = rendered.positions[1] - rendered.positions[0]
        norms[f"3D {name}"] = np.hypot(motion[..., 0], motion[..., 1])
    field = estimate_motion(first, second, Fraction(1, 2)) / 4.0
    norms["2D block motion"] = np.kron(np.hypot(field[..., 0], field[..., 1]), np.ones((8, 8)))
    highest = float(np.percentile(norms["3D depth"], 99.5))
    height, width = first.shape
    return side_by_side(
        [
            panel(_coloured(norm[:height, :width], highest), f"{name} (bright: {highest:.0f} px)")
            for name, norm in norms.items()
        ]
    )


def draw(clip: str) -> list[Path]:
    """Draw the pictures of one sequence."""
    with open_video(clip_source(clip).path, start=GOP, num_frames=GOP + 1) as reader:
        frames = [frame.luma for frame in islice(reader, GOP + 1)]
    found = reconstruct(frames[0], frames[GOP])
    if not found.success:
        return []
    pictures = {
        "correspondences": lambda: _correspondences(found, frames[GOP], clip),
        "stages": lambda: _stages(frames, found),
        "motion": lambda: _motion_norms(found, frames[0], frames[GOP]),
    }
    return [write_picture(FOLDER / f"{clip}_{name}.jpg", pictures[name]()) for name in SHOWN[clip]]
