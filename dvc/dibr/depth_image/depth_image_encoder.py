"""The encoder of depth maps, and of pictures with depth maps, for streams of a given length."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvc.bits import encode_varint
from dvc.dibr.depth_image.depth_codes import (
    CodedEdges,
    DepthCandidate,
    DepthOptions,
    best_at,
    best_picture_at,
    code_pictures,
    code_with_edges,
    code_with_selections,
)
from dvc.dibr.depth_image.depth_image_stream import (
    DepthImageStream,
    PlaneCode,
    check_map,
    encode_stream,
    header_bytes,
    part_bytes,
)
from dvc.dibr.depth_image.depth_scale import DepthScale, Plane
from dvc.errors import ConfigError
from dvc.images import picture_codec
from dvc.images.chain_code import EdgeCode
from dvc.images.colour import luma
from dvc.images.edge_maps import EdgeMaps
from dvc.images.picture_header import PictureHeader

Picture = NDArray[np.uint8]

DEPTH_SHARE = 0.2
"""Part of the bytes that a depth map has beside its picture, as in the thesis."""

_SHARES = np.arange(0.02, 0.62, 0.02)
_PEAK = 255.0
_NO_EDGES = CodedEdges(None, EdgeCode.ADAPTIVE, b"")


@dataclass(frozen=True, eq=False)
class DepthImage:
    """What is coded."""

    depth: Plane  # the map, all finite; (H, W)
    scale: DepthScale  # of its numbers
    picture: Picture | None = None  # gray, or red, green and blue; (H, W) or (H, W, 3)


@dataclass(frozen=True)
class PictureOptions:
    """How a picture is coded beside its depth map."""

    order: int = 0  # of the extrapolation at edges
    # part of the bytes that the map has; None: that at which rendered views are best for small
    # steps aside
    depth_share: float | None = DEPTH_SHARE


@dataclass(frozen=True, eq=False)
class EncodedDepthImage:
    """A stream, and where its bytes go."""

    data: bytes  # the file
    stream: DepthImageStream  # what it holds
    edges: EdgeMaps | None  # edges, if there are any
    part_bytes: dict[str, int]  # of `header` (lengths and checksum included), `edges`, `depth` and `image`


def encode_to_size(
    image: DepthImage,
    max_bytes: int,
    edges: CodedEdges | None = _NO_EDGES,
    depth_options: DepthOptions | None = None,
    picture_options: PictureOptions | None = None,
    advance: Callable[[int], None] = lambda _: None,
) -> EncodedDepthImage:
    """Code a depth map, with or without its picture, as well as a number of bytes allows.

    Parameters
    ----------
    image : DepthImage
        What is coded.
    max_bytes : int
        Longest file.
    edges : CodedEdges, optional
        Where transforms stop, by default nowhere; None: where it is worth the bits.
    depth_options : DepthOptions, optional
        How the map is transformed.
    picture_options : PictureOptions, optional
        How the picture is coded.
    advance : callable, optional
        Called, where edges are selected, with how many of `depth_codes.NUM_STEPS` are done.

    Returns
    -------
    EncodedDepthImage
        The stream.

    Raises
    ------
    ConfigError
        If no stream can hold the map, or not even header and edges fit.
    """
    shape = image.depth.shape[0], image.depth.shape[1]
    check_map(shape, image.scale)
    options, beside = depth_options or DepthOptions(), picture_options or PictureOptions()
    room = _room(image, max_bytes, edges)
    candidates = _candidates(image, room, edges, options, beside, advance)
    most = room
    if image.picture is not None:
        share = beside.depth_share or _best_share(image, candidates, room, options)
        most = max(round(share * room), 0 if edges is None else len(edges.data))
    found = best_at(candidates, most)
    assert found is not None, "the code without edges, or with those given, fits"
    picture, picture_edges = None, False
    if image.picture is not None:
        left = room - len(found.edges.data) - len(found.plane.data)
        picture, picture_edges = code_picture(image.picture, found.edges.maps, left, options, beside.order)
    stream = DepthImageStream(
        shape, image.scale, found.edges.data, found.edges.code, found.plane, picture, picture_edges
    )
    return EncodedDepthImage(encode_stream(stream), stream, found.edges.maps, part_bytes(stream))


def _room(image: DepthImage, max_bytes: int, edges: CodedEdges | None) -> int:
    """Bytes for edges and code."""
    overhead = _overhead(image, max_bytes)
    least = 0 if edges is None else len(edges.data)
    if max_bytes - overhead < least:
        raise ConfigError(f"{max_bytes} bytes are too few: header and edges take {overhead + least}")
    return max_bytes - overhead


def _candidates(
    image: DepthImage,
    room: int,
    edges: CodedEdges | None,
    options: DepthOptions,
    beside: PictureOptions,
    advance: Callable[[int], None],
) -> list[DepthCandidate]:
    """The map with the edges that are given, or with several selections."""
    largest = 1.0 if image.picture is None else beside.depth_share or float(_SHARES[-1])
    most = int(largest * room)
    if edges is None:
        return code_with_selections(image.depth, image.scale, most, options, advance)
    return [code_with_edges(image.depth, image.scale, edges, max(most, len(edges.data)), options)]


def _overhead(image: DepthImage, max_bytes: int) -> int:
    """Bytes that are neither edges nor code, at most."""
    shape = image.depth.shape[0], image.depth.shape[1]
    nothing = PlaneCode(PictureHeader(0, 0), 0, b"")
    empty = DepthImageStream(
        shape, image.scale, b"", EdgeCode.ADAPTIVE, nothing, nothing if image.picture is not None else None
    )
    num_parts = 2 if image.picture is None else 3
    return header_bytes(empty) + num_parts * (len(encode_varint(max_bytes)) - 1)


def code_picture(
    picture: Picture,
    edges: EdgeMaps | None,
    num_bytes: int,
    options: DepthOptions,
    order: int,
    is_free: bool = True,
) -> tuple[PlaneCode, bool]:
    """Code a picture with the edges of its map, or without where that is better."""
    without: list[tuple[EdgeMaps | None, bool]] = [(None, False)] if edges is None or is_free else []
    stops = without if edges is None else [*without, (edges, True)]
    return best_picture_at(
        picture, code_pictures(picture, stops, num_bytes, options, order), num_bytes, order
    )


def _best_share(
    image: DepthImage, candidates: Sequence[DepthCandidate], room: int, options: DepthOptions
) -> float:
    """Part of the bytes of a map at which views from one unit of m and n aside have the least error."""
    assert image.picture is not None
    gray = np.asarray(luma(image.picture), np.float64)
    multipliers = [float(np.mean(np.diff(gray, axis=axis) ** 2)) for axis in (0, 1)]
    weight = 0.5 * sum(multipliers) * image.scale.factor**2
    code = picture_codec.encode(gray, room, options.num_levels, options.wavelet, options.adaptive, None, 0)
    costs = []
    for share in _SHARES:
        bits = 8.0 * (1.0 - share) * room / gray.size
        picture_mse = float(np.interp(bits, code.bits_per_pixel, code.mse)) * _PEAK**2
        depth_mse = min(candidate.mse_at(share * room) for candidate in candidates)
        costs.append(picture_mse + weight * depth_mse)
    return float(_SHARES[int(np.argmin(costs))])
