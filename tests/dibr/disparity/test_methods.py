"""Every representation of disparity: round trips, damage, degenerate maps, layers, rates."""

from contextlib import suppress

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from benchmarks.baselines.thesis_disparities import SPLIT_BITS, FixedQuadtreeCodec, LaplacianCodec
from dvc.dibr.disparity.disparity_codec import DisparityCodec, Holes, error_tensor
from dvc.dibr.disparity.integer_transforms import L_TRANSFORM, S_TRANSFORM, Labels, WaveletTree, level_shapes
from dvc.dibr.disparity.square_codecs import QuadtreeCodec
from dvc.dibr.disparity.tree_codec import WaveletCodec
from dvc.dibr.view_stream import METHODS
from dvc.errors import BitstreamError
from dvc.geometry.camera_array import LatticePosition
from dvc.geometry.viewpoints import lattice_warp

CODECS: dict[str, DisparityCodec] = METHODS | {
    "l as written": LaplacianCodec(L_TRANSFORM),
    "s as written": LaplacianCodec(S_TRANSFORM),
    "fixed quadtree": FixedQuadtreeCodec(),
}
"""Those that streams name, and those of the thesis."""
EVERY = pytest.mark.parametrize("name", CODECS)
NOT_BLOCKS = pytest.mark.parametrize("name", [name for name in CODECS if name != "blocks"])
LAYERED = [name for name, codec in CODECS.items() if codec.layered]
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


@EVERY
@pytest.mark.parametrize("seed", range(30))
def test_what_was_written_comes_back(name: str, seed: int) -> None:
    rng, codec = np.random.default_rng(seed), CODECS[name]
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


@EVERY
def test_any_bytes_are_a_map_or_an_error(name: str) -> None:
    tensor, _ = step_edge()
    codec, rng = CODECS[name], np.random.default_rng(0)
    payload = codec.encode(codec.optimise(tensor, 1e-4))
    shape: tuple[int, int] = (tensor.shape[0], tensor.shape[1])
    cases = [(payload[:length], shape, NUM_LABELS, None) for length in range(len(payload))]
    for position in range(len(payload)):
        changed = bytearray(payload)
        changed[position] ^= int(rng.integers(1, 256))
        cases.append((bytes(changed), shape, NUM_LABELS, None))
    for seed in range(60):
        height, width, num_labels = map(int, rng.integers(1, (13, 13, 301)))
        significance = random_significance(seed, (height, width))
        cases.append((rng.bytes(int(rng.integers(0, 201))), (height, width), num_labels, significance))
    for data, shape, num_labels, significance in cases:
        with suppress(BitstreamError):
            labels = codec.decode(data, shape, num_labels, significance).disparity()
            assert labels.shape == shape
            assert 0 <= labels.min() <= labels.max() < num_labels


@pytest.mark.parametrize("name", LAYERED)
def test_a_layer_refines_what_precedes_it(name: str) -> None:
    tensor, _ = step_edge(noise=0.1)
    codec, shape = CODECS[name], (tensor.shape[0], tensor.shape[1])
    first = codec.optimise(tensor, 1e-2)
    again = codec.optimise(tensor, 1e-2, previous=first)
    assert len(codec.encode(again, previous=first)) <= 8
    fine = codec.optimise(tensor, 1e-4, previous=first)
    payload = codec.encode(fine, previous=first)
    decoded = codec.decode(payload, shape, NUM_LABELS, previous=first)
    np.testing.assert_array_equal(decoded.disparity(), fine.disparity())
    assert len(payload) < len(codec.encode(codec.optimise(tensor, 1e-4)))


@EVERY
def test_a_step_edge_is_found(name: str) -> None:
    tensor, labels = step_edge()
    wrong = (CODECS[name].optimise(tensor, 1e-3).disparity() != labels)[:, 12:]
    wrong[8:24, :9] = False  # hidden in the other view
    assert wrong.mean() < (0.2 if name == "blocks" else 0.03)  # edges cross blocks


@NOT_BLOCKS
def test_dearer_bits_are_fewer(name: str) -> None:
    tensor, _ = step_edge(noise=0.2)
    codec, sizes, errors = CODECS[name], [], []
    for multiplier in (1e-5, 1e-3, 1e-1):
        found = codec.optimise(tensor, multiplier)
        sizes.append(len(codec.encode(found)))
        errors.append(np.take_along_axis(tensor, found.disparity()[:, :, None], 2).sum())
    assert sizes == sorted(sizes, reverse=True)
    assert errors == sorted(errors)


@pytest.mark.parametrize("name", LAYERED)
def test_insignificant_coefficients_are_not_coded(name: str) -> None:
    tensor, _ = step_edge()
    codec, shape = CODECS[name], tensor.shape[:2]
    nothing = [np.zeros(size, np.uint8) for size in level_shapes(shape)[1:]]
    found = codec.optimise(tensor, 1e-5, nothing)
    assert np.unique(found.disparity()).size == 1
    assert len(codec.encode(found, nothing)) <= 4
    nothing[0][:, :5] = 1
    labels = codec.optimise(tensor, 1e-5, nothing).disparity()
    assert np.unique(labels[:, 10:]).size == 1
    assert np.unique(labels[:, :10]).size > 1


def test_stopping_early_needs_more_bits() -> None:
    tensor, _ = step_edge()
    early = WaveletCodec(L_TRANSFORM, num_levels=2)
    found = early.optimise(tensor, 1e-3)
    assert found.roots.shape == (10, 13)
    payload = early.encode(found)
    np.testing.assert_array_equal(
        early.decode(payload, tensor.shape[:2], NUM_LABELS).disparity(), found.disparity()
    )
    complete = METHODS["l"]
    assert len(payload) > len(complete.encode(complete.optimise(tensor, 1e-3))) + 100 * 3 // 8


def test_blocks_have_codes_of_fixed_length() -> None:
    """12 labels take 4 bits a block; other lengths, and labels that there are not, are errors."""
    tensor, _ = step_edge()
    codec = METHODS["blocks"]
    payload = codec.encode(codec.optimise(tensor, 1.0))
    assert len(payload) == -(-5 * 7 * 4 // 8)
    with pytest.raises(BitstreamError, match="bytes"):
        codec.decode(payload[:-1], tensor.shape[:2], NUM_LABELS)
    with pytest.raises(BitstreamError, match="label 15"):
        codec.decode(b"\xff" * len(payload), tensor.shape[:2], NUM_LABELS)


@pytest.mark.parametrize("codec", [METHODS["quadtree"], FixedQuadtreeCodec()])
def test_quadtrees_are_pruned_exactly_and_fixed_codes_counted(codec: DisparityCodec) -> None:
    labels = np.arange(4).reshape(2, 2).repeat(8, axis=0).repeat(8, axis=1)
    tensor = (np.arange(4) != labels[:, :, None]).astype(np.float32)
    found = codec.optimise(tensor, 1e-3)
    np.testing.assert_array_equal(found.disparity(), labels)
    assert sum(int(split.sum()) for split in found.splits) == 1
    assert not any(split.any() for split in codec.optimise(tensor, 200.0).splits)
    if isinstance(codec, FixedQuadtreeCodec):
        payload = codec.encode(found)
        assert len(payload) == -(-(5 * SPLIT_BITS + 4 * 2) // 8)
        with pytest.raises(BitstreamError, match="too early"):
            codec.decode(payload[:1], (16, 16), 4)


class _HoleOfLabels:
    """Errors as the tensor knows them, and a hole in one view that label 7 alone would cover."""

    parallax = 1.0

    def __init__(self, tensor: NDArray[np.float32]) -> None:
        self.tensor = tensor
        self.num_claims = 0

    def measure(self, labels: Labels) -> tuple[float, list[Holes]]:
        error = float(np.take_along_axis(self.tensor, labels[:, :, None], 2).sum())
        hole = np.zeros(labels.shape, np.float32)
        hole[:8, :8] = 4.0
        covered = labels == 7
        return error + float(hole[~covered].sum()), [Holes(hole, np.zeros(labels.shape, np.int32))]

    def claimed(self, tensor: NDArray[np.float32], holes: list[Holes], weight: float) -> NDArray[np.float32]:
        self.num_claims += 1
        credited = tensor.copy()
        credited[:, :, 7] -= weight * holes[0].errors
        return credited


@pytest.mark.parametrize("has_credits", [False, True])
def test_quadtrees_may_cover_holes(has_credits: bool) -> None:
    tensor = np.full((16, 16, 9), 0.3, np.float32)
    tensor[:, :, 2] = 0.2
    distortion = _HoleOfLabels(tensor)
    labels = QuadtreeCodec(has_credits).optimise(tensor, 1e-3, distortion=distortion).disparity()
    assert (distortion.num_claims > 0) == has_credits
    assert (labels[:8, :8] == (7 if has_credits else 2)).all()
    assert (labels[8:] == 2).all()


def test_trees_of_any_integers_have_valid_labels() -> None:
    rng = np.random.default_rng(2)
    shapes = level_shapes((9, 6))
    highs = tuple(rng.integers(-50, 50, size).astype(np.int32) for size in shapes[:-1])
    labels = WaveletTree(L_TRANSFORM, 20, np.array([[10]], np.int32), highs).disparity()
    assert (labels.min(), labels.max()) == (0, 19)
