"""What a group of pictures needs, by its own frames and tracks: what is sent, or a decoder will ask for."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.config import CodecConfig
from dvc.wynerziv.hierarchy import decoding_order
from dvc.wynerziv.lengths import length_of_code
from dvc.wynerziv.no_feedback import BLOCKS, SentPlanes, encode_payload, payload_bits
from dvc.wynerziv.payloads import EncodedFrame
from encoder.groups import Group
from encoder.rate_control.needs import Choice, NeedEstimator
from encoder.rate_control.sampled_blocks import (
    BlockErrors,
    BlockSampler,
    RateControlWork,
    Words,
    overlapping_words,
)


class _Reference(NamedTuple):
    """A frame that others are predicted from."""

    words: Words  # before coding
    noise: NDArray[np.float32]  # that coding adds


class ChosenFrame(NamedTuple):
    """What is sent of a frame, and why."""

    number: int  # among the Wyner-Ziv frames of its group
    distance: int  # from one of its references to the other
    errors: BlockErrors
    choice: Choice


class GroupPlan(NamedTuple):
    """What is to be sent of a group."""

    frames: tuple[EncodedFrame, ...]
    chosen: tuple[ChosenFrame, ...]  # in coding order
    last: _Reference  # its last frame

    def frame_bits(self) -> NDArray[np.float64]:
        """Return what each frame takes, in order of display."""
        bits = np.zeros(len(self.frames))
        for chosen in self.chosen:
            bits[chosen.number] = payload_bits(self.frames[chosen.number], chosen.choice.sent)
        return bits


class RateController:
    """Chooses and packs what is sent of Wyner-Ziv frames, group after group."""

    def __init__(self, config: CodecConfig, rate_margin_percent: int) -> None:
        self._config = config
        self._needs = NeedEstimator(config, rate_margin_percent)
        self._sampler = BlockSampler((config.video.height, config.video.width))
        self._key_step = 0.0 if config.key.lossless else quantizer_step(config.key.qp)
        self._before: _Reference | None = None

    @property
    def work(self) -> RateControlWork:
        """What there was to do so far."""
        return self._sampler.work

    def payloads(self, plan: "GroupPlan") -> tuple[bytes, ...]:
        """Pack the Wyner-Ziv frames of the next group as planned, and go on to the group after it."""
        payloads = [b""] * len(plan.frames)
        for chosen in plan.chosen:
            frame, sent = plan.frames[chosen.number], chosen.choice.sent
            payloads[chosen.number] = encode_payload(frame, sent, self._config.seed)
            self._count(sent, frame.layout.num_bits)
        self.go_on(plan)
        return tuple(payloads)

    def go_on(self, plan: "GroupPlan") -> None:
        """Go on to the group after the one that was planned."""
        self._before = plan.last

    def _count(self, sent: SentPlanes, num_bits: int) -> None:
        """Count what syndromes of a frame take."""
        for bands, code in zip(BLOCKS, sent.length_codes, strict=True):
            if code:
                num_planes = sum(sent.depths[bands.start : bands.stop])
                self.work.num_syndrome_sums += num_planes * min(length_of_code(code), num_bits)
                self.work.num_syndrome_places += num_bits

    def plan(self, group: Group, frames: Sequence[EncodedFrame], key_qp: int | None = None) -> "GroupPlan":
        """Choose what is sent of the next group; its key frame may have a QP of its own."""
        known: dict[int, _Reference] = {}
        key_step = self._key_step if key_qp is None else quantizer_step(key_qp)
        chosen = tuple(self._choices(group, frames, key_step, known))
        return GroupPlan(tuple(frames), chosen, known[len(group.wyner_ziv) + 1])

    def _choices(
        self, group: Group, frames: Sequence[EncodedFrame], key_step: float, known: dict[int, _Reference]
    ) -> Iterator[ChosenFrame]:
        """Choose what is sent, frame by frame, and note what is known of them as references."""
        lumas = [frame.luma for frame in (*group.wyner_ziv, group.key)]
        last, words = len(lumas), [*map(overlapping_words, lumas)]
        if self._before is not None:
            known[0] = self._before
        known[last] = _Reference(words[-1], self._sampler.intra_noise(lumas[-1], key_step))
        for index, around in decoding_order(0, last, self._config.gop.references != "keys"):
            errors = self._sampler.errors(
                words[index - 1],
                [known[instant].words for instant in around],
                [known[instant].noise for instant in around],
                _positions(group, (index, *around)),
            )
            frame = frames[index - 1]
            distance, num_bits = around[1] - around[0], frame.layout.num_bits
            choice = self._needs.choose(frame.quantization, errors, distance, num_bits)
            known[index] = _Reference(words[index - 1], choice.noise)
            yield ChosenFrame(index - 1, distance, errors, choice)


def quantizer_step(qp: int) -> float:
    """Return the step of an H.264 quantiser."""
    return float(0.625 * 2.0 ** (qp / 6.0))


def _positions(group: Group, instants: tuple[int, ...]) -> NDArray[np.float64]:
    """Return where the points of a group are in some of its frames; shape (N, len(instants), 2)."""
    if group.tracks is None:
        return np.empty((0, len(instants), 2))
    return group.tracks.positions.take(instants, axis=1)
