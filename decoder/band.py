"""A band of a Wyner-Ziv frame while it is decoded: how deep each of its coefficients is known."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from decoder.frame_state import FrameState, KnownBand
from dvc.wynerziv import noise, quantizer
from dvc.wynerziv.quantizer import Quantization
from dvc.wynerziv.refinement import Refinement, expected_refinement

Array = NDArray[np.float64]
Bits = NDArray[np.uint8]
Blocks = NDArray[np.int64]

NUM_FITTED_PLANES = 5
"""Planes of a band after which the scale is fitted again; later planes tell little."""


@dataclass
class Band:
    """State of a band; the planes of a block are decoded one after the other."""

    number: int  # in zigzag order
    num_planes: int
    first_plane: int  # number of its first plane in the frame
    edges: Array
    predicted: Array
    scale: Array
    gain: float  # factor on the scale of the noise
    start_gain: float
    shape: tuple[int, int]
    prefix: NDArray[np.int64]
    depth: NDArray[np.int64]  # planes that are known of each coefficient
    open: Blocks  # blocks of which further planes may be asked for
    lower: Array
    upper: Array
    num_taken: int = 0  # planes of which bits were taken in

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
        """What is known of it."""
        return KnownBand.of(self.lower, self.upper, self.noise, self.shape)

    @property
    def noise(self) -> Array:
        """Scale of the noise of each coefficient."""
        return self.scale * self.gain

    def place(self, missing: int) -> tuple[int, int]:
        """Return the number of the band, and that in it of the plane behind which so many are missing."""
        return self.number, self.num_planes - missing - 1

    def worth(self, missing: int, depth: int) -> Refinement:
        """Return what the next planes of open blocks are expected to cost and to save."""
        blocks = self.open
        return expected_refinement(
            self.prefix[blocks], missing + 1, self.edges, self.predicted[blocks], self.noise[blocks], depth
        )

    def borders(self, missing: int) -> tuple[Array, Array, Array]:
        """Return the ends of the intervals of coefficients, and where the next plane divides those."""
        middle, _ = quantizer.prefix_borders(2 * self.prefix + 1, missing, self.edges)
        return self.lower, middle, self.upper

    def take(self, blocks: Blocks, bits: Bits, missing: int) -> float:
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

    def enter(self, blocks: Blocks, bits: Bits) -> None:
        """Make the intervals of some blocks half as wide."""
        self.prefix[blocks] = 2 * self.prefix[blocks] + bits
        self.depth[blocks] += 1
        missing = self.num_planes - self.depth[blocks]
        self.lower[blocks], self.upper[blocks] = quantizer.prefix_borders(
            self.prefix[blocks], missing, self.edges
        )

    def fit(self, expected: float) -> None:
        """Fit the scale of the noise to what is known."""
        self.gain = noise.fit_gain(self.lower, self.upper, self.predicted, self.scale, expected)

    def predict(self, state: FrameState) -> None:
        """Go on with the prediction that there is now."""
        self.predicted, self.scale = state.predicted[self.number].ravel(), state.scale(self.number).ravel()
        self.fit(self.gain)

    def forget(self) -> None:
        """Make the intervals as wide as they were, to enter all planes anew."""
        self.prefix[:] = self.depth[:] = 0
        self.lower, self.upper = quantizer.prefix_borders(self.prefix, self.num_planes, self.edges)
