"""The encoder of layers and sprites, for streams of a given length."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dvc.bits import encode_varint
from dvc.dibr.depth_image.depth_codes import (
    DepthCandidate,
    DepthCode,
    DepthOptions,
    PictureCandidate,
    best_at,
    best_picture_at,
    code_edges,
    code_pictures,
    code_with_selections,
)
from dvc.dibr.depth_image.depth_image_encoder import DEPTH_SHARE
from dvc.dibr.depth_image.depth_image_stream import DepthImageStream, PlaneCode, encode_piece
from dvc.dibr.depth_image.depth_scale import NUM_LEVELS, DepthScale, Plane
from dvc.dibr.depth_image.piece_stream import Rectangle, encode_header, encode_stream
from dvc.dibr.depth_image.scene_pieces import Pieces
from dvc.dibr.layered.rate import Choices, allot
from dvc.errors import ConfigError
from dvc.geometry.rendering import EMPTY, fill_holes
from dvc.images.chain_code import EdgeCode
from dvc.images.colour import luma
from dvc.images.edge_maps import EdgeMaps
from dvc.images.edge_masks import border
from dvc.images.lifting import most_levels
from dvc.images.picture_codec import multipliers_around
from dvc.images.picture_header import PictureHeader
from dvc.layers.sprites import Sprite

_LEAST_SHARE = 0.05
"""Of the bytes that edges leave, for depth, where edges take more than the share of both."""
_NEARLY_ALL = 0.9
"""Of the bytes of pictures, to which all their codes reach: the multiplier is that at this length."""
_PEAK = 255.0
_DEPTH_WEIGHT = (_PEAK / NUM_LEVELS) ** 2
"""Of squared errors of depth, so that they are in units of the squared range."""


@dataclass(frozen=True)
class LayeredOptions:
    """How pieces are coded."""

    # how maps are transformed, at most so many times
    depth: DepthOptions = field(default_factory=DepthOptions)
    picture_order: int = 0  # of the extrapolation at edges in pictures
    depth_share: float = DEPTH_SHARE  # part of the bytes that edges and depth have, if masks leave it to them
    gray: bool = False  # code luma alone


@dataclass(frozen=True, eq=False)
class EncodedPieces:
    """A stream, and where its bytes go."""

    data: bytes  # the file
    edge_elements: int  # edges of all pieces, borders of masks among them
    part_bytes: dict[str, int]  # of `header` (of the stream and of its pieces), `edges`, `depth` and `image`
    # squared error that a bit of the pictures was worth, in squared levels of all pixels together
    multiplier: float


@dataclass(frozen=True, eq=False)
class _Coding:
    """A piece that is being coded."""

    piece: Sprite
    picture: NDArray[np.uint8]
    options: DepthOptions
    weight: float

    @property
    def shape(self) -> tuple[int, int]:
        return self.piece.mask.shape[0], self.piece.mask.shape[1]


def encode_to_size(
    scene: Pieces,
    max_bytes: int,
    options: LayeredOptions | None = None,
    advance: Callable[[int], None] = lambda _: None,
    weights: Sequence[float] | None = None,
) -> EncodedPieces:
    """Code layers or sprites, with all that they hold, as well as a number of bytes allows.

    Parameters
    ----------
    scene : Pieces
        What is coded.
    max_bytes : int
        Longest file.
    options : LayeredOptions, optional
        How.
    advance : callable, optional
        Called with 1 for each piece.
    weights : sequence of float, optional
        What errors of each piece count, beside those of the others; by default all the same.

    Returns
    -------
    EncodedPieces
        The stream.

    Raises
    ------
    ConfigError
        If not even header and masks fit.
    """
    chosen = options or LayeredOptions()
    codings = _codings(scene, chosen, weights or [1.0] * len(scene.pieces))
    room = max_bytes - _overhead(scene, codings, max_bytes)
    depths = _code_depths(codings, scene, room, chosen.depth_share, advance)
    left = room - sum(len(depth.edges.data) + len(depth.plane.data) for depth in depths)
    pictures, multiplier = _code_pictures(
        codings, [depth.edges.maps for depth in depths], left, chosen.picture_order
    )
    scales = [_scale_of(coding.piece, _extent(scene)) for coding in codings]
    streams = [
        DepthImageStream(
            coding.shape, scale, depth.edges.data, depth.edges.code, depth.plane, picture, shared, masked=True
        )
        for coding, scale, depth, (picture, shared) in zip(codings, scales, depths, pictures, strict=True)
    ]
    found = iter(streams)
    data = encode_stream(
        scene.canvas,
        scene.kind,
        [rectangle_of(piece) for piece in scene.pieces],
        [next(found) if piece.mask.any() else None for piece in scene.pieces],
    )
    assert len(data) <= max_bytes, "the overhead was counted"
    parts = {
        "edges": sum(len(stream.edges) for stream in streams),
        "depth": sum(len(stream.depth.data) for stream in streams),
        "image": sum(len(stream.picture.data) for stream in streams if stream.picture),
    }
    elements = sum(depth.edges.maps.count() for depth in depths if depth.edges.maps is not None)
    parts = {"header": len(data) - sum(parts.values()), **parts}
    return EncodedPieces(data, elements, parts, multiplier)


def mask_bytes(scene: Pieces) -> int:
    """Return what the masks of all pieces take."""
    masks = [piece.mask for piece in scene.pieces if piece.mask.any()]
    return sum(len(code_edges(border(mask), None, mask).data) for mask in masks)


def rectangle_of(piece: Sprite) -> Rectangle:
    """Return where a piece lies."""
    height, width = piece.mask.shape
    return Rectangle(piece.left, piece.top, width, height) if piece.mask.any() else Rectangle(0, 0, 0, 0)


def _codings(scene: Pieces, options: LayeredOptions, weights: Sequence[float]) -> list[_Coding]:
    """What is coded of pieces that are not empty: luma alone, where there is no colour."""
    gray = options.gray or all((piece.colour == piece.colour[..., :1]).all() for piece in scene.pieces)
    return [
        _Coding(
            piece,
            luma(piece.colour) if gray else piece.colour,
            replace(options.depth, num_levels=min(options.depth.num_levels, most_levels(piece.mask.shape))),
            weight,
        )
        for piece, weight in zip(scene.pieces, weights, strict=True)
        if piece.mask.any()
    ]


def _extent(scene: Pieces) -> DepthScale:
    """The scale of all maps together."""
    known = [piece.disparity[piece.mask].astype(np.float64) for piece in scene.pieces]
    values = np.concatenate(known) if known else np.zeros(0)
    return DepthScale.of(values if values.size else np.zeros(1))


def _scale_of(piece: Sprite, whole: DepthScale) -> DepthScale:
    """The scale of a map: as fine as that of all maps, about the middle of its own numbers."""
    known = piece.disparity[piece.mask].astype(np.float64)
    middle = 0.5 * (float(known.min()) + float(known.max()))
    return replace(whole, lowest=float(np.float32(middle - 0.5 * whole.extent)))


def _overhead(scene: Pieces, codings: Sequence[_Coding], max_bytes: int) -> int:
    """Bytes that are neither edges nor code, at most."""
    rectangles = [rectangle_of(piece) for piece in scene.pieces]
    header = len(
        encode_header(scene.canvas, scene.kind, rectangles, [max_bytes if p.width else 0 for p in rectangles])
    )
    nothing = PlaneCode(PictureHeader(0, 0), 0, b"")
    total = header
    for coding in codings[:1]:
        empty = DepthImageStream(
            coding.shape, _extent(scene), b"", EdgeCode.ADAPTIVE, nothing, nothing, masked=True
        )
        total += len(codings) * (len(encode_piece(empty)) + 3 * (len(encode_varint(max_bytes)) - 1))
    return total


def _code_depths(
    codings: Sequence[_Coding], scene: Pieces, room: int, share: float, advance: Callable[[int], None]
) -> list[DepthCode]:
    """Code all maps at one multiplier."""
    whole = _extent(scene)
    masks = mask_bytes(scene)
    if masks > room:
        raise ConfigError(f"header and masks take {masks - room} bytes more")
    most = max(int(share * room), masks + int(_LEAST_SHARE * (room - masks)))
    found: list[list[DepthCandidate]] = []
    for coding in codings:
        mask = coding.piece.mask
        scale = _scale_of(coding.piece, whole)
        found.append(code_with_selections(_continued(coding.piece), scale, most, coding.options, mask=mask))
        advance(1)
    choices = [
        Choices(
            tuple(candidate.code for candidate in candidates),
            tuple(len(candidate.edges.data) for candidate in candidates),
            coding.weight * _DEPTH_WEIGHT,
        )
        for coding, candidates in zip(codings, found, strict=True)
    ]
    lengths = allot(choices, most)
    assert lengths is not None, "masks fit"
    codes = [best_at(candidates, length) for candidates, length in zip(found, lengths, strict=True)]
    return [code for code in codes if code is not None]


def _continued(piece: Sprite) -> Plane:
    """The map of a piece, continued beside its mask."""
    return fill_holes(np.where(piece.mask, piece.disparity.astype(np.float64), EMPTY))


def _code_pictures(
    codings: Sequence[_Coding], edges: Sequence[EdgeMaps | None], room: int, order: int
) -> tuple[list[tuple[PlaneCode, bool]], float]:
    """Code all pictures at one multiplier; return it, and which share the edges of their maps."""
    found: list[list[PictureCandidate]] = []
    for coding, maps in zip(codings, edges, strict=True):
        outline = border(coding.piece.mask)
        stops: list[tuple[EdgeMaps | None, bool]] = [(outline, False)]
        if maps is not None and maps.count() > outline.count():
            stops.append((maps, True))
        found.append(code_pictures(coding.picture, stops, room, coding.options, order, coding.piece.mask))
    choices = [
        Choices(tuple(code for code, _, _ in one), (0,) * len(one), coding.weight)
        for coding, one in zip(codings, found, strict=True)
    ]
    lengths = allot(choices, room)
    assert lengths is not None, "nothing at all always fits"
    best = [
        best_picture_at(coding.picture, one, length, order, coding.piece.mask)
        for coding, one, length in zip(codings, found, lengths, strict=True)
    ]
    return best, multipliers_around(choices, _NEARLY_ALL * room)[1] * _PEAK**2
