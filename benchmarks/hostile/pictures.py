"""Streams of pictures with depth: good ones, their mutations, and their decoder, which must bear them."""

import zlib
from functools import cache

import numpy as np

from benchmarks.hostile.mutations import mutate, nearest
from dvc.dibr.dibr_streams import BUILT_IN_CODECS
from dvc.dibr.view_encoder import ViewEncoder
from dvc.dibr.view_rendering import picture_of, render
from dvc.dibr.view_set import Views
from dvc.dibr.view_stream import (
    PairLayer,
    decode,
    decode_header,
    decode_stream,
    encode_layer,
)
from dvc.errors import BitstreamError
from dvc.geometry.camera_array import DisparityLabels, LatticePosition
from dvc.geometry.viewpoints import CalibratedViewpoint, Viewpoint, between

NUM_LAYERS = 2
_HEIGHT, _WIDTH = 21, 34
_CRC_BYTES = 4


@cache
def good_streams() -> tuple[bytes, ...]:
    """Encode small views in all ways."""
    streams = []
    for number, method in enumerate(BUILT_IN_CODECS):
        for calibrated in (False, True):
            coloured = (number + calibrated) % 2 == 1
            views = _views(coloured, calibrated, references=(0, 2) if number % 3 == 0 else (0,))
            labels = DisparityLabels(0.05, 0.025, 7) if calibrated else DisparityLabels(0.0, 1.0, 7)
            streams.append(ViewEncoder(views, labels, method, NUM_LAYERS).encode(2e-3).data)
    return tuple(streams)


def _views(coloured: bool, calibrated: bool, references: tuple[int, ...]) -> Views:
    rng = np.random.default_rng(3)
    channels = 3 if coloured else 1
    near, far = (rng.integers(0, 256, (_HEIGHT, _WIDTH + 12, channels), np.uint8) for _ in range(2))
    pictures = []
    for m in range(3):
        picture = far[:, m : m + _WIDTH].copy()
        left = 16 - 5 * m
        picture[6:15, max(left, 0) : left + 12] = near[6:15, max(-left, 0) : 12]
        pictures.append(picture if coloured else picture[:, :, 0])
    return Views(tuple(pictures), tuple(_viewpoint(m, calibrated) for m in range(3)), references)


def _viewpoint(m: int, calibrated: bool) -> Viewpoint:
    if not calibrated:
        return LatticePosition(float(m), 0.0)
    intrinsic = np.array([[30.0, 0.0, 16.5], [0.0, 30.0, 10.0], [0.0, 0.0, 1.0]])
    return CalibratedViewpoint(intrinsic, np.column_stack([np.eye(3), [-float(m), 0.0, 0.0]]))


def mutate_pictures(stream: bytes, rng: np.random.Generator) -> bytes:
    """Damage the header, or one part of one layer, and mend its checksum, so that the damage is parsed."""
    found = decode_stream(stream)
    _, start = decode_header(stream)
    if rng.integers(4) == 0:
        header = mutate(stream[: start - _CRC_BYTES], rng)
        return header + zlib.crc32(header).to_bytes(_CRC_BYTES, "little") + stream[start:]
    layers = [list(layer) for layer in found.layers]
    layer, pair, part = (int(rng.integers(size)) for size in (len(layers), len(layers[0]), 2))
    parts = list(layers[layer][pair])
    parts[part] = mutate(parts[part], rng)
    layers[layer][pair] = PairLayer(*parts)
    return stream[:start] + b"".join(encode_layer(tuple(layer)) for layer in layers)


def damaged_pictures(number: int) -> bytes:
    """Return a mutation of a stream."""
    streams, rng = good_streams(), np.random.default_rng(number)
    stream = streams[number % len(streams)]
    return mutate(stream, rng) if rng.integers(4) == 0 else mutate_pictures(stream, rng)


def try_pictures(damaged: bytes) -> str:
    """Decode a mutation of a stream, and render a view of what comes out."""
    stream = nearest(good_streams(), damaged)
    intact = _num_intact(stream, damaged)
    try:
        decoded = decode(decode_stream(damaged))
        viewpoints = decoded.header.viewpoints
        view = picture_of(render(decoded, between(viewpoints[0], viewpoints[-1], 0.4)))
    except BitstreamError:
        return "refused" if intact == 0 else f"refused, but {intact} layers are whole"
    if view.shape[:2] != decoded.header.shape:
        return f"a view of {view.shape}, not {decoded.header.shape}"
    lost = decoded.num_layers < intact
    return f"a whole layer is lost: {decoded.num_layers} of {intact}" if lost else "decoded"


def _num_intact(stream: bytes, damaged: bytes) -> int:
    """Return how many layers precede the damage."""
    _, end = decode_header(stream)
    intact = 0
    for layer in decode_stream(stream).layers:
        end += len(encode_layer(layer))
        intact += damaged[:end] == stream[:end]
    return intact
