"""Continuation of supported surfaces over what one camera alone sees."""

import numpy as np
import pytest
from numpy.typing import NDArray

from dvc.geometry.camera_array import DisparityLabels, LatticePosition
from dvc.stereo.surfaces.occupancy import Occupancy
from dvc.stereo.surfaces.surface_completion import continued

SHAPE = (40, 60)
LABELS = DisparityLabels(1.0, 0.5, 24)
Pair = tuple[LatticePosition, LatticePosition]
PAIR = LatticePosition(0.0, 0.0), LatticePosition(1.0, 0.0)
BLACK = np.zeros((*SHAPE, 3), np.uint8)
NOWHERE = Occupancy(np.zeros(SHAPE, np.int64), np.zeros(SHAPE, bool))


def filled(own: Occupancy, other: Occupancy, pair: Pair, image: NDArray[np.uint8]) -> NDArray[np.float64]:
    return continued(own, other, LABELS, pair, image, 1.0)


def test_supported_labels_stay_and_planes_go_on() -> None:
    """A slanted plane fills its gap to within the rounding of its labels."""
    plane = 4.0 + 0.11 * np.indices(SHAPE)[1] + 0.05 * np.indices(SHAPE)[0]
    label = np.floor(plane + 0.5).astype(np.int64)
    supported = np.ones(SHAPE, bool)
    supported[12:26, 20:36] = False
    found = filled(Occupancy(np.where(supported, label, 0), supported), NOWHERE, PAIR, BLACK)
    np.testing.assert_array_equal(found[supported], label[supported])
    assert np.abs(found - plane)[~supported].max() < 1.0


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_background_goes_on_beside_an_object(side: float) -> None:
    """What the other camera looks through is not nearer: an occlusion takes the farther surface."""
    far, near = 2, 12
    label = np.full(SHAPE, far)
    label[:, 25:40] = near
    width = int((near - far) * LABELS.step)
    hidden = slice(25 - width, 25) if side > 0 else slice(40, 40 + width)
    supported = np.ones(SHAPE, bool)
    supported[:, hidden] = False
    other = np.full(SHAPE, far)
    start = int(25 - side * LABELS.disparity(np.array(float(near))))
    other[:, start : start + 15] = near
    pair = LatticePosition(0.0, 0.0), LatticePosition(side, 0.0)
    seen = Occupancy(other, np.ones(SHAPE, bool))
    found = filled(Occupancy(np.where(supported, label, 9), supported), seen, pair, BLACK)
    assert (np.abs(found[:, hidden] - far) < 0.5).mean() > 0.9


def test_surfaces_end_at_edges_of_the_picture() -> None:
    """Between two surfaces, what is of the colour of one becomes a part of it."""
    far, near, edge = 3, 10, 33
    label = np.where(np.indices(SHAPE)[1] < 30, far, near)
    supported = np.ones(SHAPE, bool)
    supported[:, 24:40] = False
    image = np.where(np.indices(SHAPE)[1] < edge, 40, 200).astype(np.uint8)
    found = filled(Occupancy(label, supported), NOWHERE, PAIR, np.repeat(image[:, :, None], 3, axis=2))
    expected = np.where(np.indices(SHAPE)[1] < edge, far, near)
    assert (np.abs(found - expected) < 0.5).mean() > 0.97


def test_result_stays_among_the_labels() -> None:
    """Planes are not continued beyond the range; without anything supported there is still a finite map."""
    steep = np.clip(np.indices(SHAPE)[1] // 3, 0, LABELS.num_labels - 1)
    supported = np.indices(SHAPE)[1] < 40
    for occupancy in (Occupancy(steep, supported), Occupancy(steep, np.zeros(SHAPE, bool))):
        found = filled(occupancy, NOWHERE, PAIR, BLACK)
        assert np.isfinite(found).all()
        assert found.min() >= 0.0
        assert found.max() <= LABELS.num_labels - 1


def test_planes_that_leave_the_labels_stay_at_the_last() -> None:
    """A plane that would go on beyond the range ends at its bound."""
    plane = np.floor(20.5 + 0.08 * np.indices(SHAPE)[1]).astype(np.int64)
    found = filled(Occupancy(plane, np.indices(SHAPE)[1] < 36), NOWHERE, PAIR, BLACK)
    assert found.max() == LABELS.num_labels - 1
    assert (found[:, -4:] == LABELS.num_labels - 1).all()
