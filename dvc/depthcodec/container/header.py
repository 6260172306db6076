"""The header of a stream: what its pictures are, and where their cameras stand."""

import struct
import zlib
from dataclasses import dataclass
from enum import IntEnum

import cv2
import numpy as np

from dvc.errors import BitstreamError, ConfigError
from dvc.multiview.camera_array import DisparityLabels, LatticePosition
from dvc.multiview.viewpoints import CalibratedViewpoint, Viewpoint

MAGIC = b"DIBR"
FORMAT_VERSION = 1
MAX_SIDE = 2**16 - 1
MAX_PIXELS = 2**24
MAX_LABELS = 2**15 - 1
MAX_VIEWS = 255
MAX_LAYERS = 32
MAX_NUMBER = 1e12
"""Of what describes cameras and disparities; anything beyond is no measurement."""
_FIXED = struct.Struct("<4sBBHHffHBBB")
_CRC_BYTES = 4
_CALIBRATED, _METHOD_SHIFT = 1, 1
_POSITION = struct.Struct("<2f")
_CAMERA = struct.Struct("<11f")


class DisparityMethod(IntEnum):
    """How disparities are coded."""

    L = 0
    S = 1
    QUADTREE = 2
    BLOCKS = 3


@dataclass(frozen=True, eq=False)
class Header:
    """What a decoder must know before the first layer."""

    shape: tuple[int, int]  # height and width of the views
    method: DisparityMethod  # how disparities are coded
    # disparities in pixels per unit of m and n; of calibrated cameras, inverse depths
    labels: DisparityLabels
    references: tuple[int, ...]  # numbers of the views whose pictures are coded
    num_layers: int  # quality layers of the whole stream
    viewpoints: tuple[Viewpoint, ...]  # of all views, of one kind

    def __post_init__(self) -> None:
        height, width = self.shape
        if not (0 < height <= MAX_SIDE and 0 < width <= MAX_SIDE and height * width <= MAX_PIXELS):
            raise ConfigError(f"views of {width}x{height}: up to {MAX_PIXELS} pixels are accepted")
        lowest, step, num_labels = self.labels
        if not 1 <= num_labels <= MAX_LABELS:
            raise ConfigError(f"{num_labels} disparities: 1 to {MAX_LABELS} are accepted")
        if not (abs(lowest) <= MAX_NUMBER and 0.0 < step <= MAX_NUMBER):
            raise ConfigError(f"disparities from {lowest} in steps of {step}: positive steps are accepted")
        for name, value, highest in (
            ("quality layers", self.num_layers, MAX_LAYERS),
            ("views", len(self.viewpoints), MAX_VIEWS),
            ("references", len(self.references), len(self.viewpoints)),
        ):
            if not 1 <= value <= highest:
                raise ConfigError(f"{value} {name}: 1 to {highest} are accepted")


def encode_header(header: Header) -> bytes:
    """Return the bytes of a header."""
    height, width = header.shape
    is_calibrated = isinstance(header.viewpoints[0], CalibratedViewpoint)
    flags = _CALIBRATED * is_calibrated | header.method << _METHOD_SHIFT
    sizes = header.num_layers, len(header.references), len(header.viewpoints)
    fixed = _FIXED.pack(MAGIC, FORMAT_VERSION, flags, width, height, *header.labels, *sizes)
    views = b"".join(_encode_viewpoint(viewpoint) for viewpoint in header.viewpoints)
    data = fixed + bytes(header.references) + views
    return data + zlib.crc32(data).to_bytes(_CRC_BYTES, "little")


def decode_header(data: bytes) -> tuple[Header, int]:
    """Read a header; inverse of `encode_header` but for the precision of its numbers."""
    if not data.startswith(MAGIC[: max(len(data), 1)]):
        raise BitstreamError("not a stream of texture and depth: it does not begin with DIBR")
    if len(data) < _FIXED.size:
        raise BitstreamError(f"the stream ends within its header, after {len(data)} bytes")
    _, version, flags, width, height, lowest, step, num_labels, *sizes = _FIXED.unpack_from(data)
    if version != FORMAT_VERSION:
        raise BitstreamError(f"the stream is of version {version}; {FORMAT_VERSION} is accepted")
    num_layers, num_references, num_views = sizes
    layout = _CAMERA if flags & _CALIBRATED else _POSITION
    views = _FIXED.size + num_references
    end = views + num_views * layout.size
    if len(data) < end + _CRC_BYTES:
        raise BitstreamError(f"the stream ends within its header, after {len(data)} bytes")
    if zlib.crc32(data[:end]).to_bytes(_CRC_BYTES, "little") != data[end : end + _CRC_BYTES]:
        raise BitstreamError("the header of the stream is damaged")
    viewpoints = tuple(_decode_viewpoint(numbers) for numbers in layout.iter_unpack(data[views:end]))
    references = tuple(data[_FIXED.size : views])
    try:
        method = DisparityMethod(flags >> _METHOD_SHIFT)
        labels = DisparityLabels(lowest, step, num_labels)
        header = Header((height, width), method, labels, references, num_layers, viewpoints)
    except (ConfigError, ValueError) as error:
        raise BitstreamError(f"the header of the stream cannot have been written: {error}") from None
    if max(references) >= num_views:
        raise BitstreamError("the header of the stream names a reference that is not among its views")
    return header, end + _CRC_BYTES


def _encode_viewpoint(viewpoint: Viewpoint) -> bytes:
    if isinstance(viewpoint, LatticePosition):
        return _POSITION.pack(*viewpoint)
    intrinsic, pose = viewpoint.intrinsic, viewpoint.pose
    turn = np.asarray(cv2.Rodrigues(pose[:, :3])[0])
    return _CAMERA.pack(*intrinsic[0], *intrinsic[1, 1:], *turn[:, 0], *pose[:, 3])


def _decode_viewpoint(numbers: tuple[float, ...]) -> Viewpoint:
    if not all(abs(number) <= MAX_NUMBER for number in numbers):
        raise BitstreamError("the header of the stream has a camera that is nowhere")
    if len(numbers) == len(LatticePosition._fields):
        return LatticePosition(*numbers)
    intrinsic = np.array([numbers[:3], (0.0, *numbers[3:5]), (0.0, 0.0, 1.0)])
    if abs(np.linalg.det(intrinsic)) < 1e-12:
        raise BitstreamError("the header of the stream has a camera that is singular")
    rotation = cv2.Rodrigues(np.array(numbers[5:8]))[0]
    return CalibratedViewpoint(intrinsic, np.column_stack([rotation, numbers[8:11]]))
