"""The decoder: pictures and disparities of a stream, as far as it goes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvc.dibr.disparity.methods import METHODS, Representation
from dvc.dibr.reference import codec as reference_codec
from dvc.dibr.reference.codec import DecodedReference, ReferenceHeader
from dvc.dibr.stream.header import Header
from dvc.dibr.stream.layers import PairLayer, Stream
from dvc.errors import BitstreamError, ConfigError
from dvc.multiview.viewpoints import Viewpoint

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PictureAndDisparity:
    """A decoded reference.

    Attributes
    ----------
    picture : ndarray of shape (H, W) or (H, W, 3), uint8
        Gray, or red, green and blue.
    disparity : ndarray of shape (H, W), float64
        In pixels of the picture per unit of m and n; of calibrated cameras, inverse depth.
    viewpoint : Viewpoint
        Of its camera.
    """

    picture: NDArray[np.uint8]
    disparity: Floats
    viewpoint: Viewpoint


@dataclass(frozen=True, eq=False)
class Decoded:
    """A decoded stream.

    Attributes
    ----------
    header : Header
        What the stream says of itself.
    pairs : tuple of PictureAndDisparity
        One for each reference.
    num_layers : int
        Quality layers that were decoded.
    resolution : int
        How many times pictures are halved.
    damage : str or None
        Why there are fewer layers than there should be.
    """

    header: Header
    pairs: tuple[PictureAndDisparity, ...]
    num_layers: int
    resolution: int
    damage: str | None


def decode(stream: Stream, num_layers: int | None = None, resolution: int = 0) -> Decoded:
    """Decode a stream.

    Parameters
    ----------
    stream : Stream
        As it was read.
    num_layers : int, optional
        Quality layers, at most; by default all there are.
    resolution : int, optional
        How many times pictures and disparities are halved.

    Returns
    -------
    Decoded
        Pictures and disparities.

    Raises
    ------
    BitstreamError
        If the layers cannot have been written.
    ConfigError
        If there are not so many layers or levels.
    """
    header = stream.header
    if num_layers is not None and not 1 <= num_layers <= header.num_layers:
        raise ConfigError(f"{num_layers} quality layers: the stream has {header.num_layers}")
    layers = stream.layers[:num_layers]
    wanted = header.num_layers if num_layers is None else num_layers
    pairs = []
    for index, reference in enumerate(header.references):
        picture, found = _decode_pair(header, [layer[index] for layer in layers], resolution)
        labels = found.disparity(resolution).astype(np.float64)
        disparity = header.labels.disparity(labels) / 2.0**resolution
        pairs.append(PictureAndDisparity(picture, disparity, header.viewpoints[reference]))
    if len({pair.picture.ndim for pair in pairs}) > 1:
        raise BitstreamError("some pictures of the stream are gray and some are not")
    damage = stream.damage if len(layers) < wanted or num_layers is None else None
    return Decoded(header, tuple(pairs), len(layers), resolution, damage)


def significance_classes(decoded: DecodedReference) -> list[NDArray[np.uint8]]:
    """Return where disparities may differ from what is predicted (3.3).

    Parameters
    ----------
    decoded : DecodedReference
        The picture.

    Returns
    -------
    list of ndarray of shape (ceil(H / 2^j), ceil(W / 2^j)), uint8
        1 where any coefficient of the picture is significant, from j = 1 on.
    """
    return [significant.astype(np.uint8) for significant in decoded.significance]


def _decode_pair(
    header: Header, parts: Sequence[PairLayer], resolution: int
) -> tuple[NDArray[np.uint8], Representation]:
    """Decode a picture and its disparities from all their layers."""
    codec = METHODS[header.method.name.lower()]
    data, found = b"", None
    for part in parts:
        reference = ReferenceHeader.from_bytes(part.picture)
        data += part.picture[ReferenceHeader.SIZE :]
        decoded = reference_codec.decode(reference, data, header.shape)
        classes = significance_classes(decoded)
        previous = found if codec.layered else None
        found = codec.decode(part.disparity, header.shape, header.labels.num_labels, classes, previous)
    if resolution > reference.num_levels:
        raise ConfigError(f"resolution {resolution}: 0 to {reference.num_levels} are accepted")
    if resolution:
        decoded = reference_codec.decode(reference, data, header.shape, resolution)
    assert found is not None
    return decoded.picture(), found
