"""The encoder of views: pictures, and the disparities that predict the other views best for their bits.

Each quality layer first cuts the embedded code of the picture at its Lagrange multiplier, then finds the
disparities that predict the other views best from the picture that a decoder has at that layer (3.8, 3.36).
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from dvc.arrays import Floats
from dvc.dibr.dibr_streams import DEFAULT_CODEC
from dvc.dibr.disparity.disparity_codec import (
    DisparityCodec,
    Holes,
    Tensor,
    error_tensor,
    subtract_hole_errors,
)
from dvc.dibr.disparity.integer_transforms import Labels
from dvc.dibr.view_rendering import PictureAndDisparity, picture_of, render_pairs
from dvc.dibr.view_set import Views
from dvc.dibr.view_stream import (
    METHODS,
    Header,
    Layer,
    PairLayer,
    decode_header,
    encode_header,
    encode_stream,
    significance_classes,
)
from dvc.errors import ConfigError
from dvc.geometry.camera_array import DisparityLabels
from dvc.geometry.viewpoints import Viewpoint, warp_between
from dvc.images import picture_codec
from dvc.images.colour import Picture
from dvc.images.picture_codec import LARGEST_MULTIPLIER, PictureCode, lowest_plane_at, multipliers_around

MULTIPLIER_RANGE, MAX_MULTIPLIER_RATIO = 64.0, 4.0
"""Ratio of the multipliers of the first and the last quality layer; largest ratio of neighbours."""
MULTIPLIER_SHARES = tuple(0.8 + 0.05 * step for step in range(9))
"""Lengths, relative to the target, over which multipliers are averaged."""
MAX_GIB = 4.0
"""Largest memory for encoding."""
_BYTES_PER_ERROR = 10.0
"""Bytes per label and pixel: error tensor, a copy, dynamic programming; 8 to 9 were measured."""
_BYTES_PER_PIXEL = 650.0
"""Bytes per pixel of the reference, its trees and its views; measured in colour, gray needs half."""
PICTURE_SHARE = 0.85
"""Share of the pictures in most streams, at which rate control begins."""
TOLERANCE = 0.005
"""Share of the budget that may remain unused."""
GROWTH = 0.7, 3.0
"""Limits of the growth of streams in bytes per byte of the pictures."""
MAX_STEPS = 8
"""Most encodings of rate control."""
SAME_SURFACE_LABELS = 1.5
"""Distance behind a drawn surface, in labels, within which a label still counts as seen."""


class Encoded(NamedTuple):
    """A stream and the sizes of its parts."""

    data: bytes  # the file
    multiplier: float  # squared error (intensities from 0 to 1) that the last bit of a pixel was worth
    header_bytes: int  # header, lengths and checksums of layers
    picture_bytes: int
    disparity_bytes: int

    @property
    def disparity_share(self) -> float:
        """Share of the disparities in the file."""
        return self.disparity_bytes / len(self.data)


def check_memory(shape: tuple[int, int], num_labels: int) -> None:
    """Refuse views and labels that take too much memory."""
    num_pixels = shape[0] * shape[1]
    gib = num_pixels * (_BYTES_PER_PIXEL + _BYTES_PER_ERROR * num_labels) / 2**30
    if gib > MAX_GIB:
        raise ConfigError(
            f"{num_labels} disparities of {shape[1]}x{shape[0]} pixels take about {gib:.1f} GiB, more than "
            f"{MAX_GIB:g}: fewer disparities, or smaller views"
        )


class ViewEncoder:
    """Encodes views at any multiplier.

    Parameters
    ----------
    views : Views
        The pictures.
    labels : DisparityLabels
        Disparities to choose from, of single precision.
    method : str
        Name of the disparity codec: `l`, `s`, `quadtree`, `blocks`.
    num_layers : int
        Number of quality layers.
    advance : callable
        Called with 1 for each layer of a reference.
    codec : DisparityCodec, optional
        Disparity codec that replaces that of the method; decoders need the same one.
    """

    def __init__(
        self,
        views: Views,
        labels: DisparityLabels,
        method: str = DEFAULT_CODEC,
        num_layers: int = 1,
        advance: Callable[[int], None] = lambda _: None,
        codec: DisparityCodec | None = None,
    ) -> None:
        check_memory(views.shape, labels.num_labels)
        exact = Header(views.shape, method, labels, views.references, num_layers, views.viewpoints)
        self.header, _ = decode_header(encode_header(exact))
        self.views, self.advance = views, advance
        self.codec: DisparityCodec = METHODS[method] if codec is None else codec
        self.codes: list[PictureCode] = []
        self._lowest_plane = lowest_plane_at(LARGEST_MULTIPLIER) + 1

    def encode(self, multiplier: float, picture_bytes: int | None = None) -> Encoded:
        """Encode all layers, the last at a multiplier; the code of all pictures may be given its length."""
        multipliers = layer_multipliers(multiplier, self.header.num_layers)
        self._code_pictures(lowest_plane_at(multiplier), picture_bytes or 0)
        sizes = [code.bytes_at_multiplier(multiplier) for code in self.codes]
        if picture_bytes is not None:  # in proportion
            sizes = [picture_bytes * (size + 1) // (sum(sizes) + len(sizes)) for size in sizes]
        by_pair = [self._pair_layers(index, multipliers, size) for index, size in enumerate(sizes)]
        layers: list[Layer] = list(zip(*by_pair, strict=True))
        data = encode_stream(self.header, layers)
        picture, disparity = (sum(len(pair[part]) for layer in layers for pair in layer) for part in (0, 1))
        return Encoded(data, multiplier, len(data) - picture - disparity, picture, disparity)

    def encode_to_size(self, max_bytes: int) -> Encoded:
        """Encode to a file of at most some length."""
        # The code of pictures can be cut at any byte; that of disparities follows from a multiplier. Pictures
        # get the bytes that disparities leave, and disparities the multiplier of such pictures, repeatedly.
        best: Encoded | None = None
        picture_bytes, growth = int(PICTURE_SHARE * max_bytes), 1.0 / PICTURE_SHARE
        tried: list[tuple[int, int]] = []
        for _ in range(MAX_STEPS):
            encoded = self.encode(self._multiplier_of_pictures(picture_bytes), picture_bytes)
            size = len(encoded.data)
            if size <= max_bytes and (best is None or size > len(best.data)):
                best = encoded
            if (1.0 - TOLERANCE) * max_bytes <= size <= max_bytes:
                break
            if tried and tried[-1][0] != picture_bytes:
                measured = (size - tried[-1][1]) / (picture_bytes - tried[-1][0])
                growth = min(max(measured, GROWTH[0]), GROWTH[1])
            tried.append((picture_bytes, size))
            # aim at half of the tolerance, as the code of disparities varies a little
            target = (1.0 - 0.5 * TOLERANCE) * max_bytes
            picture_bytes = max(picture_bytes + round((target - size) / growth), 0)
        if best is not None:
            return best
        smallest = self.encode(LARGEST_MULTIPLIER)
        if (size := len(smallest.data)) > max_bytes:
            raise ConfigError(f"{max_bytes} bytes are too few: these views need {size} at least")
        return smallest

    def _multiplier_of_pictures(self, num_bytes: int) -> float:
        """Return the multiplier at which the code of all pictures has a length."""
        # lengths jump at some multipliers, so it is a mean over neighbouring lengths
        plane = lowest_plane_at(LARGEST_MULTIPLIER)
        while True:
            self._code_pictures(plane, MULTIPLIER_SHARES[-1] * num_bytes)
            around = [
                math.log(multipliers_around(self.codes, share * num_bytes)[1]) for share in MULTIPLIER_SHARES
            ]
            multiplier = math.exp(sum(around) / len(around))
            plane = lowest_plane_at(multiplier)
            if plane >= self._lowest_plane:
                return multiplier

    def _code_pictures(self, lowest_plane: int, num_bytes: float) -> None:
        """Code all pictures down to a bit plane, and up to a length, if possible."""
        while self._lowest_plane > lowest_plane or (
            self._lowest_plane and sum(len(code.data) for code in self.codes) < num_bytes
        ):
            self._lowest_plane = min(self._lowest_plane - 1, lowest_plane)
            self.codes = [
                picture_codec.encode(self.views.pictures[index], lowest_plane=self._lowest_plane)
                for index in self.views.references
            ]

    def _pair_layers(self, index: int, multipliers: Sequence[float], size: int) -> list[PairLayer]:
        """Return all layers of one picture, of a given length, and its disparities."""
        header, codec = self.header, self.codec
        reference = header.references[index]
        viewpoint = header.viewpoints[reference]
        predicted = self.views.predicted_from(reference)
        views = [(self.views.pictures[view], header.viewpoints[view]) for view in predicted]
        inverse_depths = header.labels.disparity(np.arange(header.labels.num_labels, dtype=np.float64))
        warps = [warp_between(viewpoint, other) for _, other in views]
        layers, done, previous = [], 0, None
        code = self.codes[index]
        for layer, multiplier in enumerate(multipliers):
            is_last = layer == len(multipliers) - 1
            end = size if is_last else min(code.bytes_at_multiplier(multiplier), size)
            picture_header, data = code.cut(max(end, done))
            decoded = picture_codec.decode(picture_header, data, header.shape)
            classes, picture = significance_classes(decoded), decoded.picture()
            tensor = error_tensor(
                picture / 255.0, [truth / 255.0 for truth, _ in views], warps, inverse_depths
            )
            previous = previous if codec.layered else None
            distortion = ForwardErrors(picture, viewpoint, header.labels, views)
            result: Any = codec.optimise(tensor, multiplier, classes, previous, distortion)
            labels, highest = result.disparity(), header.labels.num_labels - 1
            if labels.shape != header.shape or not 0 <= labels.min() <= labels.max() <= highest:
                raise ConfigError(
                    f"disparity codec {header.method!r}: expected a label from 0 to {highest} for each pixel"
                )
            disparity = codec.encode(result, classes, previous)
            layers.append(PairLayer(picture_header.to_bytes() + data[done:], disparity))
            done, previous = len(data), result
            self.advance(1)
        return layers


def layer_multipliers(multiplier: float, num_layers: int) -> list[float]:
    """Return the multipliers of all quality layers."""
    ratio = min(MAX_MULTIPLIER_RATIO, MULTIPLIER_RANGE ** (1.0 / max(num_layers - 1, 1)))
    return [multiplier * ratio**step for step in range(num_layers - 1, -1, -1)]


class ForwardErrors:
    """Errors of the views that are rendered forward from one decoded picture (3.5); see `Distortion`."""

    def __init__(
        self,
        picture: Picture,
        viewpoint: Viewpoint,
        labels: DisparityLabels,
        views: Sequence[tuple[Picture, Viewpoint]],
    ) -> None:
        self._picture, self._viewpoint, self._labels, self._views = picture, viewpoint, labels, views
        self._warps = [warp_between(viewpoint, other) for _, other in views]
        self._inverse_depths = labels.disparity(np.arange(labels.num_labels, dtype=np.float64))
        motions = [parallax_px(warp, picture.shape, self._inverse_depths) for warp in self._warps]
        self.parallax = sum(motions) / (len(views) + 1)

    def measure(self, labels: Labels) -> tuple[float, list[Holes]]:
        """Render all views; see `Distortion`."""
        disparity = self._labels.disparity(labels.astype(np.float64))
        pair = PictureAndDisparity(self._picture, disparity, self._viewpoint)
        total, holes = 0.0, []
        lowest, step, num_labels = self._labels
        for truth, viewpoint in self._views:
            view = render_pairs([pair], viewpoint, step)
            errors = ((picture_of(view).astype(np.float32) - truth) / np.float32(255.0)) ** 2
            errors = errors if errors.ndim == 2 else errors.mean(axis=2)
            total += float(errors.sum(dtype=np.float64))
            # lowest label that is seen in front of the drawn surface, or as part of it
            first = np.ceil((view.inverse_depth - lowest) / step - SAME_SURFACE_LABELS)
            first = np.where(view.drawn, np.clip(first, 0, num_labels), 0).astype(np.int32)
            holes.append(Holes(np.where(view.drawn, np.float32(0.0), errors), first))
        return total / (len(self._views) + 1), holes

    def claimed(self, tensor: Tensor, holes: Sequence[Holes], weight: float) -> Tensor:
        """Credit labels that would cover holes; see `Distortion`."""
        return subtract_hole_errors(tensor, holes, self._warps, self._inverse_depths, weight)


def parallax_px(warp: Floats, shape: tuple[int, ...], inverse_depths: Floats) -> float:
    """Return the motion of the middle of a picture in another view from one label to the next."""
    if len(inverse_depths) < 2:
        return 0.0
    middle = np.array([(shape[1] - 1) / 2.0, (shape[0] - 1) / 2.0, 1.0])
    ends = warp[:, :3] @ middle + inverse_depths[[0, -1], None] * warp[:, 3]
    first, last = ends[:, :2] / ends[:, 2:]
    return float(np.hypot(*(last - first))) / (len(inverse_depths) - 1)
