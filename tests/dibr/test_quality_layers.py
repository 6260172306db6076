"""Quality layers through encoder and decoder: the same with others after them, cut off, or never made."""

import numpy as np
import pytest

from dvc.dibr.dibr_streams import BUILT_IN_CODECS
from dvc.dibr.view_encoder import ViewEncoder, layer_multipliers
from dvc.dibr.view_set import Views
from dvc.dibr.view_stream import (
    Decoded,
    PairLayer,
    Stream,
    decode,
    decode_header,
    decode_stream,
    encode_layer,
    encode_stream,
)
from dvc.errors import BitstreamError
from dvc.geometry.camera_array import DisparityLabels, LatticePosition
from tests.dibr.scenes import views_of_square

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
