"""The decoder: pictures and disparities of a stream, as far as it goes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.dibr.disparity.disparity_codec import DisparityCodec
from dvc.dibr.disparity.methods import METHODS
from dvc.dibr.view_rendering import PictureAndDisparity
from dvc.dibr.view_stream import Header, Layer, PairLayer, Stream
from dvc.errors import BitstreamError, ConfigError
from dvc.geometry.viewpoints import Viewpoint
from dvc.images import picture_codec
from dvc.images.picture_codec import DecodedPicture
from dvc.images.picture_header import PictureHeader

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Decoded:
    """A decoded stream."""

    header: Header  # what the stream says of itself
    pairs: tuple[PictureAndDisparity, ...]  # one for each reference
    num_layers: int  # quality layers that were decoded
    resolution: int  # how many times pictures are halved
    damage: str | None  # why there are fewer layers than there should be

    @property
    def viewpoints(self) -> tuple[Viewpoint, ...]:
        """Of all views of the stream."""
        return self.header.viewpoints

    @property
    def step(self) -> float:
        """Distance of the disparities that are distinguished."""
        return self.header.labels.step / 2.0**self.resolution


def decode(
    stream: Stream, num_layers: int | None = None, resolution: int = 0, codec: DisparityCodec | None = None
) -> Decoded:
    """Decode a stream.

    Parameters
    ----------
    stream : Stream
        As it was read.
    num_layers : int, optional
        Quality layers, at most; by default all there are.
    resolution : int, optional
        How many times pictures and disparities are halved.
    codec : DisparityCodec, optional
        Of the disparities, where an encoder was given another one than the header names.

    Returns
    -------
    Decoded
        Pictures and disparities.

    Raises
    ------
    BitstreamError
        If not even the first layer can have been written; damage to later ones is reported.
    ConfigError
        If there are not so many layers or levels.
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
        _finished(header, reference, state, resolution)
        for reference, state in zip(header.references, states, strict=True)
    )
    return Decoded(header, pairs, num_decoded, resolution, damage)


def significance_classes(decoded: DecodedPicture) -> list[NDArray[np.uint8]]:
    """Return where disparities may differ from what is predicted (3.3)."""
    return [significant.astype(np.uint8) for significant in decoded.significance]


class _State(NamedTuple):
    """A picture and its labels after some layers."""

    reference: PictureHeader
    data: bytes
    decoded: DecodedPicture
    found: Any


def _decode_layers(
    header: Header, layers: Sequence[Layer], codec: DisparityCodec
) -> tuple[list[_State], int, str | None]:
    """Decode layer by layer; what cannot have been written ends it, unless that is the first one."""
    states: list[_State] = []
    for index, layer in enumerate(layers):
        before: list[_State | None] = [*states] or [None] * len(layer)
        try:
            pairs = zip(before, layer, strict=True)
            found = [_next_state(header, codec, state, part) for state, part in pairs]
            if len({state.reference.colour for state in found}) > 1:
                raise BitstreamError("some pictures of the stream are gray and some are not")
        except BitstreamError as error:
            if index == 0:
                raise
            return states, index, f"layer {index + 1} of {header.num_layers}: {error}"
        states = found
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
    previous = before.found if before is not None and codec.layered else None
    found = codec.decode(part.disparity, header.shape, header.labels.num_labels, classes, previous)
    return _State(reference, data, decoded, found)


def _finished(header: Header, reference: int, state: _State, resolution: int) -> PictureAndDisparity:
    """Return picture and disparities in the resolution that is wanted."""
    decoded = state.decoded
    if resolution > state.reference.num_levels:
        raise ConfigError(f"resolution {resolution}: 0 to {state.reference.num_levels} are accepted")
    if resolution:
        decoded = picture_codec.decode(state.reference, state.data, header.shape, resolution)
    labels = state.found.disparity(resolution).astype(np.float64)
    disparity = header.labels.disparity(labels) / 2.0**resolution
    return PictureAndDisparity(decoded.picture(), disparity, header.viewpoints[reference])
