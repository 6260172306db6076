"""What every codec of disparity maps must do, whatever it is given."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from dvc.dibr.disparity.disparity_codec import DisparityCodec
from dvc.dibr.disparity.error_tensor import error_tensor
from dvc.dibr.disparity.integer_transforms import level_shapes
from dvc.errors import BitstreamError
from dvc.geometry.camera_array import LatticePosition
from dvc.geometry.viewpoints import lattice_warp

NUM_LABELS = 12
"""Of `step_edge`."""


def step_edge(
    height: int = 37, width: int = 50, noise: float = 0.02
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Return the error tensor of a textured scene with a square in front, and its labels."""
    rng = np.random.default_rng(1)
    texture = gaussian_filter(rng.normal(size=(height, width + 16)), 0.7)
    near = gaussian_filter(rng.normal(size=(height, width + 16)), 0.7)
    labels = np.full((height, width), 3)
    labels[8:24, 20:40] = 9
    target = np.where(labels == 9, near[:, :width], texture[:, :width])
    columns = np.arange(width)
    view = texture[:, np.minimum(columns + 3, width + 15)].copy()
    view[8:24, 11:31] = near[8:24, 20:40]
    view += noise * rng.normal(size=view.shape)
    warp = lattice_warp(LatticePosition(0.0, 0.0), LatticePosition(1.0, 0.0))
    return error_tensor(target, [view], [warp], np.arange(float(NUM_LABELS))), labels


def random_significance(seed: int, shape: tuple[int, int]) -> list[NDArray[np.uint8]]:
    """Return where coefficients of each level may differ from what is predicted."""
    rng = np.random.default_rng(seed)
    return [rng.choice(2, size, p=(0.6, 0.4)).astype(np.uint8) for size in level_shapes(shape)[1:]]


class DisparityCodecContract:
    """Tests of a codec; a class derived from this one says which, by the fixture `codec`."""

    @pytest.mark.parametrize("seed", range(30))
    def test_what_was_written_comes_back(self, codec: DisparityCodec, seed: int) -> None:
        """Any size, number of labels and significance: the decoded map is that of the encoder."""
        rng = np.random.default_rng(seed)
        height, width, num_labels = (int(rng.integers(1, highest)) for highest in (20, 20, 71))
        multiplier = float(rng.choice([1e-4, 1e-2, 1.0]))
        tensor = rng.uniform(size=(height, width, num_labels)).astype(np.float32)
        significance = random_significance(seed, (height, width)) if seed % 2 else None
        found = codec.optimise(tensor, multiplier, significance)
        labels = found.disparity()
        assert labels.shape == (height, width)
        assert labels.min() >= 0
        assert labels.max() < num_labels
        payload = codec.encode(found, significance)
        decoded = codec.decode(payload, (height, width), num_labels, significance)
        for level in range(4):
            np.testing.assert_array_equal(decoded.disparity(level), found.disparity(level))
        assert codec.encode(decoded, significance) == payload

    def test_a_step_edge_is_found(self, codec: DisparityCodec) -> None:
        """The map is right but for the shadow of the square, and blocks that its edges cross."""
        tensor, labels = step_edge()
        found = codec.optimise(tensor, 1e-3).disparity()
        wrong = (found != labels)[:, 12:]
        wrong[8:24, :9] = False  # hidden in the other view
        assert wrong.mean() < 0.2

    @pytest.mark.parametrize("seed", range(60))
    def test_any_bytes_are_a_map_or_an_error(self, codec: DisparityCodec, seed: int) -> None:
        """Arbitrary payloads give valid labels or BitstreamError."""
        rng = np.random.default_rng(seed)
        height, width, num_labels = (int(rng.integers(1, highest)) for highest in (13, 13, 301))
        payload = rng.bytes(int(rng.integers(0, 201)))
        significance = random_significance(seed, (height, width))
        try:
            labels = codec.decode(payload, (height, width), num_labels, significance).disparity()
        except BitstreamError:
            return
        assert labels.shape == (height, width)
        assert labels.min() >= 0
        assert labels.max() < num_labels

    def test_damage_is_borne(self, codec: DisparityCodec) -> None:
        """Cut at every byte or with any byte changed, a payload gives a map or an error."""
        tensor, _ = step_edge()
        payload = codec.encode(codec.optimise(tensor, 1e-4))
        rng = np.random.default_rng(0)
        damaged = [payload[:length] for length in range(len(payload))]
        for place in range(len(payload)):
            changed = bytearray(payload)
            changed[place] ^= int(rng.integers(1, 256))
            damaged.append(bytes(changed))
        for data in damaged:
            try:
                labels = codec.decode(data, tensor.shape[:2], NUM_LABELS).disparity()
            except BitstreamError:
                continue
            assert labels.min() >= 0
            assert labels.max() < NUM_LABELS

    def test_a_layer_refines_what_precedes_it(self, codec: DisparityCodec) -> None:
        """Where maps are coded as differences, the one before is used: no change costs next to nothing."""
        tensor, _ = step_edge(noise=0.1)
        shape = tensor.shape[0], tensor.shape[1]
        first = codec.optimise(tensor, 1e-2)
        if not codec.layered:
            assert codec.decode(codec.encode(first), shape, NUM_LABELS).disparity().shape == shape
            return
        again = codec.optimise(tensor, 1e-2, previous=first)
        assert len(codec.encode(again, previous=first)) <= 8
        fine = codec.optimise(tensor, 1e-4, previous=first)
        payload = codec.encode(fine, previous=first)
        decoded = codec.decode(payload, shape, NUM_LABELS, previous=first)
        np.testing.assert_array_equal(decoded.disparity(), fine.disparity())
