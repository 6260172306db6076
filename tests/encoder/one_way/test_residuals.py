"""What tracks leave to be told."""

import numpy as np
import pytest

from dvc._jit import python_twin
from dvc.wynerziv import transform
from encoder.one_way import _kernels
from encoder.one_way.residuals import motion_field, residual_magnitudes
from tests.clips import moving_texture

SHAPE = (48, 64)


def points(displacement: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return points of a frame, and where they are in a reference."""
    grid = np.stack(np.meshgrid(np.arange(5.0, 64, 12), np.arange(5.0, 48, 12)), axis=-1).reshape(-1, 2)
    return grid, grid + displacement


def test_an_even_motion_is_that_of_all_blocks() -> None:
    """In half pixels; points that are not known in both do not count."""
    first, second = points((2.5, -1.0))
    second[3] = np.nan
    first[5] = np.nan
    field = motion_field(first, second, SHAPE)
    assert field.shape == (3, 4, 2)
    assert (field == [5, -2]).all()
    assert not motion_field(first[:0], second[:0], SHAPE).any()
    assert not motion_field(first, second * np.nan, SHAPE).any()


def test_what_moves_with_the_points_leaves_nothing() -> None:
    """Inside the picture; without motion of the points everything is left."""
    rng = np.random.default_rng(1)
    texture = rng.integers(0, 256, (80, 96), dtype=np.uint8)
    frame, reference = (
        texture[10:58, 12:76],
        texture[7:55, 8:72],
    )  # what is at (x, y) is at (x + 4, y + 3) there
    moved = motion_field(*points((4.0, 3.0)), SHAPE)
    still = motion_field(*points((0.0, 0.0)), SHAPE)
    inner = np.arange(48).reshape(6, 8)[:5, :7].ravel()
    assert residual_magnitudes(frame, [reference], [moved])[inner].max() == 0.0
    assert residual_magnitudes(frame, [reference], [still])[inner].min() > 1.0


def test_magnitudes_are_those_of_the_transform() -> None:
    """Mean magnitudes by bands in blocks of 8x8 samples, of two references at rest."""
    frames = [frame.luma for frame in moving_texture(3, *SHAPE)]
    rest = np.zeros((3, 4, 2), np.int64)
    found = residual_magnitudes(frames[1], [frames[0], frames[2]], [rest, rest])
    mean = (frames[0].astype(np.float64) + frames[2]) / 2
    bands = np.abs(transform.forward(frames[1] - mean)).reshape(16, 6, 2, 8, 2).mean(axis=(2, 4))
    np.testing.assert_allclose(found, bands.reshape(16, -1).T, atol=1e-9)


@pytest.mark.parametrize("shape", [(7, 64), (1, 1), (23, 41)])
def test_blocks_that_are_not_whole_are_left_out(shape: tuple[int, int]) -> None:
    """Small pictures have none."""
    luma = np.zeros(shape, np.uint8)
    field = motion_field(np.zeros((0, 2)), np.zeros((0, 2)), shape)
    assert residual_magnitudes(luma, [luma], [field]).shape == ((shape[0] // 8) * (shape[1] // 8), 16)


@pytest.mark.nojit
def test_kernels_are_their_python() -> None:
    """To the last bit, borders and half samples included."""
    rng = np.random.default_rng(2)
    luma, *references = rng.integers(0, 256, (3, 16, 24), dtype=np.uint8)
    fields = rng.integers(-30, 30, (2, 1, 2, 2))
    places, moves = rng.uniform(0, 16, (5, 2)), rng.normal(0.0, 3.0, (5, 2))
    found = []
    for of in (lambda kernel: kernel, python_twin):
        magnitudes, field = np.empty((6, 16)), np.empty((1, 2, 2), np.int64)
        of(_kernels.motion_field)(places, moves, 16.0, field)
        of(_kernels.residual_magnitudes)(
            luma, np.stack(references), fields, 16, transform.SCALE, transform.ORDER, magnitudes
        )
        found.append((field, magnitudes))
    for ours, twins in zip(*found, strict=True):
        np.testing.assert_array_equal(ours, twins)
