"""Decoding of one Wyner-Ziv frame of which an encoder without feedback has sent syndromes.

The planes of a block of bands are decoded together: DC first, which refines the prediction of the others. A
block whose syndrome is too short is concealed: what it makes likely serves in place of what it should tell,
and whatever is decoded later rests on that. So does one that has its syndrome but not its check, of which a
few bits are wrong.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from decoder.frame_state import FrameState, KnownBand
from decoder.side_information.protocol import Prediction
from decoder.tasks import BandCost, DecodedFrame
from dvc import slepian_wolf
from dvc.config import CodecConfig
from dvc.errors import BitstreamError
from dvc.slepian_wolf.ldpc.belief_propagation import DecodedBlock, NumberPriors, decode_block
from dvc.wynerziv import noise, quantizer
from dvc.wynerziv.candidates import credible_intervals
from dvc.wynerziv.learned_scales import LearnedBand
from dvc.wynerziv.no_feedback import BLOCKS, NoFeedbackFrame, SentBlock
from dvc.wynerziv.quantizer import FrameLayout

START_GAINS = 1.0, 1.6, 2.5, 4.0
"""Of the scales that a prediction promises, tried one after the other until a block is found: where they are
too small belief propagation does not come to learn that, where they are too large it does."""
Array = NDArray[np.float64]
Bits = NDArray[np.uint8]


class NoFeedbackDecoder:
    """Decodes Wyner-Ziv frames of the no-feedback form, of one configuration."""

    def __init__(self, config: CodecConfig) -> None:
        self._layout = FrameLayout.of(config)
        self._config = config

    def decode(self, index: int, payload: bytes, prediction: Prediction) -> DecodedFrame:
        """Decode one frame."""
        if not self._layout.embedded:
            raise BitstreamError("a no-feedback stream has embedded bins")
        settings = self._config.wyner_ziv
        received = NoFeedbackFrame.read(self._layout, payload, self._config.seed)
        state = FrameState(self._layout, prediction, settings.noise_model)
        num_failed, costs = 0, []
        for number, block in enumerate(received.blocks):
            if block is not None:
                cost = self._decode_block(number, block, received, state)
                num_failed += 0 if cost else len(block.graph.planes)
                costs += cost
                state.refine()
        num_sent = sum(len(block.graph.planes) for block in received.blocks if block is not None)
        return DecodedFrame(
            index=index,
            frame=state.frame(),
            side_information=state.side_information,
            refined_side_information=state.refined_side_information(),
            inverse_depth=state.inverse_depth,
            camera=state.camera,
            method=state.method,
            reason=state.reason,
            num_requests=0,
            crc_bits=received.check_bits,
            parity_bits=received.syndrome_bits,
            num_failed_planes=num_failed,
            num_skipped_planes=received.quantization.num_planes - num_sent,
            band_costs=tuple(costs),
            punctured=payload,
        )

    def _decode_block(
        self, number: int, block: SentBlock, received: NoFeedbackFrame, state: FrameState
    ) -> list[BandCost]:
        """Decode a block; return what its bands cost, or nothing where it is concealed."""
        quantization, depths = received.quantization, received.sent.depths
        bands = [band for band in BLOCKS[number] if depths[band]]
        scales = {band: state.scale(band) for band in bands}
        promised = [_promised(band, scales[band], received, state) for band in bands]
        decoded, priors, known = _decode(block, promised)
        ideal_bits, first = [], 0
        for place, (band, prior) in enumerate(zip(bands, priors, strict=True)):
            edges, planes = quantization.edges(band), quantization.planes[band]
            if decoded.success:
                prefix = quantizer.from_planes(decoded.bits[first : first + depths[band]])
                first += depths[band]
                ideal_bits.append(prior.ideal_bits(prefix))
                borders = quantizer.prefix_borders(prefix, planes - depths[band], edges)
            else:
                borders = credible_intervals(edges, planes, prior, decoded.beliefs[place])
            self._set_known(band, borders, scales[band].ravel(), state)
        if not known:
            return []
        share = (block.graph.num_checks + block.check.size) / max(sum(ideal_bits), 1.0)
        costs = zip(bands, ideal_bits, strict=True)
        return [BandCost(band, ideal, round(share * ideal)) for band, ideal in costs]

    def _set_known(self, band: int, borders: tuple[Array, Array], scale: Array, state: FrameState) -> None:
        lower, upper = borders
        gain = noise.fit_gain(lower, upper, state.predicted[band].ravel(), scale, state.gain)
        state.gain = float(np.sqrt(state.gain * gain))
        state.set_known(band, KnownBand.of(lower, upper, scale * gain, self._layout.band_shape))


def _promised(band: int, scale: Array, received: NoFeedbackFrame, state: FrameState) -> LearnedBand:
    """Return what is known of a band before any of it is decoded."""
    quantization = received.quantization
    return LearnedBand(
        quantization.edges(band),
        quantization.planes[band],
        received.sent.depths[band],
        state.predicted[band],
        scale,
        scale * state.gain,
    )


def _decode(block: SentBlock, promised: list[LearnedBand]) -> tuple[DecodedBlock, list[NumberPriors], bool]:
    """Decode the planes of a block, from one gain of the scales after the other until they have its check."""
    nearest = None
    for gain in START_GAINS:
        bands = [replace(band, scale=gain * band.scale) for band in promised]
        decoded, priors = _learning(block, bands)
        if decoded.success and _checks(decoded.bits, block):
            return decoded, priors, True
        if nearest is None or decoded.success > nearest[0].success:
            nearest = decoded, priors
    assert nearest is not None
    return *nearest, False


def _learning(block: SentBlock, bands: list[LearnedBand]) -> tuple[DecodedBlock, list[NumberPriors]]:
    """Decode the planes of a block while scales are learned; return also the last priors of its bands."""
    priors = [band.priors() for band in bands]

    def _learn(beliefs: Sequence[NDArray[np.float32]]) -> list[NumberPriors]:
        bands[:] = map(LearnedBand.learn, bands, priors, beliefs)
        priors[:] = [band.priors() for band in bands]
        return priors

    return decode_block(block.graph, block.syndrome, priors, _learn), priors


def _checks(bits: Bits, block: SentBlock) -> bool:
    """Tell whether the planes of a block have its check bits."""
    checks = slepian_wolf.joint_check(slepian_wolf.crc(bits, block.check.size))
    return np.array_equal(checks, block.check)
