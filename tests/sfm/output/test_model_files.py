"""Euclidean approximation, and files for other programs."""

import json
from pathlib import Path

import numpy as np
import pytest

from sfm.output.model_files import (
    metric_upgrade,
    point_colours,
    to_dict,
    write_colmap,
    write_json,
    write_points,
)
from sfm.scene_model import Reconstruction
from tests.sfm.euclidean import FOCAL_LENGTH, FRAME, euclidean_scene

NAMES = ("first.png", "second.png")


@pytest.mark.parametrize("plane", [(0.0, 0.0, 0.0), (0.1, -0.1, 0.05)])
def test_metric_upgrade_finds_the_truth(plane: tuple[float, float, float]) -> None:
    """From any nearly Euclidean frame, focal length within 2 %, rotation within 0.1 degrees."""
    truth = euclidean_scene(plane=plane)
    metric = metric_upgrade(truth.model)
    assert abs(metric.focal_length_px / FRAME.scale_px / FOCAL_LENGTH - 1) < 0.02
    turn = metric.second_from_first[:, :3] @ truth.rotation.T
    assert np.degrees(np.arccos(min(1.0, (np.trace(turn) - 1) / 2))) < 0.1
    direction = truth.translation / np.linalg.norm(truth.translation)
    np.testing.assert_allclose(metric.second_from_first[:, 3], direction, atol=0.005)
    assert metric.error_px < 0.3


def test_colmap_reads_what_is_written(tmp_path: Path) -> None:
    """COLMAP finds two registered images, all points, and a small reprojection error."""
    import pycolmap

    model = euclidean_scene(plane=(0.05, 0.0, 0.0)).model
    luma = np.full((288, 352), 77, dtype=np.uint8)
    write_colmap(tmp_path, model, NAMES, point_colours(luma, model.correspondences.first))
    read = pycolmap.Reconstruction(tmp_path)
    assert read.num_reg_images() == 2
    assert read.num_points3D() == len(model.correspondences)
    image = read.images[2]
    errors = [
        np.linalg.norm(image.project_point(read.points3D[point.point3D_id].xyz) - point.xy)
        for point in image.points2D
    ]
    assert max(errors) < 0.5
    assert {tuple(point.color) for point in read.points3D.values()} == {(77, 77, 77)}


def test_ply_holds_the_points(tmp_path: Path) -> None:
    """The PLY file holds the Euclidean points in single precision, with the grey of the first key frame."""
    model = euclidean_scene(num_points=9).model
    luma = np.full((288, 352), 5, dtype=np.uint8)
    write_points(tmp_path / "p.ply", model, point_colours(luma, model.correspondences.first))
    header, _, body = (tmp_path / "p.ply").read_bytes().partition(b"end_header\n")
    assert b"element vertex 9\n" in header
    rows = np.frombuffer(body, dtype=[("xyz", "<f4", 3), ("rgb", "u1", 3)])
    np.testing.assert_allclose(rows["xyz"], metric_upgrade(model).points, rtol=1e-6)
    assert (rows["rgb"] == 5).all()


def test_json_tells_verdict_and_model(tmp_path: Path) -> None:
    """The JSON document is whole with a model and without."""
    truth = euclidean_scene(num_points=12)
    reconstruction = Reconstruction(truth.model, "", "general", {"matching": truth.model.correspondences})
    write_json(tmp_path / "m.json", reconstruction)
    values = json.loads((tmp_path / "m.json").read_text())
    assert values == json.loads(json.dumps(to_dict(reconstruction)))
    assert values["num_correspondences"] == {"matching": 12}
    np.testing.assert_allclose(values["model"]["depths"], truth.model.depths, atol=1e-6)
    assert to_dict(Reconstruction(None, "black", "unknown"))["model"] is None
