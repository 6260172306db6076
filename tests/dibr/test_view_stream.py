"""Headers and layers: there and back, and what damage does."""

import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.dibr.view_stream import Header, PairLayer, decode_header, decode_stream, encode_header, encode_stream
from dvc.errors import BitstreamError, ConfigError
from dvc.geometry.camera_array import DisparityLabels, LatticePosition
from dvc.geometry.viewpoints import CalibratedViewpoint

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
