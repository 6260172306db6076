"""The encoder: pictures and the disparities that predict the other views best for their bits.

Each quality layer first cuts the embedded code of the picture at its Lagrange multiplier, then finds the
disparities that predict the other views best from the picture that a decoder has at that layer (3.8, 3.36).
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from dvc.dibr.disparity.disparity_codec import DisparityCodec
from dvc.dibr.disparity.error_tensor import Tensor, error_tensor
from dvc.dibr.disparity.integer_transforms import Labels
from dvc.dibr.disparity.methods import METHODS
from dvc.dibr.names import DEFAULT
from dvc.dibr.view_decoder import significance_classes
from dvc.dibr.view_set import Views
from dvc.dibr.view_stream import (
    Header,
    Layer,
    PairLayer,
    decode_header,
    encode_header,
    encode_stream,
)
from dvc.dibr.views.forward_errors import ForwardErrors
from dvc.dibr.views.memory import check_memory
from dvc.errors import ConfigError
from dvc.geometry.camera_array import DisparityLabels
from dvc.geometry.viewpoints import warp_between
from dvc.images import picture_codec
from dvc.images.colour import Picture
from dvc.images.picture_codec import (
    LARGEST_MULTIPLIER,
    DecodedPicture,
    PictureCode,
    lowest_plane_at,
    multipliers_around,
)

MULTIPLIER_RANGE, MAX_MULTIPLIER_RATIO = 64.0, 4.0
"""Multipliers of the first quality layer and the last; and of one and the next, at most."""
MULTIPLIER_SHARES = tuple(0.8 + 0.05 * step for step in range(9))
"""Lengths, relative to one, whose multipliers are averaged."""


class Encoded(NamedTuple):
    """A stream and what it is made of."""

    data: bytes  # the file
    multiplier: float  # squared error (intensities from 0 to 1) that the last bit of a pixel was worth
    header_bytes: int  # parts of the file; the first with lengths and checksums of layers
    picture_bytes: int
    disparity_bytes: int

    @property
    def disparity_share(self) -> float:
        """Share of the disparities in the file."""
        return self.disparity_bytes / len(self.data)


class ViewEncoder:
    """Encodes some views at any multiplier.

    Parameters
    ----------
    views : Views
        The pictures.
    labels : DisparityLabels
        Disparities to choose from, of single precision.
    method : str
        How they are coded: `l`, `s`, `quadtree`, `blocks`, or what is installed.
    num_layers : int
        Quality layers.
    advance : callable
        Told 1 for each layer of a reference.
    codec : DisparityCodec, optional
        In place of that of the method; a decoder must be given it, too.
    """

    def __init__(
        self,
        views: Views,
        labels: DisparityLabels,
        method: str = DEFAULT,
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
        """Encode all layers.

        Parameters
        ----------
        multiplier : float
            Of the last layer: squared error, intensities from 0 to 1, that a bit per pixel is worth.
        picture_bytes : int, optional
            How long the code of all pictures is; by default as long as the multiplier says.

        Returns
        -------
        Encoded
            The stream.
        """
        multipliers = layer_multipliers(multiplier, self.header.num_layers)
        self._code_pictures(lowest_plane_at(multiplier), picture_bytes or 0)
        sizes = self._picture_sizes(multipliers[-1], picture_bytes)
        by_pair = [self._pair_layers(index, multipliers, size) for index, size in enumerate(sizes)]
        layers: list[Layer] = list(zip(*by_pair, strict=True))
        data = encode_stream(self.header, layers)
        picture, disparity = (sum(len(pair[part]) for layer in layers for pair in layer) for part in (0, 1))
        return Encoded(data, multiplier, len(data) - picture - disparity, picture, disparity)

    def multiplier_of_pictures(self, num_bytes: int) -> float:
        """Return the multiplier at which the code of all pictures has some length.

        Parameters
        ----------
        num_bytes : int
            The length.

        Returns
        -------
        float
            From `SMALLEST_MULTIPLIER` to `LARGEST_MULTIPLIER`; lengths leap where a multiplier is
            passed, so it is a mean of those of neighbouring lengths.
        """
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
        """Code all pictures as far as a bit plane, and to a length, if they have one."""
        while self._lowest_plane > lowest_plane or (
            self._lowest_plane and sum(len(code.data) for code in self.codes) < num_bytes
        ):
            self._lowest_plane = min(self._lowest_plane - 1, lowest_plane)
            self.codes = [
                picture_codec.encode(self.views.pictures[index], lowest_plane=self._lowest_plane)
                for index in self.views.references
            ]

    def _picture_sizes(self, multiplier: float, num_bytes: int | None) -> list[int]:
        """Lengths of the codes of pictures, in proportion to those at a multiplier."""
        sizes = [code.bytes_at_multiplier(multiplier) for code in self.codes]
        if num_bytes is None:
            return sizes
        return [num_bytes * (size + 1) // (sum(sizes) + len(sizes)) for size in sizes]

    def _pair_layers(self, index: int, multipliers: Sequence[float], size: int) -> list[PairLayer]:
        """All layers of one picture, of a given length, and its disparities."""
        layers, done, previous = [], 0, None
        code = self.codes[index]
        for layer, multiplier in enumerate(multipliers):
            is_last = layer == len(multipliers) - 1
            end = size if is_last else min(code.bytes_at_multiplier(multiplier), size)
            header, data = code.cut(max(end, done))
            decoded = picture_codec.decode(header, data, self.header.shape)
            classes = significance_classes(decoded)
            tensor = self._tensor(index, decoded)
            previous = previous if self.codec.layered else None
            distortion = self._distortion(index, decoded.picture())
            found: Any = self.codec.optimise(tensor, multiplier, classes, previous, distortion)
            self._check_labels(found.disparity())
            disparity = self.codec.encode(found, classes, previous)
            layers.append(PairLayer(header.to_bytes() + data[done:], disparity))
            done, previous = len(data), found
            self.advance(1)
        return layers

    def _check_labels(self, labels: Labels) -> None:
        """Refuse what is no map: codecs of other packages may find anything."""
        highest = self.header.labels.num_labels - 1
        if labels.shape != self.header.shape or not 0 <= labels.min() <= labels.max() <= highest:
            raise ConfigError(
                f"disparity codec {self.header.method!r}: expected a label from 0 to {highest} for each pixel"
            )

    def _distortion(self, index: int, picture: Picture) -> ForwardErrors:
        """What maps of labels cause where views are rendered forward (3.5)."""
        reference = self.header.references[index]
        others = self.views.predicted_from(reference)
        views = [(self.views.pictures[other], self.header.viewpoints[other]) for other in others]
        return ForwardErrors(picture, self.header.viewpoints[reference], self.header.labels, views)

    def _tensor(self, index: int, decoded: DecodedPicture) -> Tensor:
        """Errors of the views that are predicted from one reference (3.31)."""
        reference = self.header.references[index]
        others = self.views.predicted_from(reference)
        viewpoints = self.header.viewpoints
        warps = [warp_between(viewpoints[reference], viewpoints[other]) for other in others]
        pictures = [self.views.pictures[other] / 255.0 for other in others]
        labels = self.header.labels
        inverse_depths = labels.disparity(np.arange(labels.num_labels, dtype=np.float64))
        return error_tensor(decoded.picture() / 255.0, pictures, warps, inverse_depths)


def layer_multipliers(multiplier: float, num_layers: int) -> list[float]:
    """Return the multipliers of all quality layers."""
    ratio = min(MAX_MULTIPLIER_RATIO, MULTIPLIER_RANGE ** (1.0 / max(num_layers - 1, 1)))
    return [multiplier * ratio**step for step in range(num_layers - 1, -1, -1)]
