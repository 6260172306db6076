"""Streams of depth maps: layout, cuts, damage."""

import re
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.dibr.depth_image.depth_image_stream import (
    DepthImageStream,
    DepthScale,
    PlaneCode,
    decode_extent,
    decode_stream,
    encode_extent,
    encode_stream,
)
from dvc.errors import BitstreamError, ConfigError
from dvc.images.chain_code import EdgeCode
from dvc.images.picture_codec import PictureHeader

DEPTH = PlaneCode(PictureHeader(5, 9, points=(3, 4)), 1, bytes(range(100)))
PICTURE = PlaneCode(PictureHeader(5, 11, colour=True), 2, bytes(range(200, 250)))


def stream_of(picture=PICTURE, **changes):
    options = {"scale": DepthScale(1.5, 40.0), "edges": b"edges", "edge_code": EdgeCode.FIXED} | changes
    return DepthImageStream((30, 40), depth=DEPTH, picture=picture, **options)


def assert_same(one, other):
    for name in ("shape", "scale", "edges", "edge_code", "picture_edges", "masked"):
        assert getattr(one, name) == getattr(other, name)
    for first, second in ((one.depth, other.depth), (one.picture, other.picture)):
        assert (first is None) == (second is None)
        if first is not None:
            assert (first.header, first.order, first.data) == (second.header, second.order, second.data)


@pytest.mark.parametrize("picture", [None, PICTURE])
@pytest.mark.parametrize("scale", [DepthScale(1.5, 40.0), DepthScale(0.0, 255.0, 0.25, -3.5)])
@pytest.mark.parametrize("flags", [(False, EdgeCode.FIXED), (True, EdgeCode.ADAPTIVE)])
def test_streams_come_back(picture, scale, flags):
    stream = stream_of(picture, scale=scale, picture_edges=flags[0], masked=flags[0], edge_code=flags[1])
    found = decode_stream(encode_stream(stream))
    assert_same(found, stream)
    assert found.damage is None
    assert found.part_bytes == stream.part_bytes


def test_headers_are_at_most_32_bytes_beside_the_scale():
    long = PlaneCode(DEPTH.header, 1, bytes(10_000))
    picture = PlaneCode(PICTURE.header, 0, bytes(100_000))
    stream = DepthImageStream((375, 450), DepthScale(0, 1), bytes(300), EdgeCode.ADAPTIVE, long, picture)
    assert stream.part_bytes["header"] <= 32
    assert stream_of(None).part_bytes["header"] <= 28


def test_a_cut_leaves_both_the_same_share():
    data = encode_stream(stream_of())
    refusals = set()
    for length in range(len(data)):
        try:
            found = decode_stream(data[:length])
        except BitstreamError as error:
            refusals.add(re.sub("after .*", "", str(error)))
            assert length < len(data) - 154 + 1
            continue
        assert str(len(data)) in found.damage
        depth, picture = len(found.depth.data), len(found.picture.data)
        assert sum(found.part_bytes.values()) == length
        assert DEPTH.data.startswith(found.depth.data)
        assert PICTURE.data.startswith(found.picture.data)
        assert depth == (depth + picture) * 100 // 150
    assert len(refusals) == 3
    assert sum("ends within its" in refusal for refusal in refusals) == 2


def test_any_flipped_byte_of_a_whole_stream_is_noticed():
    data = bytearray(encode_stream(stream_of()))
    for place in range(len(data)):
        data[place] ^= 0x15
        with suppress(BitstreamError):
            assert decode_stream(bytes(data)).damage is not None  # lengths that seem to go on
        data[place] ^= 0x15


@given(st.binary(max_size=80))
def test_any_bytes_after_the_magic_are_a_stream_or_refused(data):
    for version in (b"\x03", b"\x05"):
        try:
            found = decode_stream(b"DIBR" + version + data)
        except BitstreamError:
            continue
        assert found.shape[0] > 0


def test_what_follows_the_end_is_told():
    assert decode_stream(encode_stream(stream_of()) + b"more").damage == "4 bytes follow"


@pytest.mark.parametrize("extent", [0.0, 1e-6, 0.3, 1.0, 40.25, 255.0, 65535.0, 1e12])
def test_ranges_are_rounded_up_a_little(extent):
    scale = DepthScale.of(np.array([[0.0, extent]]))
    assert extent <= scale.extent <= extent * 1.01
    assert decode_extent(encode_extent(scale.extent)) == scale.extent


@given(st.floats(-1e6, 1e6, width=32, allow_subnormal=False), st.just(0.0) | st.floats(1e-3, 1e6))
def test_maps_are_within_their_scale(lowest, extent):
    depth = np.array([[lowest, lowest + extent]])
    scale = DepthScale.of(depth)
    back = scale.depth(scale.levels(depth))
    np.testing.assert_allclose(back, depth, rtol=1e-6, atol=1e-6 * max(abs(lowest), extent))


@pytest.mark.parametrize(("largest", "factor"), [(1e13, 1.0), (2.0, 0.0), (2.0, 1e-60), (2.0, 1e13)])
def test_numbers_and_factors_without_bounds_are_refused(largest, factor):
    with pytest.raises(ConfigError, match="at most" if largest > 2.0 else "factor"):
        DepthScale.of(np.array([[1.0, largest]]), factor)


def test_negative_ranges_are_refused():
    with pytest.raises(BitstreamError, match="cannot have been written"):
        decode_stream(encode_stream(stream_of(scale=DepthScale(1.5, -40.0))))
