"""The encoder of layers and sprites, for streams of a given length."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvc.bits import encode_varint
from dvc.dibr.depth_image.depth_image_encoder import (
    DEPTH_SHARE,
    DepthCode,
    DepthOptions,
    best_at,
    best_picture_at,
    code_edges,
    code_with_selections,
)
from dvc.dibr.depth_image.depth_image_stream import NUM_LEVELS, DepthImageStream, DepthScale, PlaneCode
from dvc.dibr.depth_image.depth_image_stream import encode_stream as encode_image
from dvc.dibr.depth_image.piece_stream import encode_header, encode_stream
from dvc.dibr.depth_image.scene_pieces import Pieces
from dvc.errors import ConfigError
from dvc.geometry.rendering import fill_holes
from dvc.geometry.warping import EMPTY
from dvc.images.chain_code import EdgeCode
from dvc.images.colour import luma
from dvc.images.edge_maps import EdgeMaps, border
from dvc.images.lifting import most_levels
from dvc.images.picture_codec import PictureCode, PictureHeader, multipliers_around
from dvc.images.picture_codec import encode as encode_picture
from dvc.layers.canvas import Frame
from dvc.layers.sprites import Sprite

_LEAST_SHARE = 0.05
"""Least share of depth in the bytes that masks leave."""
_NEARLY_ALL = 0.9
"""Share of the bytes of pictures at which their multiplier is measured: all their codes are longer."""
_PEAK = 255.0
_DEPTH_WEIGHT = (_PEAK / NUM_LEVELS) ** 2
"""Weight of squared errors of depth, which makes them errors in units of the squared range."""


@dataclass(frozen=True, eq=False)
class EncodedPieces:
    """A stream and the sizes of its parts."""

    data: bytes  # the file
    edge_elements: int  # edges of all pieces, borders of masks included
    # bytes of `header` (of the stream and of its pieces), `edges`, `depth`, `image`
    part_bytes: dict[str, int]
    # squared error that a bit of the pictures was worth, in squared levels of all pixels together
    multiplier: float


@dataclass(frozen=True, eq=False)
class _Coding:
    """A piece that is being coded."""

    piece: Sprite
    picture: NDArray[np.uint8]
    options: DepthOptions
    weight: float
    scale: DepthScale


def encode_to_size(
    scene: Pieces,
    max_bytes: int,
    options: DepthOptions | None = None,
    advance: Callable[[int], None] = lambda _: None,
    weights: Sequence[float] | None = None,
    gray: bool = False,
) -> EncodedPieces:
    """Code layers or sprites, with all their values, to a file of at most some length.

    Parameters
    ----------
    scene : Pieces
        Layers or sprites.
    max_bytes : int
        Largest length.
    options : DepthOptions, optional
        Coding of pieces.
    advance : callable, optional
        Called with 1 for each piece.
    weights : sequence of float, optional
        Relative weights of the errors of each piece; by default all the same.
    gray : bool, optional
        Whether only luma is coded.

    Returns
    -------
    EncodedPieces
        The stream.

    Raises
    ------
    ConfigError
        If header and masks do not fit.
    """
    chosen = options or DepthOptions()
    codings = _codings(scene, chosen, weights or [1.0] * len(scene.pieces), gray)
    rectangles = [
        Frame(piece.left, piece.top, *piece.mask.shape[::-1]) if piece.mask.any() else Frame(0, 0, 0, 0)
        for piece in scene.pieces
    ]
    sizes = [max_bytes if rectangle.width else 0 for rectangle in rectangles]
    room = max_bytes - len(encode_header(scene.canvas, scene.kind, rectangles, sizes))
    nothing = PlaneCode(PictureHeader(0, 0), 0, b"")
    for one in codings:
        empty = DepthImageStream(
            one.picture.shape[:2], one.scale, b"", EdgeCode.ADAPTIVE, nothing, nothing, masked=True
        )
        room -= len(encode_image(empty, is_piece=True)) + 3 * (len(encode_varint(max_bytes)) - 1)
    depths = _code_depths(codings, mask_bytes(scene), room, chosen.depth_share or DEPTH_SHARE, advance)
    remaining = room - sum(len(depth.edges.data) + len(depth.plane.data) for depth in depths)
    maps = [depth.edges.maps for depth in depths]
    pictures, multiplier = _code_pictures(codings, maps, remaining, chosen.picture_order)
    streams = []
    for one, depth, (picture, is_shared) in zip(codings, depths, pictures, strict=True):
        coded = depth.edges.data, depth.edges.code, depth.plane, picture, is_shared
        streams.append(DepthImageStream(one.piece.mask.shape, one.scale, *coded, masked=True))
    ordered = iter(streams)
    pieces = [next(ordered) if rectangle.width else None for rectangle in rectangles]
    data = encode_stream(scene.canvas, scene.kind, rectangles, pieces)
    assert len(data) <= max_bytes, "the overhead was counted"
    parts = {name: sum(one.part_bytes[name] for one in streams) for name in ("edges", "depth", "image")}
    elements = sum(edges.count() for edges in maps if edges is not None)
    return EncodedPieces(data, elements, {"header": len(data) - sum(parts.values()), **parts}, multiplier)


def mask_bytes(scene: Pieces) -> int:
    """Return the bytes of the masks of all pieces."""
    masks = [piece.mask for piece in scene.pieces if piece.mask.any()]
    return sum(len(code_edges(border(mask), None, mask).data) for mask in masks)


def _codings(scene: Pieces, options: DepthOptions, weights: Sequence[float], gray: bool) -> list[_Coding]:
    """Return the pieces that are not empty; only their luma if no piece has any colour."""
    gray = gray or all((piece.colour == piece.colour[..., :1]).all() for piece in scene.pieces)
    values = [piece.disparity[piece.mask].astype(np.float64) for piece in scene.pieces]
    # one scale for all maps, each about the middle of its own numbers
    whole = DepthScale.of(np.concatenate(values) if scene.num_values else np.zeros(1))
    codings = []
    for piece, depth, weight in zip(scene.pieces, values, weights, strict=True):
        if piece.mask.any():
            levels = min(options.num_levels, most_levels(piece.mask.shape))
            middle = 0.5 * (float(depth.min()) + float(depth.max()))
            scale = replace(whole, lowest=float(np.float32(middle - 0.5 * whole.extent)))
            picture = luma(piece.colour) if gray else piece.colour
            codings.append(_Coding(piece, picture, replace(options, num_levels=levels), weight, scale))
    return codings


def _code_depths(
    codings: Sequence[_Coding], masks: int, room: int, share: float, advance: Callable[[int], None]
) -> list[DepthCode]:
    """Code all maps at one multiplier."""
    if masks > room:
        raise ConfigError(f"header and masks take {masks - room} bytes more")
    most = max(int(share * room), masks + int(_LEAST_SHARE * (room - masks)))
    candidates = []
    for one in codings:
        mask = one.piece.mask
        depth = fill_holes(np.where(mask, one.piece.disparity.astype(np.float64), EMPTY))
        candidates.append(code_with_selections(depth, one.scale, most, one.options, mask=mask))
        advance(1)
    choices = []
    for one, of_piece in zip(codings, candidates, strict=True):
        sizes = [len(candidate.edges.data) for candidate in of_piece]
        choices.append(Choices([candidate.code for candidate in of_piece], sizes, one.weight * _DEPTH_WEIGHT))
    lengths = allot(choices, most)
    assert lengths is not None, "masks fit"
    codes = [best_at(of_piece, length) for of_piece, length in zip(candidates, lengths, strict=True)]
    return [code for code in codes if code is not None]


def _code_pictures(
    codings: Sequence[_Coding], edges: Sequence[EdgeMaps | None], room: int, order: int
) -> tuple[list[tuple[PlaneCode, bool]], float]:
    """Code all pictures at one multiplier; return them, which share the edges of their maps, and it."""
    all_stops, choices = [], []
    for one, maps in zip(codings, edges, strict=True):
        outline = border(one.piece.mask)
        stops: list[tuple[EdgeMaps | None, bool]] = [(outline, False)]
        if maps is not None and maps.count() > outline.count():
            stops.append((maps, True))
        settings, mask = (one.options.num_levels, one.options.wavelet, True), one.piece.mask
        codes = [encode_picture(one.picture, room, *settings, each, order, mask=mask) for each, _ in stops]
        all_stops.append(stops)
        choices.append(Choices(codes, [0] * len(codes), one.weight))
    lengths = allot(choices, room)
    assert lengths is not None, "an empty code always fits"
    best = [
        best_picture_at(one.picture, stops, choice.codes, length, order, one.piece.mask)
        for one, stops, choice, length in zip(codings, all_stops, choices, lengths, strict=True)
    ]
    return best, multipliers_around(choices, _NEARLY_ALL * room)[1] * _PEAK**2


@dataclass(frozen=True, eq=False)
class Choices:
    """Codes of one piece to choose from."""

    codes: Sequence[PictureCode]  # at least one; errors of all pieces in the same unit
    fixed_bytes: Sequence[int]  # further bytes of each code
    weight: float = 1.0  # weight of their errors

    def bytes_at_multiplier(self, multiplier: float) -> int:
        """Return the length of the code of least cost."""
        multiplier /= self.weight
        costs, lengths = [], []
        for code, fixed in zip(self.codes, self.fixed_bytes, strict=True):
            num_pixels = code.shape[0] * code.shape[1]
            cost = float(np.min(code.mse + multiplier * code.bits_per_pixel))
            costs.append(cost + multiplier * 8.0 * fixed / num_pixels)
            lengths.append(fixed + code.bytes_at_multiplier(multiplier))
        return lengths[int(np.argmin(costs))]


def allot(choices: Sequence[Choices], num_bytes: int) -> list[int] | None:
    """Divide bytes among pieces at one multiplier; None if they are too few."""
    smaller, larger = multipliers_around(choices, num_bytes)
    lengths = [choice.bytes_at_multiplier(larger) for choice in choices]
    remaining = num_bytes - sum(lengths)
    if remaining < 0:  # few pixels: even the first bits of a code may be worth it
        lengths = [min(choice.fixed_bytes) for choice in choices]
        return lengths if sum(lengths) <= num_bytes else None
    for number, choice in enumerate(choices):
        more = min(max(choice.bytes_at_multiplier(smaller) - lengths[number], 0), remaining)
        lengths[number] += more
        remaining -= more
    return lengths
