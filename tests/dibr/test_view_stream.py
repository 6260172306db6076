"""Streams of views: headers and layers there and back, damage; layers alone, cut off, or never made."""

import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.dibr.dibr_streams import BUILT_IN_CODECS
from dvc.dibr.view_encoder import ViewEncoder, layer_multipliers
from dvc.dibr.view_set import Views
from dvc.dibr.view_stream import (
    Decoded,
    Header,
    PairLayer,
    Stream,
    decode,
    decode_header,
    decode_stream,
    encode_header,
    encode_layer,
    encode_stream,
)
from dvc.errors import BitstreamError, ConfigError
from dvc.geometry.camera_array import DisparityLabels, LatticePosition
from dvc.geometry.viewpoints import CalibratedViewpoint
from tests.dibr.scenes import views_of_square

POSITIONS = LatticePosition(0.0, 0.0), LatticePosition(1.0, 0.0), LatticePosition(0.0, -0.5)
LAYERS = [
    (PairLayer(b"first picture", b"first map"), PairLayer(b"", b"\0")),
    (PairLayer(bytes(300), b""), PairLayer(b"more", b"of it")),
]


def _header(**changes):
    values = {
        "shape": (375, 450),
        "method": "s",
        "labels": DisparityLabels(-3.5, 0.25, 60),
        "references": (0, 2),
        "num_layers": 2,
        "viewpoints": POSITIONS,
    }
    return Header(**(values | changes))


def _rotation(angle):
    return np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]])


def test_headers_come_back():
    header = _header()
    data = encode_header(header)
    found, end = decode_header(data + b"layers")
    assert end == len(data)
    assert vars(found) == vars(header)


def test_a_header_has_at_most_32_bytes_beside_cameras():
    data = encode_header(_header(references=(0,)))
    assert len(data) - 8 * len(POSITIONS) <= 32


def test_calibrated_cameras_come_back():
    intrinsic = np.array([[500.0, 0.25, 224.5], [0, 501.0, 187], [0, 0, 1]])
    cameras = tuple(
        CalibratedViewpoint(intrinsic, np.column_stack([_rotation(angle), [angle, 2.0, -3.0]]))
        for angle in (0.0, 0.3)
    )
    found, _ = decode_header(encode_header(_header(viewpoints=cameras, references=(1,))))
    for viewpoint, camera in zip(found.viewpoints, cameras, strict=True):
        np.testing.assert_allclose(viewpoint.intrinsic, camera.intrinsic, rtol=1e-7)
        np.testing.assert_allclose(viewpoint.pose, camera.pose, atol=1e-6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"shape": (0, 5)}, "5x0"),
        ({"shape": (60000, 60000)}, "pixels are accepted"),
        ({"labels": DisparityLabels(0.0, 1.0, 40000)}, "40000 disparities"),
        ({"labels": DisparityLabels(0.0, 0.0, 4)}, "positive steps"),
        ({"num_layers": 0}, "0 quality layers"),
        ({"references": ()}, "0 references"),
        ({"references": (0, 1, 2, 1)}, "4 references"),
        ({"viewpoints": POSITIONS * 100}, "300 views"),
    ],
)
def test_what_does_not_fit_is_refused(changes, message):
    with pytest.raises(ConfigError, match=message):
        _header(**changes)


def test_layers_come_back():
    data = encode_stream(_header(), LAYERS)
    found = decode_stream(data)
    assert found.layers == tuple(LAYERS)
    assert found.damage is None
    assert "follow the last layer" in decode_stream(data + b"?").damage


def test_any_flipped_byte_is_noticed():
    data = encode_stream(_header(), LAYERS)
    for position in range(len(data)):
        flipped = bytearray(data)
        flipped[position] ^= 0x15
        try:
            found = decode_stream(bytes(flipped))
        except BitstreamError:
            continue
        assert found.layers == (LAYERS[0],)
        assert found.damage is not None


@given(st.binary(max_size=200))
def test_foreign_bytes_are_refused(data):
    with pytest.raises(BitstreamError):
        decode_stream(data)


@given(st.binary(min_size=1, max_size=120))
def test_headers_with_a_right_checksum_but_wrong_numbers(noise):
    fixed = b"DIBR\x01" + noise
    data = fixed + zlib.crc32(fixed).to_bytes(4, "little")
    try:
        header, _ = decode_header(data + bytes(8))
    except BitstreamError:
        return
    assert max(header.references) < len(header.viewpoints)


@pytest.mark.parametrize("position", [1e13, -1.7e38, np.inf, np.nan])
def test_cameras_that_are_nowhere_are_refused(position):
    data = encode_header(_header(viewpoints=(LatticePosition(0.0, position), *POSITIONS[1:])))
    with pytest.raises(BitstreamError, match="finite position"):
        decode_header(data)
    other = data[:4] + b"\x09" + data[5:]
    with pytest.raises(BitstreamError, match="version 9"):
        decode_header(other)


EVERY_METHOD = pytest.mark.parametrize("method", BUILT_IN_CODECS)
LABELS = DisparityLabels(0.0, 1.0, 8)
NUM_LAYERS, MULTIPLIER = 3, 2e-4
PLACES = 0, 1, -1


def encoder(method: str, num_layers: int = NUM_LAYERS, references: tuple[int, ...] = (0,)) -> ViewEncoder:
    """Return the encoder of small gray views."""
    pictures = tuple(np.ascontiguousarray(view[:, :, 1]) for view in views_of_square(PLACES, 13, 20))
    views = Views(pictures, tuple(LatticePosition(float(m), 0.0) for m in PLACES), references)
    return ViewEncoder(views, LABELS, method, num_layers)


def assert_same(one: Decoded, other: Decoded) -> None:
    """Pictures and disparities are the same."""
    for found, expected in zip(one.pairs, other.pairs, strict=True):
        np.testing.assert_array_equal(found.picture, expected.picture)
        np.testing.assert_array_equal(found.disparity, expected.disparity)


def squared_error(decoded: Decoded) -> float:
    """Return that of the reference."""
    truth = views_of_square(PLACES, *decoded.header.shape)[0][:, :, 1].astype(float)
    return float(np.square(decoded.pairs[0].picture - truth).mean())


@EVERY_METHOD
def test_decoding_k_layers_is_encoding_with_k_layers(method: str) -> None:
    """The first k layers are those of a stream that ends at their multiplier (3.35), (3.36)."""
    whole = decode_stream(encoder(method).encode(MULTIPLIER).data)
    for count, multiplier in enumerate(layer_multipliers(MULTIPLIER, NUM_LAYERS), 1):
        alone = decode_stream(encoder(method, count).encode(multiplier).data)
        assert alone.layers == whole.layers[:count]
        assert_same(decode(whole, count), decode(alone))
    errors = [squared_error(decode(whole, count + 1)) for count in range(NUM_LAYERS)]
    assert errors == sorted(errors, reverse=True)
    assert errors[0] > 2.0 * errors[-1]


@EVERY_METHOD
def test_a_cut_at_any_byte_leaves_the_layers_before_it(method: str) -> None:
    data = encoder(method).encode(MULTIPLIER).data
    whole = decode_stream(data)
    _, start = decode_header(data)
    ends = start + np.cumsum([len(encode_layer(layer)) for layer in whole.layers])
    wanted = [decode(whole, count + 1) for count in range(NUM_LAYERS)]
    for end in range(len(data)):
        count = int((ends <= end).sum())
        if count == 0:
            with pytest.raises(BitstreamError):
                decode(decode_stream(data[:end]))
            continue
        found = decode(decode_stream(data[:end]))
        assert found.num_layers == count
        assert str(found.damage).startswith(f"layer {count + 1} of {NUM_LAYERS}")
        assert_same(found, wanted[count - 1])


def damaged(stream: Stream, layer: int, pair: int, part: PairLayer) -> bytes:
    """Return the stream with another part in one place, and right checksums."""
    layers = [list(one) for one in stream.layers]
    layers[layer][pair] = part
    return encode_stream(stream.header, [tuple(one) for one in layers])


@pytest.mark.parametrize("pair", [0, 1])
@pytest.mark.parametrize("layer", [0, 1, 2])
def test_what_cannot_have_been_written_ends_the_layers(layer: int, pair: int) -> None:
    stream = decode_stream(encoder("blocks", references=(0, 2)).encode(MULTIPLIER).data)
    picture, disparity = stream.layers[layer][pair]
    other = bytes([picture[0] ^ 0x10]) + picture[1:]  # in colour
    parts = PairLayer(picture, disparity[:-1]), PairLayer(other, disparity), PairLayer(b"", disparity)
    for part in parts:
        data = damaged(stream, layer, pair, part)
        if layer == 0:
            with pytest.raises(BitstreamError):
                decode(decode_stream(data))
            continue
        found = decode(decode_stream(data))
        assert found.num_layers == layer
        assert str(found.damage).startswith(f"layer {layer + 1} of {NUM_LAYERS}: ")
        assert_same(found, decode(stream, layer))
        assert decode(decode_stream(data), layer).damage is None
