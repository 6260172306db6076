"""Needs of streams without feedback, fitted to frames whose planes were known while they were decoded.

``python -m benchmarks.searches.rate_needs box cube desk river stone tree --qp 26 32`` prints `NEEDS` of
`encoder.rate_control.needs`, and how far from them the frames of each clip are.
"""

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, nnls

from benchmarks.results.harness import clip_source
from decoder.frame_state import FrameState, KnownBand
from decoder.group import GroupDecoder
from decoder.no_feedback import NoFeedbackDecoder
from decoder.session import stream_tasks
from decoder.side_information.protocol import Prediction
from decoder.tasks import DecodedFrame
from dvc.config import NUM_BANDS, CodecConfig
from dvc.stream import StreamReader, StreamWriter
from dvc.video import open_video
from dvc.wynerziv import noise, quantizer, transform
from dvc.wynerziv.learned_scales import LearnedBand
from dvc.wynerziv.no_feedback import BLOCKS
from dvc.wynerziv.payloads import EncodedFrame
from encoder import options
from encoder.rate_control.controller import RateController
from encoder.rate_control.needs import NEEDS, OCTAVES, Needs
from encoder.rate_control.sampled_blocks import BlockErrors

Floats = NDArray[np.float64]

LEARNING_STEPS = 3
MULTIPLIERS = 0.5, 1.0, 2.0
"""What a bit must save, over what is usual, for planes to be among those that needs are fitted to."""
_ROBUST = 0.2  # logarithm of bits; what is farther off counts less
_LEAST_BITS = 100.0
_SMOOTH = 0.02  # weight of second differences of bits


@dataclass(eq=False)
class RecordedFrame:
    """What was expected of a frame, and what was found."""

    clip: str  # its sequence
    config: CodecConfig  # configuration of the stream
    encoded: EncodedFrame  # its planes
    luma: NDArray[np.uint8]  # luma before coding
    distance: int  # how far its references are apart
    errors: BlockErrors  # what the encoder expects
    # ideal code length of each band by planes that are coded, and squared error that is left
    bits: dict[int, Floats]
    squares: dict[int, Floats]

    @property
    def multiplier(self) -> float:
        """Squared error that a bit must save."""
        return self.encoded.quantization.multiplier


class KnowingDecoder(NoFeedbackDecoder):
    """Decodes frames whose planes it knows, as many as pay, and records what all would have cost."""

    def __init__(self, config: CodecConfig, known: dict[int, RecordedFrame]) -> None:
        super().__init__(config)
        self._known = known

    def decode(self, index: int, payload: bytes, prediction: Prediction) -> DecodedFrame:
        """Decode one frame; see `NoFeedbackDecoder.decode`."""
        settings = self._config.wyner_ziv
        record = self._known[index]
        state = FrameState(self._layout, prediction, settings.noise_model)
        truth = transform.forward(record.luma)
        for block in BLOCKS:
            bands = [band for band in block if record.encoded.quantization.planes[band]]
            found = {band: _costs(record, band, state, truth[band]) for band in bands}
            for band, known in found.items():
                if known is not None:
                    state.set_known(band, known)
            state.refine()
        first, last = state.side_information, state.refined_side_information()
        return DecodedFrame(index, state.frame(), first, last, state.method, state.reason, 0, 0, 0, 0, 0)


def _costs(record: RecordedFrame, band: int, state: FrameState, truth: Floats) -> KnownBand | None:
    """Record what the planes of a band cost and leave; return what those that pay tell of it."""
    quantization = record.encoded.quantization
    planes, edges = quantization.planes[band], quantization.edges(band)
    numbers = quantizer.from_planes(_planes(record.encoded, band))
    predicted, scale = state.predicted[band], state.scale(band)
    bits, squares = np.zeros(planes + 1), np.empty(planes + 1)
    squares[0] = ((truth - predicted) ** 2).sum()
    best, least = None, float(squares[0])
    for depth in range(1, planes + 1):
        prefix = numbers >> (planes - depth)
        lower, upper = quantizer.prefix_borders(prefix, planes - depth, edges)
        gain = noise.fit_gain(lower, upper, predicted.ravel(), scale.ravel(), state.gain)
        known = KnownBand.of(lower, upper, scale.ravel() * gain, predicted.shape)
        squares[depth] = ((truth - known.reconstruct(predicted)) ** 2).sum()
        learned = LearnedBand(edges, planes, depth, predicted, scale, scale * state.gain)
        bits[depth] = _learned_bits(learned, prefix)
        cost = squares[depth] + 1.25 * record.multiplier * bits[depth]
        if cost < least:
            best, least = known, cost
    record.bits[band], record.squares[band] = bits, squares
    return best


def _planes(frame: EncodedFrame, band: int) -> NDArray[np.uint8]:
    """Return the planes of a band; shape (planes, N)."""
    chosen = frame.quantization.first_plane[band] + np.arange(frame.quantization.planes[band])
    shifts = (63 - chosen % 64).astype(np.uint64)
    return ((frame.words[chosen // 64] >> shifts[:, None]) & np.uint64(1)).astype(np.uint8)


def _learned_bits(band: LearnedBand, numbers: NDArray[np.int64]) -> float:
    """Return the ideal code length of numbers by the scales that they themselves would teach."""
    for _ in range(LEARNING_STEPS):
        priors = band.priors()
        places = numbers - priors.lowest
        among = (places >= 0) & (places < priors.counts)
        believed = np.where(among[:, None], np.float32(0.0), priors.probabilities)
        believed[np.flatnonzero(among), places[among]] = 1.0
        band = band.learn(priors, believed)
    return band.priors().ideal_bits(numbers)


def record(clip: str, qp: int, num_frames: int) -> list[RecordedFrame]:
    """Encode and decode a clip, all planes known."""
    source = clip_source(clip).path
    known: dict[int, RecordedFrame] = {}
    arguments = options.parser().parse_args(
        [str(source), "-", "--qp", str(qp), "--no-feedback", "--luma-only"]
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "stream.dvc"
        with open_video(source) as video, path.open("wb") as file:
            session = options.session(arguments, video.info)
            config, encoder, first = session.config, RateController(session.config, 0), 0
            with StreamWriter(file, config, "no-feedback") as writer:
                for group in session.groups(islice(video, num_frames)):
                    encoded = session.encode(group)
                    plan = encoder.plan(group, encoded.frames)
                    encoder.go_on(plan)
                    for index, distance, errors, _ in plan.chosen:
                        luma, frame = (*group.wyner_ziv, group.key)[index].luma, encoded.frames[index]
                        frame.pack(NUM_BANDS)  # its coefficients are those of another one in the next group
                        known[first + index] = RecordedFrame(
                            clip, config, frame, luma, distance, errors, {}, {}
                        )
                    writer.write_gop(encoded.record)
                    first += encoded.record.num_frames
        decoder = GroupDecoder(config, no_feedback=KnowingDecoder(config, known))
        with StreamReader(path) as reader:
            for task in stream_tasks(config, reader):
                decoder.decode(task)
    return list(known.values())


def fit(frames: Sequence[RecordedFrame], block: int) -> tuple[Needs, dict[str, Floats]]:
    """Fit the needs of a block."""
    counts = {clip: sum(frame.clip == clip for frame in frames) for clip in {frame.clip for frame in frames}}
    variance = _fit_variance(frames, np.array([1.0 / counts[frame.clip] for frame in frames]), block)
    samples = [sample for frame in frames for sample in _samples(frame, block)]
    names = np.array([frame.clip for frame, _ in samples])
    bits = np.array(
        [sum(frame.bits[band][depth] for band, depth in depths.items()) for frame, depths in samples]
    )
    design = np.stack([_design(frame, depths, variance) for frame, depths in samples])
    curve, deviations = _fit_bits(design, bits, np.array([1.0 / (names == name).sum() for name in names]))
    needs = Needs(variance, tuple(round(value, 3) for value in curve.tolist()))
    return needs, {clip: deviations[names == clip] for clip in sorted(counts)}


def _samples(frame: RecordedFrame, block: int) -> list[tuple[RecordedFrame, dict[int, int]]]:
    """Return planes of a block by bands: the finest of DC, others that pay at several multipliers."""
    if len(BLOCKS[block]) == 1:
        (band,) = BLOCKS[block]
        planes = frame.encoded.quantization.planes[band]
        return [(frame, {band: depth}) for depth in range(max(planes - 2, 1), planes + 1)]
    found: list[dict[int, int]] = []
    for factor in MULTIPLIERS:
        depths = {}
        for band in BLOCKS[block]:
            if band in frame.bits:
                depth = int((frame.squares[band] + factor * frame.multiplier * frame.bits[band]).argmin())
                if depth:
                    depths[band] = depth
        if depths and depths not in found:
            found.append(depths)
    return [(frame, depths) for depths in found]


def _design(frame: RecordedFrame, depths: dict[int, int], variance: tuple[float, float, float]) -> Floats:
    """Return how many coefficients there are at each of `OCTAVES`, shared out between the nearest two."""
    quantization, total = frame.encoded.quantization, np.zeros(len(OCTAVES))
    size, step = frame.encoded.layout.num_bits, quantization.step(0)
    assert step is not None
    apart = OCTAVES[1] - OCTAVES[0]
    for band, depth in depths.items():
        squares = (
            variance[0] * frame.errors.residual[band] + variance[1] * frame.errors.noise[band] + variance[2]
        )
        width = step * 2.0 ** (quantization.planes[band] - depth)
        place = np.clip((np.log2(squares / width**2) - OCTAVES[0]) / apart, 0.0, len(OCTAVES) - 1.001)
        lower = place.astype(np.int64)
        share = place - lower
        counts = np.bincount(lower, 1.0 - share, len(OCTAVES)) + np.bincount(lower + 1, share, len(OCTAVES))
        total += size / squares.size * counts
    return total


def _fit_bits(design: Floats, bits: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Fit a curve that does not fall; return it, and logarithms of what it is off, none on the mean."""
    count = design.shape[1]
    rising = np.tril(np.ones((count, count)))
    bend = np.diff(np.eye(count), 2, axis=0) @ rising
    errors, shares = np.zeros(bits.size), weights / weights.sum()
    for _ in range(8):
        robust = np.sqrt(shares / np.hypot(1.0, errors / _ROBUST)) / (bits + _LEAST_BITS)
        rows = np.vstack([robust[:, None] * (design @ rising), _SMOOTH * bend])
        steps, _ = nnls(rows, np.concatenate([robust * bits, np.zeros(count - 2)]))
        errors = np.log((design @ rising @ steps + _LEAST_BITS) / (bits + _LEAST_BITS))
    off = float(shares @ errors)
    curve: Floats = rising @ steps * np.exp(-off)
    return curve, errors - off


def _fit_variance(frames: Sequence[RecordedFrame], weights: Floats, block: int) -> tuple[float, float, float]:
    """Fit shares of residual and noise to the squared error before anything is sent."""
    added = NEEDS[block].variance[2]
    rows = [
        (weight, frame.errors.residual[band].mean(), frame.errors.noise[band].mean(), squares[0])
        for frame, weight in zip(frames, weights, strict=True)
        for band, squares in frame.squares.items()
        if band in BLOCKS[block]
    ]
    weight, residual, noises, squares = np.array(rows).T
    true = squares / frames[0].encoded.layout.num_bits + added

    def _loss(logarithms: Floats) -> float:
        expected = np.exp(logarithms[0]) * residual + np.exp(logarithms[1]) * noises + added
        return float((weight * np.hypot(1.0, np.log(expected / true) / 0.3)).sum())

    shares = np.exp(minimize(_loss, [-0.7, 0.0], method="Nelder-Mead").x)
    return float(shares[0]), float(shares[1]), added


def main() -> None:
    """Print needs that fit clips."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("clips", nargs="+", help="names of the catalogue")
    parser.add_argument("--qp", nargs="+", type=int, default=[26, 32])
    parser.add_argument("--frames", type=int, default=33)
    arguments = parser.parse_args()
    frames = []
    for clip in arguments.clips:
        for qp in arguments.qp:
            frames += record(clip, qp, arguments.frames)
            print(f"{clip}, QP {qp}: recorded", flush=True)
    for block in range(len(BLOCKS)):
        needs, deviations = fit(frames, block)
        print(needs)
        for clip, logs in deviations.items():
            print(f"  {clip}: {logs.mean():+.2f} ± {logs.std():.2f} ({logs.size} frames)")


if __name__ == "__main__":
    main()
