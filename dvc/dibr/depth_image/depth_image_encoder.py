"""The encoder of depth maps, and of pictures with depth maps, for streams of a given length.

A map is coded with several selections of edges; the best one is chosen at a length, or at a Lagrange
multiplier.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvc.bits import encode_varint
from dvc.dibr.depth_image.depth_image_stream import (
    DepthImageStream,
    DepthScale,
    Plane,
    PlaneCode,
    check_map,
    decode_plane,
    encode_stream,
)
from dvc.errors import ConfigError
from dvc.images import chain_code, edge_selection, picture_codec
from dvc.images.chain_code import EdgeCode, trace
from dvc.images.colour import luma
from dvc.images.edge_maps import EdgeMaps, Mask, edges_inside
from dvc.images.lifting import WAVELETS
from dvc.images.picture_codec import PictureCode, PictureHeader

Picture = NDArray[np.uint8]

DEPTH_SHARE = 0.2
"""Share of the bytes of a depth map and its edges in those of a picture with depth, as in the thesis."""
REFINEMENTS = 2.0**-0.25, 2.0**0.25
"""Steps around the best step of a ladder, relative to it."""
NUM_STEPS = 2 * edge_selection.MOST_RUNGS + 1 + len(REFINEMENTS)
"""Steps that `code_with_selections` reports."""
_SHARES = np.arange(0.02, 0.62, 0.02)
_PEAK = 255.0


@dataclass(frozen=True, eq=False)
class DepthImage:
    """A depth map to be coded, with or without its picture."""

    depth: Plane  # the map, all finite; (H, W)
    scale: DepthScale  # meaning of its numbers
    picture: Picture | None = None  # gray, or red, green and blue; (H, W) or (H, W, 3)


@dataclass(frozen=True)
class DepthOptions:
    """Transform of a depth map and of its picture, if any."""

    wavelet: str = "9/7"  # ``9/7`` or ``5/3``
    num_levels: int = 5  # number of times that they are split; less for small pieces
    order: int = 1  # order of the extrapolation of the map at edges
    picture_order: int = 0  # order of the extrapolation of the picture at edges
    # share of the bytes for edges and map, more if masks need it; None: that at which rendered views of a
    # picture are best for small displacements
    depth_share: float | None = DEPTH_SHARE


@dataclass(frozen=True, eq=False)
class CodedEdges:
    """Edges and their code."""

    maps: EdgeMaps | None  # None: no edges
    code: EdgeCode
    data: bytes
    mask: Mask | None = None  # mask that the code includes; None: everywhere


NO_EDGES = CodedEdges(None, EdgeCode.ADAPTIVE, b"")


@dataclass(frozen=True, eq=False)
class DepthCode:
    """A depth map coded with some edges."""

    edges: CodedEdges
    plane: PlaneCode
    mse: float  # mean squared error of the decoded map, in its own units


@dataclass(frozen=True, eq=False)
class DepthCandidate:
    """A depth map coded with some edges, to be cut."""

    edges: CodedEdges
    code: PictureCode  # code of the levels of the map
    depth: Plane
    scale: DepthScale
    order: int  # order of the extrapolation at edges

    def cut(self, num_bytes: int) -> DepthCode | None:
        """Return the code within a length."""
        room = num_bytes - len(self.edges.data)
        if room < 0:
            return None
        header, data = self.code.cut(room)
        plane = PlaneCode(header, self.order, data)
        height, width = self.depth.shape
        mask = self.edges.mask
        levels = decode_plane(plane, self.edges.maps, (height, width), 0, mask).planes[0]
        error = (self.scale.depth(levels) - self.depth) ** 2
        return DepthCode(self.edges, plane, float(np.mean(error if mask is None else error * mask)))

    def mse_at(self, num_bytes: float) -> float:
        """Return an estimate of the squared error at a length."""
        room = 8.0 * (num_bytes - len(self.edges.data)) / self.depth.size
        if room < 0:
            return np.inf
        levels = float(np.interp(room, self.code.bits_per_pixel, self.code.mse)) * _PEAK**2
        return levels * self.scale.unit**2


Stops = Sequence[tuple[EdgeMaps | None, bool]]
"""Edges to code a picture with, in several ways, and whether they are those of its map."""


@dataclass(frozen=True, eq=False)
class EncodedDepthImage:
    """A stream and the sizes of its parts."""

    data: bytes  # the file
    stream: DepthImageStream
    edges: EdgeMaps | None
    part_bytes: dict[str, int]  # bytes of `header` (with lengths and checksum), `edges`, `depth` and `image`


def encode_to_size(
    image: DepthImage,
    max_bytes: int,
    edges: CodedEdges | None = NO_EDGES,
    depth_options: DepthOptions | None = None,
    advance: Callable[[int], None] = lambda _: None,
) -> EncodedDepthImage:
    """Code a depth map, with or without its picture, to a file of at most some length.

    Parameters
    ----------
    image : DepthImage
        The map, and the picture.
    max_bytes : int
        Largest length.
    edges : CodedEdges, optional
        Edges at which transforms stop, by default none; None: those that are worth their bits.
    depth_options : DepthOptions, optional
        Transform of the map and the picture.
    advance : callable, optional
        Called with the number of steps done, out of `NUM_STEPS`, if edges are selected.

    Returns
    -------
    EncodedDepthImage
        The stream.

    Raises
    ------
    ConfigError
        If no stream can hold the map, or header and edges do not fit.
    """
    shape = image.depth.shape[0], image.depth.shape[1]
    check_map(shape, image.scale)
    options = depth_options or DepthOptions()
    nothing, num_parts = PlaneCode(PictureHeader(0, 0), 0, b""), 2 if image.picture is None else 3
    picture = None if image.picture is None else nothing
    empty = DepthImageStream(shape, image.scale, b"", EdgeCode.ADAPTIVE, nothing, picture)
    overhead = len(encode_stream(empty)) + num_parts * (len(encode_varint(max_bytes)) - 1)
    room, edge_bytes = max_bytes - overhead, 0 if edges is None else len(edges.data)
    if room < edge_bytes:
        raise ConfigError(f"{max_bytes} bytes are too few: header and edges take {overhead + edge_bytes}")
    largest = 1.0 if image.picture is None else options.depth_share or float(_SHARES[-1])
    most = int(largest * room)
    if edges is None:
        candidates = code_with_selections(image.depth, image.scale, most, options, advance)
    else:
        candidates = [code_with_edges(image.depth, image.scale, edges, max(most, edge_bytes), options)]
    most = room
    if image.picture is not None:
        share = options.depth_share or _best_share(image, candidates, room, options)
        most = max(round(share * room), edge_bytes)
    best = best_at(candidates, most)
    assert best is not None, "the code without edges, or with those given, fits"
    picture_edges = False
    if image.picture is not None:
        remaining = room - len(best.edges.data) - len(best.plane.data)
        maps = best.edges.maps
        picture, picture_edges = code_picture(image.picture, maps, remaining, options, options.picture_order)
    stream = DepthImageStream(
        shape, image.scale, best.edges.data, best.edges.code, best.plane, picture, picture_edges
    )
    return EncodedDepthImage(encode_stream(stream), stream, best.edges.maps, stream.part_bytes)


def code_edges(edges: EdgeMaps, code: EdgeCode | None = None, mask: Mask | None = None) -> CodedEdges:
    """Code edges."""
    if mask is None and not edges.count():
        return NO_EDGES
    chains = trace(edges)
    usual = [one for one in (EdgeCode.ADAPTIVE, EdgeCode.FIXED) if chain_code.fits(chains, one)]
    codes = usual if code is None else [code]
    coded = [CodedEdges(edges, one, chain_code.encode(chains, one, mask), mask) for one in codes]
    return min(coded, key=lambda one: len(one.data))


def code_with_edges(
    depth: Plane, scale: DepthScale, edges: CodedEdges, max_bytes: int, options: DepthOptions
) -> DepthCandidate:
    """Code a depth map with given edges."""
    room, levels = max(max_bytes - len(edges.data), 0), scale.levels(depth)
    transform = options.num_levels, options.wavelet, True, edges.maps, options.order
    code = picture_codec.encode(levels, room, *transform, mask=edges.mask)
    return DepthCandidate(edges, code, depth, scale, options.order)


def code_with_selections(
    depth: Plane,
    scale: DepthScale,
    max_bytes: int,
    options: DepthOptions,
    advance: Callable[[int], None] = lambda _: None,
    mask: Mask | None = None,
) -> list[DepthCandidate]:
    """Code a depth map with the edges that are worth their bits at several rates, and with none."""
    wavelet, done = WAVELETS[options.wavelet], 0

    def _count(number: int) -> None:
        nonlocal done
        done += number
        advance(number)

    def _code(edges: EdgeMaps) -> DepthCandidate:
        coded = code_edges(edges if mask is None else edges_inside(edges, mask), None, mask)
        _count(1)
        return code_with_edges(depth, scale, coded, max_bytes, options)

    rungs = list(edge_selection.ladder(depth, 8.0 * max_bytes, options.order, wavelet, mask, _count))
    _count(2 * edge_selection.MOST_RUNGS - done - len(rungs))
    candidates = [_code(EdgeMaps.none((depth.shape[0], depth.shape[1])))]
    candidates += [_code(edges) for _, edges in rungs]
    best = int(np.argmin([candidate.mse_at(max_bytes) for candidate in candidates]))
    if best:
        step, edges = rungs[best - 1][0], rungs[max(best - 2, 0)][1]
        for factor in REFINEMENTS:
            finer = edge_selection.select(depth, edges, step * factor, options.order, wavelet)
            candidates.append(_code(finer))
    _count(NUM_STEPS - done)
    return [candidate for candidate in candidates if len(candidate.edges.data) <= max_bytes]


def best_at(candidates: Sequence[DepthCandidate], num_bytes: int) -> DepthCode | None:
    """Return the code of the least squared error."""
    codes = [code for candidate in candidates if (code := candidate.cut(num_bytes)) is not None]
    return min(codes, key=lambda code: code.mse, default=None)


def code_picture(
    picture: Picture,
    edges: EdgeMaps | None,
    num_bytes: int,
    options: DepthOptions,
    order: int,
    is_free: bool = True,
) -> tuple[PlaneCode, bool]:
    """Code a picture with the edges of its map, or without if that is better."""
    stops: list[tuple[EdgeMaps | None, bool]] = [(None, False)] if edges is None or is_free else []
    if edges is not None:
        stops.append((edges, True))
    transform = options.num_levels, options.wavelet, True
    codes = [picture_codec.encode(picture, num_bytes, *transform, maps, order) for maps, _ in stops]
    return best_picture_at(picture, stops, codes, num_bytes, order)


def best_picture_at(
    picture: Picture,
    stops: Stops,
    codes: Sequence[PictureCode],
    num_bytes: int,
    order: int,
    mask: Mask | None = None,
) -> tuple[PlaneCode, bool]:
    """Return the code of the least squared error, and whether it has the edges of the map."""
    coded: list[tuple[float, PlaneCode, bool]] = []
    for (maps, is_shared), code in zip(stops, codes, strict=True):
        header, data = code.cut(num_bytes)
        plane = PlaneCode(header, order, data)
        decoded = decode_plane(plane, maps, (picture.shape[0], picture.shape[1]), 0, mask).picture()
        error = decoded.astype(np.float64) - picture
        coded.append((float(np.mean((error if mask is None else error[mask]) ** 2)), plane, is_shared))
    _, plane, is_shared = min(coded, key=lambda one: one[0])
    return plane, is_shared


def _best_share(
    image: DepthImage, candidates: Sequence[DepthCandidate], room: int, options: DepthOptions
) -> float:
    """Return the share of the map at which views one unit of m and n away have the least error."""
    assert image.picture is not None
    gray = np.asarray(luma(image.picture), np.float64)
    gradients = [float(np.mean(np.diff(gray, axis=axis) ** 2)) for axis in (0, 1)]
    weight = 0.5 * sum(gradients) * image.scale.factor**2
    code = picture_codec.encode(gray, room, options.num_levels, options.wavelet, True, None, 0)
    costs = []
    for share in _SHARES:
        bits = 8.0 * (1.0 - share) * room / gray.size
        picture_mse = float(np.interp(bits, code.bits_per_pixel, code.mse)) * _PEAK**2
        depth_mse = min(candidate.mse_at(share * room) for candidate in candidates)
        costs.append(picture_mse + weight * depth_mse)
    return float(_SHARES[int(np.argmin(costs))])
