"""The decoder of views: pictures and disparities of the readable part of a stream."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.dibr.disparity.disparity_codec import DisparityCodec
from dvc.dibr.disparity.integer_transforms import L_TRANSFORM, S_TRANSFORM
from dvc.dibr.disparity.square_codecs import BlockCodec, QuadtreeCodec
from dvc.dibr.disparity.tree_codec import WaveletCodec
from dvc.dibr.view_rendering import PictureAndDisparity
from dvc.dibr.view_stream import Header, Layer, PairLayer, Stream
from dvc.errors import BitstreamError, ConfigError
from dvc.geometry.viewpoints import Viewpoint
from dvc.images import picture_codec
from dvc.images.picture_codec import DecodedPicture, PictureHeader

METHODS: dict[str, DisparityCodec] = {
    "l": WaveletCodec(L_TRANSFORM),
    "s": WaveletCodec(S_TRANSFORM),
    "quadtree": QuadtreeCodec(),
    "blocks": BlockCodec(),
}
"""Disparity codecs by name."""


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
    states, num_decoded, damage = _decode_layers(header, layers, method)
    if damage is None and (num_layers is None or len(layers) < num_layers):
        damage = stream.damage
    pairs = tuple(
        _pair_of(header, reference, state, resolution)
        for reference, state in zip(header.references, states, strict=True)
    )
    return Decoded(header, pairs, num_decoded, resolution, damage)


def significance_classes(decoded: DecodedPicture) -> list[NDArray[np.uint8]]:
    """Return by level where disparities may differ from their predictions (3.3)."""
    return [significant.astype(np.uint8) for significant in decoded.significance]


class _State(NamedTuple):
    """A picture and its labels after some layers."""

    reference: PictureHeader
    data: bytes
    decoded: DecodedPicture
    labels: Any


def _decode_layers(
    header: Header, layers: Sequence[Layer], codec: DisparityCodec
) -> tuple[list[_State], int, str | None]:
    """Decode up to the first layer that cannot have been written; refuse the very first one."""
    states: list[_State] = []
    for index, layer in enumerate(layers):
        before: list[_State | None] = [*states] or [None] * len(layer)
        try:
            pairs = zip(before, layer, strict=True)
            after = [_next_state(header, codec, state, part) for state, part in pairs]
            if len({state.reference.colour for state in after}) > 1:
                raise BitstreamError("some pictures of the stream are gray and some are not")
        except BitstreamError as error:
            if index == 0:
                raise
            return states, index, f"layer {index + 1} of {header.num_layers}: {error}"
        states = after
    return states, len(layers), None


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


def _pair_of(header: Header, reference: int, state: _State, resolution: int) -> PictureAndDisparity:
    """Return picture and disparities in a resolution."""
    decoded = state.decoded
    if resolution > state.reference.num_levels:
        raise ConfigError(f"resolution {resolution}: 0 to {state.reference.num_levels} are accepted")
    if resolution:
        decoded = picture_codec.decode(state.reference, state.data, header.shape, resolution)
    labels = state.labels.disparity(resolution).astype(np.float64)
    disparity = header.labels.disparity(labels) / 2.0**resolution
    return PictureAndDisparity(decoded.picture(), disparity, header.viewpoints[reference])
