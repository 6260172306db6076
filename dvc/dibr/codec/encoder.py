"""The encoder: pictures and the disparities that predict the other views best for their bits.

Each quality layer first takes what its slope is worth from the embedded code of the picture, then finds the
disparities that predict the other views best from the picture that a decoder has at that layer (3.8, 3.36).
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from dvc.dibr.codec.decoder import significance_classes
from dvc.dibr.codec.forward_errors import ForwardErrors
from dvc.dibr.codec.memory import check_memory
from dvc.dibr.codec.views import Picture, Views
from dvc.dibr.disparity.error_tensor import Tensor, error_tensor
from dvc.dibr.disparity.methods import METHODS, DisparityCodec
from dvc.dibr.reference import codec as reference_codec
from dvc.dibr.reference.codec import DecodedReference, ReferenceCode
from dvc.dibr.stream.header import DisparityMethod, Header, decode_header, encode_header
from dvc.dibr.stream.layers import Layer, PairLayer, encode_stream
from dvc.multiview.camera_array import DisparityLabels
from dvc.multiview.viewpoints import warp_between

SLOPE_RANGE, MAX_SLOPE_RATIO = 64.0, 4.0
"""Slopes of the first quality layer and the last; and of one and the next, at most."""
PICTURE_SHARE = 0.85
"""Share of the pictures in most streams."""
LIKELY_SLOPES, SLOPE_STEPS = (1e-7, 1.0), 30
"""Slopes between which one is looked for, and how often the interval is halved."""


class Encoded(NamedTuple):
    """A stream and what it is made of.

    Attributes
    ----------
    data : bytes
        The file.
    slope : float
        Squared error (intensities from 0 to 1) that the last bit of a pixel was worth.
    header_bytes, picture_bytes, disparity_bytes : int
        Parts of the file; the first with lengths and checksums of layers.
    """

    data: bytes
    slope: float
    header_bytes: int
    picture_bytes: int
    disparity_bytes: int

    @property
    def disparity_share(self) -> float:
        """Share of the disparities in the file."""
        return self.disparity_bytes / len(self.data)


class ViewEncoder:
    """Encodes some views at any slope.

    Parameters
    ----------
    views : Views
        The pictures.
    labels : DisparityLabels
        Disparities to choose from, of single precision.
    method : DisparityMethod
        How they are coded.
    num_layers : int
        Quality layers.
    advance : callable
        Told 1 for each layer of a reference.
    """

    def __init__(
        self,
        views: Views,
        labels: DisparityLabels,
        method: DisparityMethod = DisparityMethod.L,
        num_layers: int = 1,
        advance: Callable[[int], None] = lambda _: None,
    ) -> None:
        check_memory(views.shape, labels.num_labels)
        exact = Header(views.shape, method, labels, views.references, num_layers, views.viewpoints)
        self.header, _ = decode_header(encode_header(exact))
        self.views, self.advance = views, advance
        self.codec: DisparityCodec = METHODS[method.name.lower()]
        self.codes = [reference_codec.encode(views.pictures[index]) for index in views.references]

    def encode(self, slope: float) -> Encoded:
        """Encode all layers.

        Parameters
        ----------
        slope : float
            Of the last layer: squared error, intensities from 0 to 1, that a bit per pixel is worth.

        Returns
        -------
        Encoded
            The stream.
        """
        slopes = layer_slopes(slope, self.header.num_layers)
        by_pair = [self._pair_layers(index, code, slopes) for index, code in enumerate(self.codes)]
        layers: list[Layer] = list(zip(*by_pair, strict=True))
        data = encode_stream(self.header, layers)
        picture, disparity = (sum(len(pair[part]) for layer in layers for pair in layer) for part in (0, 1))
        return Encoded(data, slope, len(data) - picture - disparity, picture, disparity)

    def likely_slope(self, num_bytes: int) -> float:
        """Return about the slope at which a stream has some length, without encoding one.

        Parameters
        ----------
        num_bytes : int
            The length.

        Returns
        -------
        float
            Where the pictures alone take `PICTURE_SHARE` of it.
        """
        low, high = (math.log(slope) for slope in LIKELY_SLOPES)
        for _ in range(SLOPE_STEPS):
            middle = math.exp(0.5 * (low + high))
            if sum(code.bytes_at_slope(middle) for code in self.codes) > PICTURE_SHARE * num_bytes:
                low = math.log(middle)
            else:
                high = math.log(middle)
        return math.exp(high)

    def _pair_layers(self, index: int, code: ReferenceCode, slopes: Sequence[float]) -> list[PairLayer]:
        """All layers of one picture and its disparities."""
        layers, done, previous = [], 0, None
        for slope in slopes:
            header, data = code.cut(max(code.bytes_at_slope(slope), done))
            decoded = reference_codec.decode(header, data, self.header.shape)
            classes = significance_classes(decoded)
            tensor = self._tensor(index, decoded)
            previous = previous if self.codec.layered else None
            distortion = self._distortion(index, decoded.picture())
            found: Any = self.codec.optimise(tensor, slope, classes, previous, distortion)
            disparity = self.codec.encode(found, classes, previous)
            layers.append(PairLayer(header.to_bytes() + data[done:], disparity))
            done, previous = len(data), found
            self.advance(1)
        return layers

    def _distortion(self, index: int, picture: Picture) -> ForwardErrors:
        """What maps of labels cause where views are rendered forward (3.5)."""
        reference = self.header.references[index]
        others = self.views.predicted_from(reference)
        views = [(self.views.pictures[other], self.header.viewpoints[other]) for other in others]
        return ForwardErrors(picture, self.header.viewpoints[reference], self.header.labels, views)

    def _tensor(self, index: int, decoded: DecodedReference) -> Tensor:
        """Errors of the views that are predicted from one reference (3.31)."""
        reference = self.header.references[index]
        others = self.views.predicted_from(reference)
        viewpoints = self.header.viewpoints
        warps = [warp_between(viewpoints[reference], viewpoints[other]) for other in others]
        pictures = [self.views.pictures[other] / 255.0 for other in others]
        labels = self.header.labels
        inverse_depths = labels.disparity(np.arange(labels.num_labels, dtype=np.float64))
        return error_tensor(decoded.picture() / 255.0, pictures, warps, inverse_depths)


def layer_slopes(slope: float, num_layers: int) -> list[float]:
    """Return the slopes of all quality layers.

    Parameters
    ----------
    slope : float
        Of the last one.
    num_layers : int
        How many there are.

    Returns
    -------
    list of float
        In equal ratios: the first is the steepest.
    """
    ratio = min(MAX_SLOPE_RATIO, SLOPE_RANGE ** (1.0 / max(num_layers - 1, 1)))
    return [slope * ratio**step for step in range(num_layers - 1, -1, -1)]
