"""Coding of depth maps and pictures: quality, sizes, odd maps, cuts."""

import tracemalloc

import numpy as np
import pytest

from dvc.dibr.depth_image.depth_image_encoder import (
    NUM_STEPS,
    DepthImage,
    DepthOptions,
    code_edges,
    code_with_edges,
    encode_to_size,
)
from dvc.dibr.depth_image.depth_image_stream import DepthScale, decode, decode_stream
from dvc.errors import BitstreamError, ConfigError
from dvc.images.chain_code import EdgeCode
from dvc.images.edge_maps import EdgeMaps
from dvc.images.edge_selection import canny_edges, edges_of_jumps
from tests.dibr.scenes import texture, two_discs

DISCS = two_discs()
NONE = code_edges(EdgeMaps.none(DISCS.shape))


def encode(depth, max_bytes, edges=None, picture=None, **options):
    image = DepthImage(depth, DepthScale.of(depth), picture)
    return encode_to_size(image, max_bytes, edges, **options)


def psnr(encoded, depth):
    found = decode(decode_stream(encoded.data)).depth
    return 10 * np.log10(np.ptp(depth) ** 2 / np.mean((found - depth) ** 2))


def test_edges_that_pay_gain_decibels():
    standard, automatic = (psnr(encode(DISCS, 220, edges), DISCS) for edges in (NONE, None))
    assert automatic > standard + 6


def test_streams_fill_their_bytes_and_decode_to_what_the_encoder_says():
    for max_bytes in (60, 110, 220):
        encoded = encode(DISCS, max_bytes)
        assert max_bytes - 4 <= len(encoded.data) <= max_bytes
        assert sum(encoded.part_bytes.values()) == len(encoded.data)


def test_squared_errors_of_lengths_are_about_those_of_codes():
    edges = code_edges(edges_of_jumps(DISCS, 5.0))
    candidate = code_with_edges(DISCS, DepthScale.of(DISCS), edges, 1000, DepthOptions())
    least = len(edges.data)
    assert candidate.mse_at(least - 1) == np.inf
    assert candidate.cut(least - 1) is None
    for more in (0, 20, 60, 200, 500):
        code = candidate.cut(least + more)
        assert code is not None
        assert candidate.mse_at(least + more) == pytest.approx(code.mse, rel=1.0)


def test_given_edges_are_coded_as_they_are():
    for edges, code in (
        (edges_of_jumps(DISCS, 5.0), EdgeCode.FIXED),
        (canny_edges(DISCS), EdgeCode.ADAPTIVE),
    ):
        decoded = decode(decode_stream(encode(DISCS, 600, code_edges(edges, code)).data))
        assert decoded.stream.edge_code is code
        np.testing.assert_array_equal(decoded.edges.between_rows, edges.between_rows)
        np.testing.assert_array_equal(decoded.edges.between_columns, edges.between_columns)
    assert canny_edges(DISCS).count() > 0.5 * edges_of_jumps(DISCS, 5.0).count()


def test_more_bytes_are_better_up_to_no_error_in_quarters():
    depth = np.round(4 * DISCS) / 4
    qualities = [psnr(encode(depth, size), depth) for size in (100, 200, 400)]
    assert qualities == sorted(qualities)
    whole = decode(decode_stream(encode(depth, 20_000, NONE).data)).depth
    np.testing.assert_array_equal(np.round(4 * whole) / 4, depth)


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (9, 1), (2, 2), (33, 17)])
def test_small_and_odd_maps(shape):
    depth = np.random.default_rng(0).integers(0, 3, shape).astype(float)
    options = DepthOptions(num_levels=min(5, (max(shape) - 1).bit_length()))
    decoded = decode(decode_stream(encode(depth, 2000, depth_options=options).data))
    np.testing.assert_allclose(decoded.depth, depth, atol=0.01)


def test_constant_maps_come_back_exactly():
    for level in (0.0, 12.3, -4.0):
        depth = np.full((20, 30), np.float64(np.float32(level)))
        np.testing.assert_array_equal(decode(decode_stream(encode(depth, 40).data)).depth, depth)


@pytest.mark.parametrize("share", [0.01, 0.3, 1.0])
@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_edges_of_any_kind(share, order):
    rng = np.random.default_rng(1)
    below, right = ((rng.random(DISCS.shape) < share).astype(np.uint8) for _ in range(2))
    below[-1], right[:, -1] = 0, 0
    edges = code_edges(EdgeMaps(below, right))
    encoded = encode(DISCS, len(edges.data) + 40_000, edges, depth_options=DepthOptions(order=order))
    assert psnr(encoded, DISCS) > 50


def test_pictures_share_the_edges_where_that_helps():
    picture = np.where(DISCS > 20, 200, 60).astype(np.uint8) // 2 + texture() // 2
    encoded = encode(DISCS, 1500, picture=picture)
    assert encoded.stream.picture_edges
    decoded = decode(decode_stream(encoded.data))
    assert decoded.picture.shape == picture.shape
    assert np.mean((decoded.picture.astype(float) - picture) ** 2) < 100
    beside = encode(DISCS, 1500, picture=texture(seed=3))
    assert decode(decode_stream(beside.data)).picture.shape == picture.shape


def test_shares_are_kept_and_automatic_ones_are_between():
    picture = texture()
    for share in (0.1, 0.2):
        encoded = encode(DISCS, 1500, picture=picture, depth_options=DepthOptions(depth_share=share))
        parts = encoded.part_bytes
        found = (parts["edges"] + parts["depth"]) / (len(encoded.data) - parts["header"])
        assert found == pytest.approx(share, abs=0.01)
    automatic = encode(DISCS, 1500, picture=picture, depth_options=DepthOptions(depth_share=None))
    assert 0.01 < automatic.part_bytes["depth"] / 1500 < 0.6


def test_colour_and_resolutions():
    picture = np.stack([texture(seed=k) for k in range(3)], axis=-1)
    stream = decode_stream(encode(DISCS, 4000, picture=picture).data)
    for resolution in (0, 1, 3):
        decoded = decode(stream, resolution)
        size = tuple(-(-side // 2**resolution) for side in DISCS.shape)
        assert decoded.depth.shape == size
        assert decoded.picture.shape == (*size, 3)
        assert abs(decoded.depth.mean() - DISCS.mean()) < 1.5
        assert abs(decoded.disparity.mean() - DISCS.mean() / 2**resolution) < 1.5
    with pytest.raises(ConfigError, match="resolution"):
        decode(stream, 6)


def test_a_stream_cut_at_any_byte_decodes_or_says_where_it_ends():
    encoded = encode(DISCS, 200, picture=texture())
    errors = []
    for length in range(len(encoded.data)):
        try:
            decoded = decode(decode_stream(encoded.data[:length]))
        except BitstreamError:
            assert length <= encoded.part_bytes["header"] + encoded.part_bytes["edges"]
            continue
        assert decoded.stream.damage is not None
        errors.append(np.mean((decoded.depth - DISCS) ** 2))
    assert errors[-1] < 0.1 * errors[0]


def test_too_few_bytes_are_refused():
    edges = code_edges(edges_of_jumps(DISCS, 5.0))
    with pytest.raises(ConfigError, match="too few"):
        encode(DISCS, 20)
    with pytest.raises(ConfigError, match="too few"):
        encode(DISCS, len(edges.data) + 20, edges)


@pytest.mark.parametrize(
    ("depth", "told"),
    [
        (np.broadcast_to(1.0, (4000, 6000)), "6000x4000"),
        (np.broadcast_to(1.0, (2, 70_000)), "70000x2"),
        (np.array([[-1e12, 1e12]]), "range"),
    ],
    ids=["pixels", "side", "range"],
)
def test_maps_that_no_decoder_accepts_are_refused(depth, told):
    scale = DepthScale.of(depth[:1])
    with pytest.raises(ConfigError, match=told):
        encode_to_size(DepthImage(depth, scale), 10_000, NONE)


@pytest.mark.parametrize(("channels", "most"), [(None, 44), (1, 44), (3, 64)])
def test_the_largest_streams_decode_in_a_gibibyte(channels, most):
    """Pixels are limited to 2^24 of them, so each may take 64 bytes."""
    size = 768
    depth = np.add.outer(np.zeros(size), np.linspace(0.0, 50.0, size))
    depth[100:500, 200:600] += 20.0
    flat = np.full((size, size, 3) if channels == 3 else (size, size), 77, np.uint8)
    edges = code_edges(edges_of_jumps(depth, 5.0))
    image = DepthImage(depth, DepthScale.of(depth), None if channels is None else flat)
    stream = decode_stream(encode_to_size(image, 3000, edges).data)
    decode(stream)
    tracemalloc.start()
    decoded = decode(stream)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak / depth.size < most
    assert np.abs(decoded.depth - depth).mean() < 1.0


def test_progress_of_selections_has_an_end():
    for depth in (DISCS, np.full((16, 16), 3.0), np.random.default_rng(0).normal(size=(40, 40))):
        steps = []
        encode(depth, 150, advance=steps.append)
        assert sum(steps) == NUM_STEPS
        assert min(steps) >= 0
