"""A depth map coded with several selections of edges: the best at a length, or at a Lagrange multiplier."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvc.dibr.depth_image.depth_image_decoder import decode_plane
from dvc.dibr.depth_image.depth_image_stream import PlaneCode
from dvc.dibr.depth_image.depth_scale import DepthScale, Plane
from dvc.images import chain_code, picture_codec
from dvc.images import edge_selection as selection
from dvc.images.chain_code import EdgeCode
from dvc.images.edge_chains import trace
from dvc.images.edge_maps import EdgeMaps
from dvc.images.edge_masks import Mask, edges_inside
from dvc.images.lifting import WAVELETS
from dvc.images.picture_codec import PictureCode

REFINEMENTS = 2.0**-0.25, 2.0**0.25
"""Of the best step of a ladder: steps between it and its neighbours."""

NUM_STEPS = 2 * selection.MOST_RUNGS + 1 + len(REFINEMENTS)
"""That `code_with_selections` advances."""

_PEAK = 255.0


@dataclass(frozen=True)
class DepthOptions:
    """How a depth map is transformed."""

    wavelet: str = "9/7"  # ``9/7`` or ``5/3``
    num_levels: int = 5  # how many times it is split
    order: int = 1  # of the extrapolation at edges
    adaptive: bool = True  # arithmetic coding of coefficients; else plain bits


@dataclass(frozen=True, eq=False)
class CodedEdges:
    """Edges and their code."""

    maps: EdgeMaps | None  # the edges, if there are any
    code: EdgeCode  # how they are coded
    data: bytes  # their code
    mask: Mask | None = None  # where there is anything, which the code tells as well; None: everywhere


@dataclass(frozen=True, eq=False)
class DepthCode:
    """A depth map coded with some edges."""

    edges: CodedEdges  # the edges
    plane: PlaneCode  # its code
    mse: float  # mean squared error of the decoded map, in the map's own units


@dataclass(frozen=True, eq=False)
class DepthCandidate:
    """A depth map coded with some edges, to be cut."""

    edges: CodedEdges  # the edges
    code: PictureCode  # of the map's levels
    depth: Plane  # the map
    scale: DepthScale  # of its numbers
    order: int  # of the extrapolation at edges

    def cut(self, num_bytes: int) -> DepthCode | None:
        """Return what fits into a length."""
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
        """Return about what the squared error is at a length."""
        room = 8.0 * (num_bytes - len(self.edges.data)) / self.depth.size
        if room < 0:
            return np.inf
        levels = float(np.interp(room, self.code.bits_per_pixel, self.code.mse)) * _PEAK**2
        return levels * self.scale.unit**2


def code_edges(edges: EdgeMaps, code: EdgeCode | None = None, mask: Mask | None = None) -> CodedEdges:
    """Code edges."""
    if mask is None and not edges.count():
        return CodedEdges(None, EdgeCode.ADAPTIVE, b"")
    chains = trace(edges)
    usual = [one for one in (EdgeCode.ADAPTIVE, EdgeCode.FIXED) if chain_code.fits(chains, one)]
    codes = usual if code is None else [code]
    found = [CodedEdges(edges, one, chain_code.encode(chains, one, mask), mask) for one in codes]
    return min(found, key=lambda coded: len(coded.data))


def code_with_edges(
    depth: Plane, scale: DepthScale, edges: CodedEdges, max_bytes: int, options: DepthOptions
) -> DepthCandidate:
    """Code a depth map with given edges."""
    room = max(max_bytes - len(edges.data), 0)
    code = picture_codec.encode(
        scale.levels(depth),
        room,
        options.num_levels,
        options.wavelet,
        options.adaptive,
        edges.maps,
        options.order,
        mask=edges.mask,
    )
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
    wavelet = WAVELETS[options.wavelet]

    def _code(edges: EdgeMaps) -> DepthCandidate:
        coded = code_edges(edges if mask is None else edges_inside(edges, mask), None, mask)
        candidate = code_with_edges(depth, scale, coded, max_bytes, options)
        _count(1)
        return candidate

    done = 0

    def _count(number: int) -> None:
        nonlocal done
        done += number
        advance(number)

    rungs = list(selection.ladder(depth, 8.0 * max_bytes, options.order, wavelet, mask, _count))
    _count(2 * selection.MOST_RUNGS - done - len(rungs))
    found = [_code(EdgeMaps.none((depth.shape[0], depth.shape[1])))]
    found += [_code(edges) for _, edges in rungs]
    best = int(np.argmin([candidate.mse_at(max_bytes) for candidate in found]))
    if best:
        step, edges = rungs[best - 1][0], rungs[max(best - 2, 0)][1]
        for factor in REFINEMENTS:
            found.append(_code(selection.select(depth, edges, step * factor, options.order, wavelet)))
    _count(NUM_STEPS - done)
    return [candidate for candidate in found if len(candidate.edges.data) <= max_bytes]


def best_at(candidates: Sequence[DepthCandidate], num_bytes: int) -> DepthCode | None:
    """Return the code of the least squared error."""
    found = [code for candidate in candidates if (code := candidate.cut(num_bytes)) is not None]
    return min(found, key=lambda code: code.mse, default=None)


PictureCandidate = tuple[PictureCode, EdgeMaps | None, bool]
"""A picture coded with some edges, to be cut; these; and whether they are those of its map, too."""


def code_pictures(
    picture: NDArray[np.uint8],
    stops: Sequence[tuple[EdgeMaps | None, bool]],
    max_bytes: int,
    options: DepthOptions,
    order: int,
    mask: Mask | None = None,
) -> list[PictureCandidate]:
    """Code a picture with several edges."""
    levels, how = np.asarray(picture, np.float64), (options.num_levels, options.wavelet, options.adaptive)
    return [
        (picture_codec.encode(levels, max_bytes, *how, maps, order, mask=mask), maps, shared)
        for maps, shared in stops
    ]


def best_picture_at(
    picture: NDArray[np.uint8],
    candidates: Sequence[PictureCandidate],
    num_bytes: int,
    order: int,
    mask: Mask | None = None,
) -> tuple[PlaneCode, bool]:
    """Return the code of the least squared error, and whether it has the edges of the map."""
    found: list[tuple[float, PlaneCode, bool]] = []
    for code, maps, shared in candidates:
        header, data = code.cut(num_bytes)
        plane = PlaneCode(header, order, data)
        decoded = decode_plane(plane, maps, (picture.shape[0], picture.shape[1]), 0, mask).picture()
        error = decoded.astype(np.float64) - picture
        found.append((float(np.mean((error if mask is None else error[mask]) ** 2)), plane, shared))
    _, plane, shared = min(found, key=lambda one: one[0])
    return plane, shared
