"""State of a Wyner-Ziv frame during decoding: intervals, prediction, noise; choice of its next bits."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter

from decoder.side_information.protocol import Prediction
from decoder.side_information.synthesis import fuse
from dvc.arrays import Bytes, Floats, Integers, Mask
from dvc.slepian_wolf import MAX_RUN_BITS, PlaneCost
from dvc.video import Frame
from dvc.wynerziv import noise, quantizer, transform
from dvc.wynerziv.areas import Areas
from dvc.wynerziv.noise import Refinement, expected_refinement
from dvc.wynerziv.priors import LearnedPriors
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

    def reconstruct(self, side_information: Floats) -> Floats:
        """Return the conditional mean of each coefficient."""
        return noise.conditional_mean(self.lower, self.upper, side_information, self.scale)

    def error(self, reconstructed: Floats, side_information: Floats) -> Floats:
        """Return the expected magnitude of truth minus prediction, relative to its mean."""
        floor = ERROR_FLOOR * np.minimum(self.upper - self.lower, 4.0 * self.scale)
        error: Floats = np.abs(reconstructed - side_information) + floor
        return error / float(error.mean())


class FrameState:
    """State of the frame: noise model, known bands, and the parts of the prediction that are used again."""

    def __init__(self, layout: FrameLayout, prediction: Prediction, model: str) -> None:
        self._layout = layout
        self._model = model
        self.known: dict[int, KnownBand] = {}
        self._activity: dict[int, Floats] = {}  # smoothed errors of known bands with this prediction
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
        stack = np.stack(prediction.compensated)  # of many references, the most different ones count
        differs = stack[0] - stack[1] if len(stack) == 2 else stack.max(axis=0) - stack.min(axis=0)
        self.base_scale = noise.MODELS[model](transform.forward(0.5 * differs))

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
        for other, known in self.known.items():
            if other not in self._activity:
                error = known.error(self.bands[other], self.predicted[other])
                self._activity[other] = 0.5 * error + 0.5 * uniform_filter(error, 3, mode="nearest")
            activity += self._activity[other]
        local = np.sqrt(base * base.mean() * (activity / len(self.known)))
        return noise.shaped(local, texture, None)

    def set_known(self, band: int, known: KnownBand) -> None:
        """Enter a band that has been decoded."""
        self.known[band] = known
        self._activity.pop(band, None)
        self.bands[band] = known.reconstruct(self.predicted[band])

    def dc_error(self) -> Floats | None:
        """Return by how much the DC band is off its prediction, once it is known."""
        error: Floats = self.bands[0] - self.predicted[0]
        return error if 0 in self.known else None

    def refine(self) -> None:
        """Refine the side information by the decoded bands, if its method can."""
        if self._refiner is not None and self.known:
            self.use(self._refiner.refine(self.luma()))

    def luma(self, bands: Floats | None = None) -> Bytes:
        """Return the frame of some bands, by default of those decoded up to now."""
        bands = self.bands if bands is None else bands
        return transform.to_uint8(transform.inverse(bands, self._layout.height, self._layout.width))

    def frame(self) -> Frame:
        """Return the frame with the chroma that is predicted."""
        return Frame(self.luma(), self._chroma if self._refiner is None else self._refiner.chroma())


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
        return KnownBand(*(values.reshape(self.shape) for values in (self.lower, self.upper, self.noise)))

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


CLASSES = (range(1), range(1, 3), range(3, 6), range(6, 16))
"""Bands that turn out alike, in zigzag order."""
MAX_WIDTH = 6
"""Largest width class of bins, in powers of two of steps; wider bins share it."""
STRENGTH_BITS = 60.0
"""Bits of a class beyond which experience counts more than the noise model; with 150 the rate is .4 % higher,
with 20 it is .1 % lower (see `decoder.frame_state.NEIGHBOURS`)."""


@dataclass
class Learned:
    """Experience with the frames of a group: priors, and expected and real savings and costs of planes."""

    priors: LearnedPriors
    # By classes of bands and widths of bins, expected, then seen: squared error, bits.
    worth: Floats = field(default_factory=lambda: np.zeros((len(CLASSES), MAX_WIDTH + 1, 2, 2)))

    def factors(self, band: int, width: int, multiplier: float) -> tuple[float, float]:
        """Return the factors on expected savings and bits of a band; `width` of its bins: see `learn`."""
        (expected, expected_bits), (seen, bits) = self._worth_of(band, width)
        strength = STRENGTH_BITS * multiplier
        return (
            float((seen + strength) / (expected + strength)),
            float((bits + STRENGTH_BITS) / (expected_bits + STRENGTH_BITS)),
        )

    def learn(self, band: int, width: int, expected: tuple[float, float], seen: tuple[float, float]) -> None:
        """Learn from a plane with bins of two to the power of `width` steps."""
        self._worth_of(band, width)[:] += expected, seen

    def _worth_of(self, band: int, width: int) -> Floats:
        (number,) = (number for number, bands in enumerate(CLASSES) if band in bands)
        return np.asarray(self.worth[number, min(width, MAX_WIDTH)])

    def copy(self) -> "Learned":
        """Return the same, to be learned from by one frame."""
        return Learned(LearnedPriors.mean([self.priors]), self.worth.copy())

    def joined(self, several: Sequence["Learned"]) -> "Learned":
        """Return the state after all copies of this have learned in parallel."""
        worth = self.worth.copy()
        for other in several:
            worth += other.worth - self.worth
        return Learned(LearnedPriors.mean([other.priors for other in several]), worth)


LOOK_AHEAD = 2
"""Number of planes of a band that are judged together before the next is skipped."""
LEAST_RUN_BITS, LEAST_PART_BITS = 8.0, 2.0
"""Least savings of a run, and of each plane in it, beyond the expected cost."""
NEIGHBOURS = 0.5
"""Weight of the 3x3 areas around one in its smoothed gain; 0 takes .2 % more rate. By
`benchmarks.searches.settings decoder.frame_state.NEIGHBOURS=0 --qp 28 36 --frames 33 --clips box desk river
stone street tree`, as were `decoder.frame_state.STRENGTH_BITS` and
`dvc.wynerziv.noise.REFINEMENT_OUTLIER_PROBABILITY`."""


class Wanted(NamedTuple):
    """A plane with requested bits."""

    band: Band
    blocks: Integers
    expected: tuple[float, float]  # squared error that it takes off by the noise model, and bits


class Choice(NamedTuple):
    """Planes that are requested together, in the same areas."""

    wanted: list[Wanted]
    planes: tuple[int, ...]  # their numbers in the frame
    areas: bytes
    bits: float  # that it is expected to cost


class Asking:
    """Chooses planes that are worth their rate, by the learned factors."""

    def __init__(self, areas: Areas, learned: Learned, cost: PlaneCost, multiplier: float) -> None:
        self._areas, self._learned, self._cost, self._multiplier = areas, learned, cost, multiplier

    def whole_planes(self, bands: Sequence[Band], missing: int) -> list[Choice]:
        """Choose planes of all blocks, a run each, if the next one, or the next few together, save enough."""
        choices = []
        for band in bands:
            worth = band.worth(missing, min(missing + 1, LOOK_AHEAD))
            saved = worth.saved.sum(axis=1)
            costs = [self._cost.bits(bits, planes) for planes, bits in enumerate(worth.bits.sum(axis=1), 1)]
            if self._multiplier == 0 or np.any(saved > self._multiplier * np.array(costs)):
                wanted = Wanted(band, band.open, (float(saved[0]), costs[0]))
                choices += _runs([wanted], missing, b"", 0.0)
        return choices

    def by_areas(self, bands: Sequence[Band], missing: int) -> list[Choice]:
        """Choose planes in the areas with enough savings, all in one run."""
        if self._multiplier == 0:
            return _runs([Wanted(band, band.open, (0.0, 0.0)) for band in bands], missing, b"", 0.0)
        worths = [band.worth(missing, min(missing + 1, LOOK_AHEAD)) for band in bands]
        gains = []
        for band, worth in zip(bands, worths, strict=True):
            saved, bits = self._learned.factors(band.number, missing, self._multiplier)
            bit = self._multiplier * self._cost.per_ideal_bit * bits
            gain = self._areas.sums(band.open, (saved * worth.saved - bit * worth.bits).max(axis=0))
            # Errors are never isolated.
            around = uniform_filter(gain.reshape(self._areas.shape), 3, mode="nearest").ravel()
            gains.append((1.0 - NEIGHBOURS) * gain + NEIGHBOURS * around)
        chosen, areas = self._worthwhile(gains)
        if not chosen:
            return []
        wanted = []
        for number in chosen:
            band, worth = bands[number], worths[number]
            inside = areas[self._areas.of_blocks[band.open]]
            cost = self._cost.per_ideal_bit * float(worth.bits[0, inside].sum())
            wanted.append(Wanted(band, band.open[inside], (float(worth.saved[0, inside].sum()), cost)))
        return _runs(wanted, missing, self._areas.coded(areas), self._cost.per_plane)

    def _worthwhile(self, gains: list[Floats]) -> tuple[list[int], Mask]:
        """Choose bands and areas such that each band gains in these areas, and each area by these bands."""
        least = LEAST_PART_BITS * self._multiplier
        chosen = [number for number, gain in enumerate(gains) if np.maximum(gain, 0.0).sum() > least]
        while chosen:
            areas = np.sum([gains[number] for number in chosen], axis=0) > 0.0
            sums = [float(gains[number][areas].sum()) for number in chosen]
            if min(sums) > least:
                enough = sum(sums) > LEAST_RUN_BITS * self._multiplier
                return (chosen, areas) if enough else ([], areas)
            del chosen[int(np.argmin(sums))]
        return [], np.zeros(self._areas.count, np.bool_)


def _runs(wanted: Sequence[Wanted], missing: int, areas: bytes, per_run: float) -> list[Choice]:
    """Divide planes into as few runs as possible."""
    runs: list[list[Wanted]] = [[]]
    for plane in wanted:
        if runs[-1] and sum(other.blocks.size for other in (*runs[-1], plane)) > MAX_RUN_BITS:
            runs.append([])
        runs[-1].append(plane)
    choices = []
    for run in runs:
        planes = tuple(plane.band.first_plane + plane.band.place(missing)[1] for plane in run)
        choices.append(Choice(run, planes, areas, per_run + sum(plane.expected[1] for plane in run)))
    return choices
