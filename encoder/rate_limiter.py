"""Plans for coding groups of pictures at qualities that keep a bitrate, and limits of frames.

The limiter codes nothing: a plan is a coroutine that yields the codings to try and receives their results.
"""

import math
from collections.abc import Generator, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from dvc.config import MAX_QP, CodecConfig, Delivery, ParityBuffer
from dvc.errors import ConfigError
from dvc.keyframes import KeyPicture
from dvc.wynerziv.hierarchy import reference_distances
from dvc.wynerziv.payloads import EncodedFrame
from dvc.wynerziv.quantizer import LENGTH_CODE_BITS, LENGTHS, length_code
from encoder.groups import Group
from encoder.leaky_bucket import (
    OCTAVES_PER_STEP,
    STEPS,
    Choice,
    ExpectedBits,
    LeakyBucket,
    QualityStep,
    coarser_qp,
    forecast,
)
from encoder.rate_limits import RateLimits

PREDICTED_SHARE = 0.3
"""Bits of a predicted key frame over those of the IDR picture before it, until one is known: mean over the
first two that `dvc-encode` codes of each of the nine clips of the results, at QP 24, 30 and 36."""
MAX_OPEN_GROUPS = 2
"""Largest number of groups with unknown requests."""


class CodeKey(NamedTuple):
    """Request of a plan: code the key frame of the group, which gives a `KeyPicture`."""

    qp: int
    begins_chain: bool  # as an IDR picture


Coding = CodeKey | QualityStep
"""Request of a plan; a quality asks for the Wyner-Ziv frames of the group."""
Result = TypeVar("Result")
Plan = Generator[Coding, Any, Result]
"""Coroutine that yields codings to try, receives their results, and returns a result."""


class CodedFrames(NamedTuple):
    """The coded frames of a group."""

    key: KeyPicture  # the key frame that ends the group
    qp: int  # QP of the key frame
    wyner_ziv: tuple[EncodedFrame, ...]
    limits: tuple[bytes, ...] = ()  # bits that a live decoder may request, as headers state them


class _CodedKey(NamedTuple):
    """A key frame within the limit of frames, or as close to it as possible."""

    picture: KeyPicture
    qp: int
    fits: bool

    @property
    def num_bits(self) -> int:
        """Bits of the picture."""
        return 8 * len(self.picture.data)


class _Trial(NamedTuple):
    """A group coded at one quality."""

    quality: QualityStep
    key: _CodedKey | None  # None: a predicted key frame that is not coded yet
    frames: tuple[EncodedFrame, ...]
    expected: ExpectedBits


def summed_up(reports: Sequence[Mapping[str, int]]) -> dict[str, int]:
    """Sum up the reports of segments: the highest level, and the number of frames that are too large."""
    columns = {name: [report[name] for report in reports] for name in reports[0]}
    return {name: sum(values) if name == "too_large" else max(values) for name, values in columns.items()}


class RateLimiter:
    """Plans the coding of one group after the other within limits."""

    def __init__(self, config: CodecConfig, delivery: Delivery, limits: RateLimits) -> None:
        if isinstance(delivery, ParityBuffer):
            raise ConfigError(
                "--bitrate and --max-bits-per-frame require --serve or --no-feedback: from a file with all"
                " planes a decoder takes the bits that it needs"
            )
        if not config.wyner_ziv.embedded:
            raise ConfigError("--bitrate and --max-bits-per-frame exclude --wz-q")
        self._max_bits = limits.bits_per_frame or math.inf
        self._predicted = _PredictedKeys()
        self._usual, self._limits = QualityStep(config.wyner_ziv.qp), limits
        self._bucket: LeakyBucket | None = None
        if limits.bits_per_s is not None:
            self._bucket = LeakyBucket(limits.bits_per_s, config.video.frame_rate)
        self._config = config
        self._num_too_large = 0

    def continue_from(self, before: "RateLimiter") -> None:
        """Keep the bitrate together with an earlier stream, which has ended."""
        self._bucket = before._bucket

    def plan(self, group: Group, begins_chain: bool, num_bits: int) -> Plan[CodedFrames]:
        """Plan the coding of the next group, which takes some bits besides its frames.

        An IDR picture may be tried at any quality. A predicted key frame is coded once, at the quality that
        suits its expected bits, and as an IDR picture if it is too large; the other frames correct for it.
        """
        num_frames, bucket = len(group.wyner_ziv) + 1, self._bucket
        quality, outlook, key = self._usual, None, None
        if not begins_chain:
            if bucket is not None:
                outlook, _ = yield from self._search(bucket.outlook(num_frames), group, None, False, num_bits)
                quality = outlook
            qp = quality.qp
            while (expected := self._predicted.bits(qp)) > self._max_bits and qp < MAX_QP:
                qp = coarser_qp(qp, expected, self._max_bits)
            key = _CodedKey((yield CodeKey(qp, begins_chain=False)), qp, fits=True)
            if key.num_bits > self._max_bits:
                key = yield from self._idr_picture(qp)
        trial = None
        if bucket is not None:
            choice = bucket.choose(num_frames, outlook)
            quality, trial = yield from self._search(choice, group, key, begins_chain, num_bits)
        if trial is None or trial.quality != quality:
            trial = yield from self._trial(group, key, begins_chain, quality, num_bits)
        assert trial.key is not None
        self._predicted.update(trial.key.qp, trial.key.picture, group.begins_scene)
        self._num_too_large += not trial.key.fits
        limits = tuple(_limit_codes(self._allowed(trial.frames)))
        return CodedFrames(trial.key.picture, trial.key.qp, trial.frames, limits)

    def _search(
        self, choice: Choice, group: Group, key: _CodedKey | None, begins_chain: bool, num_bits: int
    ) -> Plan[tuple[QualityStep, _Trial]]:
        """Try the qualities of a choice; return the chosen one and the last trial."""
        quality = next(choice)
        while True:
            trial = yield from self._trial(group, key, begins_chain, quality, num_bits)
            try:
                quality = choice.send(trial.expected)
            except StopIteration as end:
                return end.value, trial

    def _trial(
        self, group: Group, key: _CodedKey | None, begins_chain: bool, quality: QualityStep, num_bits: int
    ) -> Plan[_Trial]:
        """Code the Wyner-Ziv frames of a group, and its key frame if that is still to be an IDR picture."""
        if key is None and begins_chain:
            key = yield from self._idr_picture(quality.qp)
        key_bits = self._predicted.bits(quality.qp) if key is None else key.num_bits
        frames: tuple[EncodedFrame, ...] = yield quality
        headers, video = 8 * sum(len(frame.header) for frame in frames), self._config.video
        distances = reference_distances(len(frames), self._config.gop.references != "keys")
        asked = forecast(quality, distances, video.width * video.height)
        return _Trial(quality, key, frames, ExpectedBits(num_bits + key_bits + headers, asked))

    def _idr_picture(self, qp: int) -> Plan[_CodedKey]:
        """Code the key frame as an IDR picture, coarser if it is too large."""
        while True:
            picture: KeyPicture = yield CodeKey(qp, begins_chain=True)
            key = _CodedKey(picture, qp, 8 * len(picture.data) <= self._max_bits)
            if key.fits or qp >= MAX_QP:
                return key
            qp = coarser_qp(qp, key.num_bits, self._max_bits)

    def _allowed(self, frames: Sequence[EncodedFrame]) -> list[float]:
        """Return the bits that a decoder may request for each frame, if headers state them."""
        if not self._config.wyner_ziv.limited:
            return []
        unused = [max(self._max_bits - 8 * len(frame.header), 0.0) for frame in frames]
        return unused if self._bucket is None else [*map(min, self._bucket.allowed.tolist(), unused)]

    @property
    def max_open_groups(self) -> int | None:
        """Largest number of groups that a live decoder may work at, if the bitrate is limited."""
        return None if self._bucket is None else MAX_OPEN_GROUPS

    def account(self, number: int, asked: NDArray[np.int64]) -> None:
        """Account for the bits that a decoder requested for the Wyner-Ziv frames of a group."""
        if self._bucket is not None:
            self._bucket.account(number, asked)

    def report(self) -> dict[str, int]:
        """Return how the limits were kept, JSON-safe."""
        level = {} if self._bucket is None else {"peak_buffer_bits": round(self._bucket.peak_bits)}
        return level | ({} if self._limits.bits_per_frame is None else {"too_large": self._num_too_large})


class _PredictedKeys:
    """Forecast of the next predicted key frame, from the last one or from the first of a scene."""

    def __init__(self) -> None:
        self._qp, self._bits, self._is_first = MAX_QP, 0.0, True
        self._share, self._octaves_per_qp = PREDICTED_SHARE, STEPS * OCTAVES_PER_STEP[0]

    def update(self, qp: int, key: KeyPicture, begins_scene: bool) -> None:
        """Learn from a key frame."""
        num_bits, expected = 8.0 * len(key.data), self.bits(qp)
        if not key.predicted:
            if begins_scene or self._is_first:
                self._qp, self._bits, self._is_first = qp, self._share * num_bits, True
            return
        if expected and self._is_first:
            self._share = min(self._share * num_bits / expected, 1.0)
        elif expected:
            if qp != self._qp:
                _, lowest, highest = (STEPS * octaves for octaves in OCTAVES_PER_STEP)
                octaves = math.log2(self._bits / num_bits) / (qp - self._qp)
                self._octaves_per_qp = min(max(0.5 * (self._octaves_per_qp + octaves), lowest), highest)
            # A picture with a coarser reference takes more than its successor would; the mean stops
            # alternation.
            num_bits = math.sqrt(num_bits * expected)
        self._qp, self._bits, self._is_first = qp, num_bits, False

    def bits(self, qp: int) -> float:
        """Return the expected bits of the next one."""
        return float(self._bits * 2.0 ** (self._octaves_per_qp * (self._qp - qp)))


def _limit_codes(allowed: Sequence[float]) -> Iterator[bytes]:
    """Yield the limits that headers state, together no more than allowed."""
    unused = 0.0
    for bits in allowed:
        unused += bits
        code = length_code(unused)
        code -= LENGTHS[code] > unused
        unused -= LENGTHS[code]
        yield code.to_bytes(LENGTH_CODE_BITS // 8)
