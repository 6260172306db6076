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
from dvc.wynerziv.hierarchy import reference_distances
from dvc.wynerziv.lengths import LENGTH_CODE_BITS, length_code, length_of_code
from dvc.wynerziv.payloads import EncodedFrame
from encoder.bitrate import (
    OCTAVES_PER_STEP,
    STEPS,
    BitrateController,
    ExpectedBits,
    QualityStep,
    forecast,
    keep_within,
)
from encoder.groups import Group
from encoder.rate_limits import RateLimits

PREDICTED_SHARE = 0.3
"""Bits of a predicted key frame over those of the IDR picture before it, until one is known: the mean of the
first two that `dvc-encode` codes of each of the nine clips of the results, at QP 24, 30 and 36."""
MAX_OPEN_GROUPS = 2
"""Of which it may be unknown what a decoder asks for."""


class CodedFrames(NamedTuple):
    """The frames of a group, coded."""

    key: KeyPicture  # the key frame that ends the group
    qp: int  # that of the key frame
    wyner_ziv: tuple[EncodedFrame, ...]
    limits: tuple[bytes, ...] = ()  # how much a live decoder may ask for, as headers state it


class FrameCoders(NamedTuple):
    """What codes frames at a quality."""

    key: Callable[[Frame, bool, int], KeyPicture]
    """The key frame, an IDR picture or not, at a QP."""
    wyner_ziv: Callable[[Group, QualityStep], tuple[EncodedFrame, ...]]
    """Those of a group."""


class _CodedKey(NamedTuple):
    """A key frame within the limit of frames, or as near to it as may be."""

    picture: KeyPicture
    qp: int
    fits: bool

    @property
    def num_bits(self) -> int:
        """What it takes."""
        return 8 * len(self.picture.data)


class _Tried(NamedTuple):
    """A group at one quality."""

    key: _CodedKey | None  # none of a predicted key frame that is still to be coded
    frames: tuple[EncodedFrame, ...]
    expected: ExpectedBits  # of all


def limited(config: CodecConfig, delivery: Delivery, limits: RateLimits) -> CodecConfig:
    """Return the configuration of a stream within limits: a live decoder is told how much it may ask for."""
    tells = isinstance(delivery, Live) and not limits.is_none
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
        self._config = config
        self._num_too_large = 0

    def go_on(self, before: "RateLimiter") -> None:
        """Keep the bitrate together with the stream before, of which nothing is to come."""
        self._bitrate = before._bitrate

    def code(self, group: Group, begins_chain: bool, num_bits: int) -> CodedFrames:
        """Code the next group, which takes so many bits beside its frames.

        Any quality of an IDR picture is tried. A predicted key frame is coded once, at the quality that suits
        what it is expected to take; the quality of the other frames makes up for what it does take.
        """
        key: _CodedKey | None = None
        tried: dict[QualityStep, _Tried] = {}

        def expect(quality: QualityStep) -> ExpectedBits:
            tried.clear()  # frames take memory
            own = self._idr_picture(group, quality.qp) if key is None and begins_chain else key
            found = tried[quality] = self._try(group, own, quality, num_bits)
            return found.expected

        quality, num_frames = self._usual, len(group.wyner_ziv) + 1
        outlook: QualityStep | None = None
        if not begins_chain:
            if self._bitrate is not None:
                quality = outlook = self._bitrate.outlook(num_frames, expect)
            key = self._predicted_key(group, quality.qp)
        if self._bitrate is not None:
            quality = self._bitrate.choose(num_frames, expect, outlook)
        if quality not in tried or tried[quality].key is None:
            expect(quality)
        found = tried[quality]
        assert found.key is not None
        self._predicted.learn(found.key.qp, found.key.picture, group.begins_scene)
        self._num_too_large += not found.key.fits
        return CodedFrames(
            found.key.picture, found.key.qp, found.frames, tuple(_limits(self._allowed(found.frames)))
        )

    def _allowed(self, frames: Sequence[EncodedFrame]) -> list[float]:
        """Return what a decoder may ask for of each frame, if that is told."""
        if not self._config.wyner_ziv.limited:
            return []
        left = [max(self._most_bits - 8 * len(frame.header), 0.0) for frame in frames]
        if self._bitrate is None:
            return left
        return [*map(min, self._bitrate.allowed.tolist(), left)]

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

    def _idr_picture(self, group: Group, qp: int) -> _CodedKey:
        """Code the key frame as an IDR picture, coarser if it is too large."""
        found: list[_CodedKey] = []

        def bits(coarser: int) -> float:
            picture = self._coders.key(group.key, True, qp + coarser)
            found.append(_CodedKey(picture, qp + coarser, fits=True))
            return found[-1].num_bits

        fits = keep_within(self._most_bits, MAX_QP - qp, bits)
        return found[-1]._replace(fits=fits)

    def _predicted_key(self, group: Group, qp: int) -> _CodedKey:
        """Code the key frame, predicted; as a coarser IDR picture if it turns out too large."""
        tried: list[int] = []

        def bits(coarser: int) -> float:
            tried.append(qp + coarser)
            return self._predicted.bits(qp + coarser)

        keep_within(self._most_bits, MAX_QP - qp, bits)
        key = _CodedKey(self._coders.key(group.key, False, tried[-1]), tried[-1], fits=True)
        return key if key.num_bits <= self._most_bits else self._idr_picture(group, tried[-1])

    def _try(self, group: Group, key: _CodedKey | None, quality: QualityStep, num_bits: int) -> _Tried:
        """Code the Wyner-Ziv frames of a group."""
        key_bits = self._predicted.bits(quality.qp) if key is None else key.num_bits
        frames, video = self._coders.wyner_ziv(group, quality), self._config.video
        headers = 8 * sum(len(frame.header) for frame in frames)
        distances = reference_distances(len(frames), self._config.gop.references != "keys")
        asked = forecast(quality, distances, video.width * video.height)
        return _Tried(key, frames, ExpectedBits(num_bits + key_bits + headers, asked))


class _PredictedKeys:
    """Bits of the next predicted key frame, by those of the one before or of the first of a scene."""

    def __init__(self) -> None:
        self._qp, self._bits, self._is_first = MAX_QP, 0.0, True
        self._share, self._octaves_per_qp = PREDICTED_SHARE, STEPS * OCTAVES_PER_STEP[0]

    def learn(self, qp: int, key: KeyPicture, begins_scene: bool) -> None:
        """Note what a key frame has taken."""
        num_bits, expected = 8.0 * len(key.data), self.bits(qp)
        if not key.predicted:
            if begins_scene or self._is_first:
                self._qp, self._bits, self._is_first = qp, self._share * num_bits, True
            return
        if expected and self._is_first:
            self._share = min(self._share * num_bits / expected, 1.0)
        elif expected:
            if qp != self._qp:
                _, least, most = (STEPS * octaves for octaves in OCTAVES_PER_STEP)
                octaves = math.log2(self._bits / num_bits) / (qp - self._qp)
                self._octaves_per_qp = min(max(0.5 * (self._octaves_per_qp + octaves), least), most)
            # One that rests on a coarser one takes more than it would take again: else they would alternate.
            num_bits = math.sqrt(num_bits * expected)
        self._qp, self._bits, self._is_first = qp, num_bits, False

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
