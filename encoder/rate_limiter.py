"""Coding of groups of pictures at qualities that keep a bitrate, and limits of frames."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.config import MAX_QP, CodecConfig, Delivery, Live, ParityBuffer
from dvc.errors import ConfigError
from dvc.keyframes import KeyPicture
from dvc.video import Frame
from dvc.wynerziv.lengths import LENGTH_CODE_BITS, length_code, length_of_code
from dvc.wynerziv.payloads import EncodedFrame
from encoder.groups import Group
from encoder.rate_control.bitrate import (
    OCTAVES_PER_STEP,
    STEPS,
    BitrateController,
    ExpectedBits,
    QualityStep,
    keep_within,
)
from encoder.rate_control.limits import RateLimits

PREDICTED_SHARE = 0.3
"""Bits of a predicted key frame over those of the IDR picture before it, until one is known."""
MAX_OPEN_GROUPS = 2
"""Of which it may be unknown what a decoder asks for."""


class CodedFrames(NamedTuple):
    """The frames of a group, coded."""

    key: KeyPicture | None  # the key frame that ends the group; None if it is still to be coded
    wyner_ziv: tuple[EncodedFrame, ...]
    limits: tuple[bytes, ...] = ()  # how much a live decoder may ask for, as headers state it


class FrameCoders(NamedTuple):
    """What codes frames at a quality."""

    key: Callable[[Frame, bool, int], KeyPicture]
    """The key frame, an IDR picture or not, at a QP."""
    wyner_ziv: Callable[[Group, QualityStep], tuple[EncodedFrame, ...]]
    """Those of a group."""
    expect: Callable[[Group, tuple[EncodedFrame, ...], int], ExpectedBits]
    """What these take, at the QP of the key frame."""


class _Tried(NamedTuple):
    """A group at one quality."""

    coded: CodedFrames
    key_qp: int
    key_bits: float
    expected: ExpectedBits  # of the Wyner-Ziv frames
    num_too_large: int


def limited(config: CodecConfig, delivery: Delivery, limits: RateLimits) -> CodecConfig:
    """Return the configuration of a stream within limits: a live decoder is told how much it may ask for."""
    tells = isinstance(delivery, Live) and limits.bits_per_s is not None
    return replace(config, wyner_ziv=replace(config.wyner_ziv, limited=True)) if tells else config


def of_segments(reports: Sequence[Mapping[str, int]]) -> dict[str, int]:
    """Sum up how segments kept their limits: what was owed most, and all frames that are too large."""
    found = {name: [report[name] for report in reports] for name in reports[0]}
    return {name: sum(values) if name == "too_large" else max(values) for name, values in found.items()}


class RateLimiter:
    """Codes one group after the other within limits."""

    def __init__(
        self, config: CodecConfig, delivery: Delivery, limits: RateLimits, coders: FrameCoders
    ) -> None:
        if isinstance(delivery, ParityBuffer):
            raise ConfigError(
                "--bitrate and --max-bits-per-frame are for --serve and --no-feedback: of a file with all"
                " planes a decoder takes what it needs"
            )
        if not config.wyner_ziv.embedded:
            raise ConfigError("--bitrate and --max-bits-per-frame are not for --wz-q")
        self._most_bits = limits.bits_per_frame or math.inf
        self._predicted = _PredictedKeys()
        self._usual, self._limits, self._coders = QualityStep(config.wyner_ziv.qp), limits, coders
        self._bitrate: BitrateController | None = None
        if limits.bits_per_s is not None:
            self._bitrate = BitrateController(limits.bits_per_s, config.video.frame_rate)
        self._tells_limits = config.wyner_ziv.limited
        self._num_too_large = 0

    def go_on(self, before: "RateLimiter") -> None:
        """Keep the bitrate together with the stream before, of which nothing is to come."""
        self._bitrate = before._bitrate

    def code(self, group: Group, begins_chain: bool, num_bits: int) -> CodedFrames:
        """Code the next group, which takes so many bits beside its frames."""
        tried: dict[QualityStep, _Tried] = {}

        def expect(quality: QualityStep) -> ExpectedBits:
            tried.clear()  # frames take memory
            found = tried[quality] = self._try(group, begins_chain, quality)
            return found.expected._replace(certain=num_bits + found.key_bits + found.expected.certain)

        quality = self._usual
        if self._bitrate is not None:
            quality = self._bitrate.choose(len(group.wyner_ziv) + 1, expect)
        if quality not in tried:
            expect(quality)
        coded, num_too_large = self._with_key(group, tried[quality])
        self._num_too_large += num_too_large
        if self._bitrate is None or not self._tells_limits:
            return coded
        return coded._replace(limits=tuple(_limits(self._bitrate.allowed.tolist())))

    @property
    def max_open_groups(self) -> int | None:
        """Most groups that a live decoder may work at, if that is limited."""
        return None if self._bitrate is None else MAX_OPEN_GROUPS

    def settle(self, number: int, asked: NDArray[np.int64]) -> None:
        """Count what a decoder has asked for of the Wyner-Ziv frames of a group."""
        if self._bitrate is not None:
            self._bitrate.settle(number, asked)

    def leave_out(self, last: int) -> None:
        """Expect nothing more of the groups up to a number."""
        if self._bitrate is not None:
            self._bitrate.leave_out(last)

    def report(self) -> dict[str, int]:
        """Tell how the limits were kept."""
        owed = {} if self._bitrate is None else {"most_bits_owed": round(self._bitrate.most_owed)}
        return owed | ({} if self._limits.bits_per_frame is None else {"too_large": self._num_too_large})

    def _try(self, group: Group, begins_chain: bool, quality: QualityStep) -> _Tried:
        """Code a group, coarser if a frame is too large; a predicted key frame cannot be tried."""
        key: KeyPicture | None = None
        key_qp, num_bits = quality.qp, 0.0
        frames: tuple[EncodedFrame, ...] = ()
        expected = ExpectedBits(0.0)

        def key_bits(coarser: int) -> float:
            nonlocal key, key_qp, num_bits
            key_qp = quality.qp + coarser
            num_bits = self._predicted.bits(key_qp)
            if begins_chain:
                key = self._coders.key(group.key, True, key_qp)
                num_bits = 8 * len(key.data)
            return num_bits

        def most_bits(coarser: int) -> float:
            nonlocal frames, expected
            frames = self._coders.wyner_ziv(group, quality._replace(qp=quality.qp + coarser))
            expected = self._coders.expect(group, frames, key_qp)
            return expected.most

        key_fits, frames_fit = (
            keep_within(self._most_bits, MAX_QP - quality.qp, bits) for bits in (key_bits, most_bits)
        )
        num_too_large = (begins_chain and not key_fits) + (not frames_fit)
        return _Tried(CodedFrames(key, frames), key_qp, num_bits, expected, num_too_large)

    def _with_key(self, group: Group, tried: _Tried) -> tuple[CodedFrames, int]:
        """Code the key frame if that is still to be done; count the frames that are too large."""
        coded, num_too_large, key = tried.coded, tried.num_too_large, tried.coded.key
        if key is None:
            key = self._coders.key(group.key, False, tried.key_qp)
            if 8 * len(key.data) > self._most_bits:  # a coarser IDR picture in its place

                def bits(coarser: int) -> float:
                    nonlocal key
                    key = self._coders.key(group.key, True, tried.key_qp + coarser)
                    return 8 * len(key.data)

                num_too_large += not keep_within(self._most_bits, MAX_QP - tried.key_qp, bits)
            if self._bitrate is not None:
                self._bitrate.correct(8 * len(key.data) - tried.key_bits)
        self._predicted.learn(tried.key_qp, key)
        return coded._replace(key=key), num_too_large


class _PredictedKeys:
    """Bits of the next predicted key frame, by those of the one before."""

    def __init__(self) -> None:
        self._qp, self._bits, self._begins_chain = MAX_QP, 0.0, True
        self._share, self._octaves_per_qp = PREDICTED_SHARE, STEPS * OCTAVES_PER_STEP[0]

    def learn(self, qp: int, key: KeyPicture) -> None:
        """Note what a key frame has taken."""
        num_bits, expected = 8.0 * len(key.data), self.bits(qp)
        if key.predicted and self._begins_chain and expected:
            self._share = min(self._share * num_bits / expected, 1.0)
        elif key.predicted and expected:
            if qp != self._qp:
                _, least, most = (STEPS * octaves for octaves in OCTAVES_PER_STEP)
                octaves = math.log2(self._bits / num_bits) / (qp - self._qp)
                self._octaves_per_qp = min(max(0.5 * (self._octaves_per_qp + octaves), least), most)
            # One that rests on a coarser one takes more than it would take again: else they would alternate.
            num_bits = math.sqrt(num_bits * expected)
        self._qp, self._begins_chain = qp, not key.predicted
        self._bits = num_bits * (1.0 if key.predicted else self._share)

    def bits(self, qp: int) -> float:
        """Return what the next one is expected to take."""
        return float(self._bits * 2.0 ** (self._octaves_per_qp * (self._qp - qp)))


def _limits(allowed: Sequence[float]) -> Iterator[bytes]:
    """Yield what headers tell, together no more than is allowed."""
    left = 0.0
    for bits in allowed:
        left += bits
        code = length_code(left)
        code -= length_of_code(code) > left
        left -= length_of_code(code)
        yield code.to_bytes(LENGTH_CODE_BITS // 8)
