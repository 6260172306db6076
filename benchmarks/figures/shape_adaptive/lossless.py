"""Rates of maps without error, or with at most half a pixel, beside lossless picture formats."""

import io
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
from PIL import Image

from benchmarks.figures.harness import Figure, Measured, Setting
from benchmarks.figures.shape_adaptive.depth import AREA
from benchmarks.figures.shape_adaptive.maps import TEDDY, material
from dvc.dibr.codec.views import Picture
from dvc.dibr.depth_image.decoder import decode
from dvc.dibr.depth_image.depth_codes import CodedEdges, code_edges
from dvc.dibr.depth_image.depth_scale import DepthScale
from dvc.dibr.depth_image.encoder import DepthImage, encode_to_size
from dvc.dibr.depth_image.stream import decode_stream
from dvc.dibr.wavelets.edge_maps import EdgeMaps

LEVELS_PER_PX = 4.0
MOST_BPP = 4.0
MOST_ERRORS_PX = 0.0, 0.5
EDGES_BPP = 0.04, 0.25, 1.0
"""Rates at which edges are selected, to choose from."""
PRECISION = 1.005
_NEAR = {0: "left", 2: "median"}
"""FFmpeg's encoder of JPEG-LS takes its largest error, in levels, where others take the predictor."""


def near_lossless(setting: Setting, clip: str) -> Measured:
    """Find the shortest file whose map, rounded to quarters of a pixel, has no larger error."""
    levels = np.rint(material(TEDDY).depth * LEVELS_PER_PX).astype(np.uint8)
    depth = levels / LEVELS_PER_PX
    image = DepthImage(depth, DepthScale.of(depth))
    selections = _selections(image, EDGES_BPP[: setting.choose(len(EDGES_BPP), 1)])
    found: dict[str, dict[str, float]] = {}
    for most in MOST_ERRORS_PX:
        own = min(_shortest(image, edges, most) for edges in selections)
        whole = levels if most == 0.0 else np.rint(depth).astype(np.uint8)
        peers = {name: 8.0 * len(code(whole)) / levels.size for name, code in _LOSSLESS.items()}
        peers["JPEG-LS"] = 8.0 * len(_jpeg_ls(levels, round(LEVELS_PER_PX * most))) / levels.size
        found[f"{most:g}_px"] = {"ours": own, **peers}
    texts = (
        f"≤ {most:g} px: " + ", ".join(f"{name} {bpp:.2f}" for name, bpp in row.items())
        for most, row in zip(MOST_ERRORS_PX, found.values(), strict=True)
    )
    note = (
        "quarters of a pixel, holes filled; up to 0.5 px others code whole pixels without loss, JPEG-LS is "
        "told the error; no encoder of JPEG XL is installed"
    )
    return Measured("; ".join(texts) + " bpp", None, dict(found), note)


def _selections(image: DepthImage, rates: tuple[float, ...]) -> list[CodedEdges]:
    """Edges that pay at some rates, and none."""
    found = [code_edges(EdgeMaps.none((image.depth.shape[0], image.depth.shape[1])))]
    for rate in rates:
        encoded = encode_to_size(image, int(rate * image.depth.size / 8.0), None)
        if encoded.edges is not None:
            found.append(code_edges(encoded.edges))
    return found


def _shortest(image: DepthImage, edges: CodedEdges, most_px: float) -> float:
    """Bits per pixel of the shortest file that keeps to an error; infinite if there is none."""
    num_pixels = image.depth.size
    low, high = 0.02 + 8.0 * len(edges.data) / num_pixels, MOST_BPP
    if not _holds(image, edges, high, most_px):
        return np.inf
    while high / low > PRECISION:
        middle = float(np.sqrt(low * high))
        if _holds(image, edges, middle, most_px):
            high = middle
        else:
            low = middle
    return high


def _holds(image: DepthImage, edges: CodedEdges, rate_bpp: float, most_px: float) -> bool:
    encoded = encode_to_size(image, int(rate_bpp * image.depth.size / 8.0), edges)
    decoded = np.rint(decode(decode_stream(encoded.data)).depth * LEVELS_PER_PX) / LEVELS_PER_PX
    return bool(np.abs(decoded - image.depth).max() <= most_px)


def _saved(picture: Picture, file_format: str, **options: Any) -> bytes:
    file = io.BytesIO()
    Image.fromarray(picture).save(file, file_format, **options)
    return file.getvalue()


def _jpeg_ls(picture: Picture, near: int) -> bytes:
    import av

    context = av.CodecContext.create("jpegls", "w")
    context.height, context.width = picture.shape
    context.pix_fmt, context.time_base = "gray", Fraction(1, 25)
    context.options = {"pred": _NEAR[near]}
    frame = av.VideoFrame.from_ndarray(picture, format="gray")
    frame.pts = 0
    return b"".join(bytes(packet) for packet in (*context.encode(frame), *context.encode(None)))


_LOSSLESS: dict[str, Callable[[Picture], bytes]] = {
    "PNG": lambda picture: _saved(picture, "PNG", optimize=True),
    "WebP": lambda picture: _saved(picture, "WEBP", lossless=True, quality=100, method=6),
    "JPEG 2000": lambda picture: _saved(picture, "JPEG2000", irreversible=False),
}

FIGURES = (
    Figure(
        AREA,
        "near-lossless",
        "Teddy's map: rate of the shortest file of no error, and of at most 0.5 px, beside lossless formats",
        "printed",
        near_lossless,
        slow=True,
    ),
)
"""The figures of this module."""
