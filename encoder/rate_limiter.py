"""Coding of groups of pictures at qualities that keep a bitrate, and limits of frames."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.config import MAX_QP, CodecConfig, Delivery, Live, ParityBuffer
from dvc.errors import ConfigError
from dvc.video import Frame
from dvc.wynerziv.lengths import LENGTH_CODE_BITS, length_code, length_of_code
from dvc.wynerziv.payloads import EncodedFrame
from encoder.groups import Group
from encoder.rate_control.bitrate import (
    BitrateController,
    ExpectedBits,
    QualityStep,
    keep_within,
)
from encoder.rate_control.limits import RateLimits

MAX_OPEN_GROUPS = 2
"""Of which it may be unknown what a decoder asks for."""


class CodedFrames(NamedTuple):
    """The frames of a group, coded."""

    key: bytes  # the key frame that ends the group; empty if none does
    wyner_ziv: tuple[EncodedFrame, ...]
    limits: tuple[bytes, ...] = ()  # what headers tell of how much a live decoder may ask for


class FrameCoders(NamedTuple):
    """What codes frames at a quality."""

    key: Callable[[Frame, int], bytes]
    wyner_ziv: Callable[[Group, bool, QualityStep], tuple[EncodedFrame, ...]]
    """Those of a group, which a key frame ends or not."""
    expect: Callable[[Group, tuple[EncodedFrame, ...], int], ExpectedBits]
    """Tells what these take, at the QP of the key frame."""


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
        self._usual, self._limits, self._coders = QualityStep(config.wyner_ziv.qp), limits, coders
        self._bitrate: BitrateController | None = None
        if limits.bits_per_s is not None:
            self._bitrate = BitrateController(limits.bits_per_s, config.video.frame_rate)
        self._tells_limits = config.wyner_ziv.limited
        self._num_too_large = 0

    def go_on(self, before: "RateLimiter") -> None:
        """Keep the bitrate together with the stream before, of which nothing is to come."""
        self._bitrate = before._bitrate

    def code(self, group: Group, needs_key: bool, num_bits: int) -> CodedFrames:
        """Code the next group, which takes so many bits beside its frames."""
        if self._bitrate is None:
            coded, _, num_too_large = self._code_within(group, needs_key, self._usual)
            self._num_too_large += num_too_large
            return coded
        coded, tried, num_too_large = CodedFrames(b"", ()), QualityStep(0), 0

        def expect(quality: QualityStep) -> ExpectedBits:
            nonlocal coded, tried, num_too_large
            coded, expected, num_too_large = self._code_within(group, needs_key, quality)
            tried = quality
            return expected._replace(certain=num_bits + 8 * len(coded.key) + expected.certain)

        quality = self._bitrate.choose(len(group.wyner_ziv) + 1, expect)
        if quality != tried:
            expect(quality)
        self._num_too_large += num_too_large
        if not self._tells_limits:
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

    def _code_within(
        self, group: Group, needs_key: bool, quality: QualityStep
    ) -> tuple[CodedFrames, ExpectedBits, int]:
        """Code a group, coarser where a frame is too large; count key and other frames that still are."""
        most = self._limits.bits_per_frame or math.inf
        key, key_qp = b"", quality.qp
        frames: tuple[EncodedFrame, ...] = ()
        expected = ExpectedBits(0.0)

        def key_bits(coarser: int) -> float:
            nonlocal key, key_qp
            key_qp = quality.qp + coarser
            key = self._coders.key(group.key, key_qp)
            return 8 * len(key)

        def most_bits(coarser: int) -> float:
            nonlocal frames, expected
            coarse = quality._replace(qp=quality.qp + coarser)
            frames = self._coders.wyner_ziv(group, needs_key, coarse)
            expected = self._coders.expect(group, frames, key_qp)
            return expected.most

        coarsest = MAX_QP - quality.qp
        kept = [keep_within(most, coarsest, key_bits)] if needs_key else []
        kept.append(keep_within(most, coarsest, most_bits))
        return CodedFrames(key, frames), expected, kept.count(False)


def _limits(allowed: Sequence[float]) -> Iterator[bytes]:
    """Yield what headers tell, together no more than is allowed."""
    left = 0.0
    for bits in allowed:
        left += bits
        code = length_code(left)
        code -= length_of_code(code) > left
        left -= length_of_code(code)
        yield code.to_bytes(LENGTH_CODE_BITS // 8)
