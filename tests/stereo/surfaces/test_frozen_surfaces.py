"""Surfaces of a real pair nearly equal the stored ones; `DVC_REGENERATE=1` stores new ones."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from skimage.data import stereo_motorcycle

from dvc.geometry.camera_array import CameraArray, DisparityLabels
from dvc.stereo.surfaces.reconstruct import reconstruct
from dvc.stereo.surfaces.stereo_settings import StereoSettings
from tests.stereo.data import pair_of

FOLDER = Path(__file__).resolve().parents[2] / "golden" / "surfaces"
LABELS = DisparityLabels(0.0, 1.0, 16)
UNITS = 256.0
"""Of a disparity in pixels, and of a confidence, as they are kept."""
KEPT = {
    "labels": (StereoSettings(), (1.0, 1.0, 1.0)),
    "sub-pixel": (StereoSettings(sub_pixel=True), (0.92, 0.9, 0.88)),
}
"""Settings, and the exposures of the channels of the right view."""
MOST_OTHER, MOST_LESS_SURE = 0.002, 0.0005
"""Largest share of changed disparities, and largest mean change of the confidence."""


def motorcycle(exposures: tuple[float, float, float]) -> CameraArray:
    """Return the pair of scikit-image, a fifth as large."""
    left, right, _ = stereo_motorcycle()
    views = left, np.rint(right * np.array(exposures)).astype(np.uint8)
    small = [cv2.resize(view, (148, 100), interpolation=cv2.INTER_AREA) for view in views]
    return pair_of(*small)


@pytest.mark.parametrize("name", KEPT)
def test_surfaces_are_those_that_are_kept(name: str) -> None:
    settings, exposures = KEPT[name]
    surfaces = reconstruct(motorcycle(exposures), LABELS, settings).surfaces
    rows = [np.hstack([one.disparity, one.confidence]) for one in surfaces]
    found: NDArray[np.uint16] = np.rint(UNITS * np.vstack(rows)).astype(np.uint16)
    path = FOLDER / f"{name}.png"
    if os.environ.get("DVC_REGENERATE") == "1":
        cv2.imwrite(str(path), found)
    kept = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert kept is not None
    off = np.abs(found / UNITS - kept / UNITS)
    disparity, confidence = np.hsplit(off, 2)
    assert (disparity > 1.0 / UNITS).mean() <= MOST_OTHER
    assert confidence.mean() <= MOST_LESS_SURE
