"""What is told of surfaces."""

import re

import numpy as np

from dvc.stereo.surface_report import Truth, reported, summary
from tests.stereo.plane_scenes import LABELS, SCENE, reconstruction_of, square_lattice


def test_bad_pixels_are_told_at_three_thresholds() -> None:
    reconstruction = reconstruction_of(SCENE, square_lattice(1), LABELS)
    found = reconstruction.surfaces[reconstruction.array.reference].disparity
    off = np.repeat([0.4, 0.8, 1.5, 3.0], found.size // 4).reshape(found.shape)
    told = summary(reported(reconstruction, Truth(found + off)))
    assert re.findall(r"([\d.]+) % > ([\d.]+) px", told) == [("75.00", "0.5"), ("50.00", "1"), ("25.00", "2")]
    assert "bad pixels" not in summary(reported(reconstruction))
