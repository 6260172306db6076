"""State of a Wyner-Ziv frame during decoding: decoded intervals, prediction and noise."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter

from decoder.side_information.protocol import Prediction
from decoder.side_information.weighting import fuse
from dvc.arrays import Bytes, Floats, Integers
from dvc.video import Frame
from dvc.wynerziv import noise, quantizer, transform
from dvc.wynerziv.noise import Refinement, expected_refinement
from dvc.wynerziv.quantizer import FrameLayout, Quantization

INITIAL_GAIN = 1.3
"""Factor on the scale of the correlation noise before anything of a frame is decoded."""
ERROR_FLOOR = 0.15
"""Share of the bin width that counts as error even if the reconstruction agrees with the prediction."""


@dataclass
class KnownBand:
    """Decoded intervals of a band."""

    lower: Floats  # borders of the interval of each coefficient
    upper: Floats
    scale: Floats  # scale of the Laplacian about its prediction

    @classmethod
    def of(cls, lower: Floats, upper: Floats, scale: Floats, shape: tuple[int, int]) -> "KnownBand":
        """Return the state of a band with coefficients in raster order."""
        return cls(lower.reshape(shape), upper.reshape(shape), scale.reshape(shape))

    def reconstruct(self, side_information: Floats) -> Floats:
        """Return the conditional mean of each coefficient."""
        return noise.conditional_mean(self.lower, self.upper, side_information, self.scale)

    def error(self, reconstructed: Floats, side_information: Floats) -> Floats:
        """Return the expected magnitude of truth minus prediction, relative to its mean."""
        floor = ERROR_FLOOR * np.minimum(self.upper - self.lower, 4.0 * self.scale)
        error: Floats = np.abs(reconstructed - side_information) + floor
        return error / float(error.mean())


class FrameState:
    """State of the frame: prediction, noise model, known bands.

    Only the parts of the prediction that are used again are kept: all of it would double the memory.
    """

    def __init__(self, layout: FrameLayout, prediction: Prediction, model: str) -> None:
        self._layout = layout
        self._model = model
        self.known: dict[int, KnownBand] = {}
        self._activity: dict[int, Floats] = {}
        self.gain = INITIAL_GAIN
        self._first = [transform.forward(luma) for luma in (prediction.luma, *prediction.alternatives)]
        self.expected_error = None
        if prediction.expected_error is not None:
            self.expected_error = np.maximum(transform.forward(prediction.expected_error)[0], noise.MIN_SCALE)
        self.method, self.reason = prediction.method, prediction.reason
        self.side_information = transform.to_uint8(prediction.luma)
        self.camera, self.inverse_depth = prediction.camera, None
        if prediction.inverse_depth is not None:
            self.inverse_depth = prediction.inverse_depth.astype(np.float16)
        self._chroma, self._refiner = prediction.chroma, prediction.refiner
        self.predicted = self._first[0]
        self.bands = self.predicted.copy()
        self.base_scale = noise.MODELS[model](transform.forward(_disagreement(prediction)))

    def use(self, prediction: Prediction) -> None:
        """Fuse new side information with the first, and reconstruct the known bands again with it."""
        lumas = (*prediction.compensated, prediction.luma)
        hypotheses = np.stack(self._first + [transform.forward(luma) for luma in lumas])
        self.predicted, spread = fuse(hypotheses, {band: self.bands[band] for band in self.known})
        self.base_scale = noise.MODELS[self._model](spread)
        self._refiner = prediction.refiner
        self.bands = self.predicted.copy()
        self._activity.clear()
        for band, known in self.known.items():
            self.bands[band] = known.reconstruct(self.predicted[band])

    def scale(self, band: int) -> Floats:
        """Return the scale of each coefficient of a band before any of it is decoded."""
        base: Floats = self.base_scale[band]
        texture = noise.texture(self.predicted, band)
        if not self.known:
            return noise.shaped(base, texture, self.expected_error)
        activity = np.zeros_like(base)
        for other in self.known:
            activity += self._activity_of(other)
        local = np.sqrt(base * base.mean() * (activity / len(self.known)))
        return noise.shaped(local, texture, None)

    def _activity_of(self, band: int) -> Floats:
        """Return the errors of a known band, smoothed; found once for each prediction."""
        if band not in self._activity:
            error = self.known[band].error(self.bands[band], self.predicted[band])
            self._activity[band] = _smoothed(error)
        return self._activity[band]

    def set_known(self, band: int, known: KnownBand) -> None:
        """Enter a band that has been decoded."""
        self.known[band] = known
        self._activity.pop(band, None)
        self.bands[band] = known.reconstruct(self.predicted[band])

    def dc_error(self) -> Floats | None:
        """Return by how much the DC band is off its prediction, once it is known."""
        error: Floats = self.bands[0] - self.predicted[0]
        return error if 0 in self.known else None

    def correct(self, band: int, lower: Floats, upper: Floats) -> None:
        """Change the intervals of a band that is known."""
        self.set_known(band, KnownBand.of(lower, upper, self.known[band].scale, self._layout.band_shape))

    def refine(self) -> None:
        """Refine the side information by the decoded bands, if its method can."""
        if self._refiner is not None and self.known:
            self.use(self._refiner.refine(self.luma()))

    def refine_by_part(self, band: int, part: KnownBand) -> None:
        """Refine the side information by a band with missing planes."""
        self.set_known(band, part)
        self.refine()
        del self.known[band]

    def luma(self) -> Bytes:
        """Return the frame decoded so far."""
        return self._samples(self.bands)

    def refined_side_information(self) -> Bytes:
        """Return the latest prediction."""
        return self._samples(self.predicted)

    def _samples(self, bands: Floats) -> Bytes:
        return transform.to_uint8(transform.inverse(bands, self._layout.height, self._layout.width))

    def frame(self) -> Frame:
        """Return the frame with the chroma that is predicted."""
        return Frame(self.luma(), self._chroma if self._refiner is None else self._refiner.chroma())


def _smoothed(error: Floats) -> Floats:
    neighbourhood: Floats = uniform_filter(error, 3, mode="nearest")
    return 0.5 * error + 0.5 * neighbourhood


def _disagreement(prediction: Prediction) -> Floats:
    """Return half the difference of the compensated references; of the two most different if many."""
    stack = np.stack(prediction.compensated)
    difference: Floats = stack[0] - stack[1] if len(stack) == 2 else stack.max(axis=0) - stack.min(axis=0)
    return 0.5 * difference


NUM_FITTED_PLANES = 5
"""Number of planes of a band after which the scale is fitted again; later planes add little."""


@dataclass
class Band:
    """State of a band; the planes of a block are decoded one after the other."""

    number: int  # in zigzag order
    num_planes: int
    first_plane: int  # number of its first plane in the frame
    edges: Floats
    predicted: Floats
    scale: Floats
    gain: float  # factor on the scale of the noise
    start_gain: float
    shape: tuple[int, int]
    prefix: Integers
    depth: Integers  # planes that are known of each coefficient
    open: Integers  # blocks with planes that may still be requested
    lower: Floats
    upper: Floats
    num_taken: int = 0  # number of planes with received bits

    @classmethod
    def start(cls, number: int, quantization: Quantization, state: FrameState) -> "Band":
        """Begin a band."""
        predicted = state.predicted[number]
        count, planes, edges = predicted.size, quantization.planes[number], quantization.edges(number)
        prefix, depth = np.zeros(count, np.int64), np.zeros(count, np.int64)
        lower, upper = quantizer.prefix_borders(prefix, planes, edges)
        scale, blocks = state.scale(number).ravel(), np.arange(count)
        return cls(
            number, planes, quantization.first_plane[number], edges, predicted.ravel(), scale, state.gain,
            state.gain, predicted.shape, prefix, depth, blocks, lower, upper,
        )  # fmt: skip

    @property
    def known(self) -> KnownBand:
        """Decoded intervals of the band."""
        return KnownBand.of(self.lower, self.upper, self.noise, self.shape)

    @property
    def noise(self) -> Floats:
        """Scale of the noise of each coefficient."""
        return self.scale * self.gain

    def place(self, missing: int) -> tuple[int, int]:
        """Return the number of the band, and that of the plane in it that leaves `missing` planes."""
        return self.number, self.num_planes - missing - 1

    def worth(self, missing: int, depth: int) -> Refinement:
        """Return the expected cost and savings of the next planes of open blocks."""
        blocks = self.open
        return expected_refinement(
            self.prefix[blocks], missing + 1, self.edges, self.predicted[blocks], self.noise[blocks], depth
        )

    def borders(self, missing: int) -> tuple[Floats, Floats, Floats]:
        """Return the intervals of coefficients, and the points where the next plane divides them."""
        middle, _ = quantizer.prefix_borders(2 * self.prefix + 1, missing, self.edges)
        return self.lower, middle, self.upper

    def take(self, blocks: Integers, bits: Bytes, missing: int) -> float:
        """Take in decoded bits of a plane; return the squared error that they have taken off."""
        predicted, noise_scale = self.predicted[blocks], self.noise[blocks]
        before = noise.conditional_mean(self.lower[blocks], self.upper[blocks], predicted, noise_scale)
        self.num_taken += 1
        self.open = blocks
        self.enter(blocks, bits)
        after = noise.conditional_mean(self.lower[blocks], self.upper[blocks], predicted, noise_scale)
        if self.place(missing)[1] < NUM_FITTED_PLANES or missing == 0:
            self.fit(self.gain if missing else self.start_gain)
        return float(np.sum((after - before) ** 2))

    def enter(self, blocks: Integers, bits: Bytes) -> None:
        """Make the intervals of some blocks half as wide."""
        self.prefix[blocks] = 2 * self.prefix[blocks] + bits
        self.depth[blocks] += 1
        missing = self.num_planes - self.depth[blocks]
        self.lower[blocks], self.upper[blocks] = quantizer.prefix_borders(
            self.prefix[blocks], missing, self.edges
        )

    def fit(self, expected: float) -> None:
        """Fit the scale of the noise to the decoded intervals."""
        self.gain = noise.fit_gain(self.lower, self.upper, self.predicted, self.scale, expected)

    def predict(self, state: FrameState) -> None:
        """Continue with the current prediction."""
        self.predicted, self.scale = state.predicted[self.number].ravel(), state.scale(self.number).ravel()
        self.fit(self.gain)

    def forget(self) -> None:
        """Reset the intervals, to enter all planes again."""
        self.prefix[:] = self.depth[:] = 0
        self.lower, self.upper = quantizer.prefix_borders(self.prefix, self.num_planes, self.edges)
