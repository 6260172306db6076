"""Streams of views and their decoder: a header with viewpoints, and quality layers that can be cut off.

Each layer adds to the pictures and disparities of those before, and has a checksum.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.bits import encode_varint
from dvc.config.sections import check_choice
from dvc.dibr import dibr_streams
from dvc.dibr.dibr_streams import (
    BUILT_IN_CODECS,
    CODEC_NUMBERS,
    MAGIC,
    MAX_LAYERS,
    MAX_NUMBER,
    Body,
    FieldReader,
    check_extent,
)
from dvc.dibr.disparity.disparity_codec import DisparityCodec
from dvc.dibr.disparity.integer_transforms import L_TRANSFORM, S_TRANSFORM
from dvc.dibr.disparity.square_codecs import BlockCodec, QuadtreeCodec
from dvc.dibr.disparity.tree_codec import WaveletCodec
from dvc.dibr.view_rendering import PictureAndDisparity
from dvc.errors import BitstreamError, ConfigError
from dvc.geometry.camera_array import DisparityLabels, LatticePosition
from dvc.geometry.viewpoints import CalibratedViewpoint, Viewpoint
from dvc.images import picture_codec
from dvc.images.picture_codec import DecodedPicture, PictureHeader

MAX_LABELS = 2**15 - 1
MAX_VIEWS = 255
_FIXED = struct.Struct("<BHHffHBBB")
_CALIBRATED, _METHOD_SHIFT = 1, 1
METHODS: dict[str, DisparityCodec] = {
    "l": WaveletCodec(L_TRANSFORM),
    "s": WaveletCodec(S_TRANSFORM),
    "quadtree": QuadtreeCodec(),
    "blocks": BlockCodec(),
}
"""Disparity codecs by name."""
_POSITION, _CAMERA = struct.Struct("<2f"), struct.Struct("<11f")


@dataclass(frozen=True, eq=False)
class Header:
    """The header of a stream of views."""

    shape: tuple[int, int]  # height and width of the views
    method: str  # disparity codec, one of `CODEC_NUMBERS`
    # disparities in pixels per unit of m and n; inverse depths for calibrated cameras
    labels: DisparityLabels
    references: tuple[int, ...]  # indices of the views with coded pictures
    num_layers: int  # quality layers of the whole stream
    viewpoints: tuple[Viewpoint, ...]  # viewpoints of all views, of one kind

    def __post_init__(self) -> None:
        dibr_streams.check_shape(self.shape, "views")
        check_choice("disparity", self.method, CODEC_NUMBERS)
        lowest, step, num_labels = self.labels
        if not (abs(lowest) <= MAX_NUMBER and 0.0 < step <= MAX_NUMBER):
            raise ConfigError(f"disparities from {lowest} in steps of {step}: positive steps are accepted")
        for name, value, highest in (
            ("disparities", num_labels, MAX_LABELS),
            ("quality layers", self.num_layers, MAX_LAYERS),
            ("views", len(self.viewpoints), MAX_VIEWS),
            ("references", len(self.references), len(self.viewpoints)),
        ):
            if not 1 <= value <= highest:
                raise ConfigError(f"{value} {name}: 1 to {highest} are accepted")


class PairLayer(NamedTuple):
    """Code that a layer adds to a picture and its disparities; either may be empty."""

    picture: bytes
    disparity: bytes


Layer = tuple[PairLayer, ...]
"""One entry for each reference."""


class Stream(NamedTuple):
    """The readable part of a stream."""

    header: Header
    layers: tuple[Layer, ...]  # whole layers, in order
    damage: str | None = None  # reason why layers are missing


def encode_header(header: Header) -> bytes:
    """Return the bytes of a header."""
    height, width = header.shape
    is_calibrated = isinstance(header.viewpoints[0], CalibratedViewpoint)
    flags = _CALIBRATED * is_calibrated | CODEC_NUMBERS[header.method] << _METHOD_SHIFT
    sizes = header.num_layers, len(header.references), len(header.viewpoints)
    fixed = _FIXED.pack(flags, width, height, *header.labels, *sizes)
    data = MAGIC + bytes([Body.VIEWS]) + fixed + bytes(header.references)
    for viewpoint in header.viewpoints:
        if isinstance(viewpoint, LatticePosition):
            data += _POSITION.pack(*viewpoint)
        else:
            intrinsic, pose = viewpoint.intrinsic, viewpoint.pose
            rotation = np.asarray(cv2.Rodrigues(pose[:, :3])[0])
            data += _CAMERA.pack(*intrinsic[0], *intrinsic[1, 1:], *rotation[:, 0], *pose[:, 3])
    return data + dibr_streams.checksum(data)


def decode_header(data: bytes) -> tuple[Header, int]:
    """Read a header and return it with its size; inverse of `encode_header` up to single precision."""
    reader = FieldReader.of_body(data, Body.VIEWS)
    flags, width, height, lowest, step, num_labels, *sizes = reader.fields(_FIXED)
    num_layers, num_references, num_views = sizes
    number = flags >> _METHOD_SHIFT
    references = tuple(reader.bytes(num_references))
    layout = _CAMERA if flags & _CALIBRATED else _POSITION
    cameras = [reader.fields(layout) for _ in range(num_views)]
    reader.check("the header of the stream is damaged")
    if number >= len(BUILT_IN_CODECS):
        raise BitstreamError(f"disparity codec {number} is unknown")
    try:
        labels = DisparityLabels(lowest, step, num_labels)
        viewpoints = tuple(map(_decode_viewpoint, cameras))
        header = Header((height, width), BUILT_IN_CODECS[number], labels, references, num_layers, viewpoints)
    except (ConfigError, ValueError) as error:
        raise BitstreamError(f"the header of the stream cannot have been written: {error}") from None
    if max(references) >= num_views:
        raise BitstreamError("the header of the stream names a reference that is not among its views")
    return header, reader.position


def _decode_viewpoint(numbers: tuple[float, ...]) -> Viewpoint:
    if not all(abs(number) <= MAX_NUMBER for number in numbers):
        raise BitstreamError("the header of the stream has a camera without a finite position")
    if len(numbers) == len(LatticePosition._fields):
        return LatticePosition(*numbers)
    intrinsic = np.array([numbers[:3], (0.0, *numbers[3:5]), (0.0, 0.0, 1.0)])
    if abs(np.linalg.det(intrinsic)) < 1e-12:
        raise BitstreamError("the header of the stream has a camera that is singular")
    rotation = cv2.Rodrigues(np.array(numbers[5:8]))[0]
    return CalibratedViewpoint(intrinsic, np.column_stack([rotation, numbers[8:11]]))


def encode_stream(header: Header, layers: Sequence[Layer]) -> bytes:
    """Return the bytes of a stream."""
    return encode_header(header) + b"".join(encode_layer(layer) for layer in layers)


def encode_layer(layer: Layer) -> bytes:
    """Return the bytes of a layer."""
    data = b"".join(encode_varint(len(part)) + part for pair in layer for part in pair)
    return data + dibr_streams.checksum(data)


def decode_stream(data: bytes, max_mib: float | None = None) -> Stream:
    """Read a stream, up to the first layer that is cut or damaged."""
    header, position = decode_header(data)
    layers: list[Layer] = []
    damage = None
    while len(layers) < header.num_layers:
        reader = FieldReader(data, position, "it")
        try:
            parts = [reader.bytes(reader.varint()) for _ in range(2 * len(header.references))]
            reader.check(f"it is damaged, between bytes {position} and {reader.position}")
        except BitstreamError as error:
            damage = f"layer {len(layers) + 1} of {header.num_layers}: {error}"
            break
        layers.append(tuple(map(PairLayer, parts[::2], parts[1::2])))
        position = reader.position
    if not layers:
        raise BitstreamError(str(damage))
    if damage is None and position != len(data):
        damage = f"{len(data) - position} bytes follow the last layer"
    num_pixels = header.shape[0] * header.shape[1]
    held = num_pixels * len(header.references)
    check_extent(num_pixels, held, held * len(layers), len(data), max_mib)
    return Stream(header, tuple(layers), damage)


@dataclass(frozen=True, eq=False)
class Decoded:
    """A decoded stream."""

    header: Header
    pairs: tuple[PictureAndDisparity, ...]  # one for each reference
    num_layers: int  # number of decoded quality layers
    resolution: int  # number of times that the sides of pictures are halved
    damage: str | None  # reason why layers are missing

    @property
    def viewpoints(self) -> tuple[Viewpoint, ...]:
        """Viewpoints of all views of the stream."""
        return self.header.viewpoints

    @property
    def step(self) -> float:
        """Distance of neighbouring disparities."""
        return self.header.labels.step / 2.0**self.resolution


def decode(
    stream: Stream, num_layers: int | None = None, resolution: int = 0, codec: DisparityCodec | None = None
) -> Decoded:
    """Decode a stream.

    Parameters
    ----------
    stream : Stream
        The stream, as it was read.
    num_layers : int, optional
        Largest number of quality layers to decode; by default all.
    resolution : int, optional
        Number of times that the sides of pictures and disparity maps are halved.
    codec : DisparityCodec, optional
        Disparity codec, if the encoder was given another one than the header names.

    Returns
    -------
    Decoded
        Pictures and disparities.

    Raises
    ------
    BitstreamError
        If the first layer cannot have been written; damage to later layers is reported in the result.
    ConfigError
        If the stream has fewer layers or resolutions.
    """
    header = stream.header
    if num_layers is not None and not 1 <= num_layers <= header.num_layers:
        raise ConfigError(f"{num_layers} quality layers: the stream has {header.num_layers}")
    layers = stream.layers[:num_layers]
    method = METHODS[header.method] if codec is None else codec
    states: list[_State] = []
    num_decoded, damage = len(layers), None
    if num_layers is None or len(layers) < num_layers:
        damage = stream.damage
    for index, layer in enumerate(layers):
        before: list[_State | None] = [*states] or [None] * len(layer)
        try:
            steps = zip(before, layer, strict=True)
            after = [_next_state(header, method, state, part) for state, part in steps]
            if len({state.reference.colour for state in after}) > 1:
                raise BitstreamError("some pictures of the stream are gray and some are not")
        except BitstreamError as error:
            if index == 0:
                raise
            num_decoded, damage = index, f"layer {index + 1} of {header.num_layers}: {error}"
            break
        states = after
    pairs = []
    for view, (reference, data, whole, labels) in zip(header.references, states, strict=True):
        if resolution > reference.num_levels:
            raise ConfigError(f"resolution {resolution}: 0 to {reference.num_levels} are accepted")
        decoded = picture_codec.decode(reference, data, header.shape, resolution) if resolution else whole
        halved = labels.disparity(resolution).astype(np.float64)
        disparity = header.labels.disparity(halved) / 2.0**resolution
        pairs.append(PictureAndDisparity(decoded.picture(), disparity, header.viewpoints[view]))
    return Decoded(header, tuple(pairs), num_decoded, resolution, damage)


def significance_classes(decoded: DecodedPicture) -> list[NDArray[np.uint8]]:
    """Return by level where disparities may differ from their predictions (3.3)."""
    return [significant.astype(np.uint8) for significant in decoded.significance]


class _State(NamedTuple):
    """A picture and its labels after some layers."""

    reference: PictureHeader
    data: bytes
    decoded: DecodedPicture
    labels: Any


def _next_state(header: Header, codec: DisparityCodec, before: _State | None, part: PairLayer) -> _State:
    """Decode a layer of one picture and its disparities."""
    reference = PictureHeader.from_bytes(part.picture)
    if before is not None and replace(reference, points=before.reference.points) != before.reference:
        raise BitstreamError("its picture is coded in another way than that of the layer before")
    added = part.picture[PictureHeader.SIZE :]
    if before is not None and not added and reference == before.reference:
        data, decoded = before.data, before.decoded
    else:
        data = (b"" if before is None else before.data) + added
        decoded = picture_codec.decode(reference, data, header.shape)
    classes = significance_classes(decoded)
    previous = before.labels if before is not None and codec.layered else None
    labels = codec.decode(part.disparity, header.shape, header.labels.num_labels, classes, previous)
    return _State(reference, data, decoded, labels)
