"""Key frames within limits, and what a live decoder is told it may ask for."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.config import Live, NoFeedback, ParityBuffer, Qp, VideoConfig, codec_config
from dvc.errors import ConfigError
from dvc.keyframes import KeyPicture
from dvc.slepian_wolf.requests import drive
from dvc.video import Frame
from dvc.wynerziv.payloads import EncodedFrame
from dvc.wynerziv.quantizer import LENGTHS, FrameLayout
from encoder.encoder_session import EncoderSession
from encoder.groups import Group
from encoder.rate_limiter import CodedFrames, CodeKey, Coding, RateLimiter, _limit_codes
from encoder.rate_limits import TOLERANCE, RateLimits
from tests.clips import moving_texture

CONFIG = codec_config(VideoConfig(16, 16, 25, 1, luma_only=True), quality=Qp(30))
GROUP = Group((), Frame(np.zeros((16, 16), np.uint8)))


class Keys:
    """A coder of key frames of so many bytes at QP 30, IDR pictures and predicted ones."""

    def __init__(self, idr: int, predicted: int) -> None:
        self.sizes = {True: idr, False: predicted}
        self.coded: list[tuple[bool, int]] = []  # whether it begins a chain, and the QP

    def code(self, begins_chain: bool, qp: int) -> KeyPicture:
        self.coded.append((begins_chain, qp))
        size = self.sizes[begins_chain] * 2.0 ** (0.2 * (30 - qp))
        return KeyPicture(bytes(round(size)), not begins_chain)


def limiter_of(limits: RateLimits) -> RateLimiter:
    """Return a limiter of key frames."""
    return RateLimiter(CONFIG, NoFeedback(), limits)


def coded_within(
    limiter: RateLimiter,
    keys: Keys,
    begins_chain: bool,
    group: Group = GROUP,
    frames: tuple[EncodedFrame, ...] = (),
) -> CodedFrames:
    """Code a group as a limiter plans it."""

    def code(coding: Coding) -> KeyPicture | tuple[EncodedFrame, ...]:
        return keys.code(coding.begins_chain, coding.qp) if isinstance(coding, CodeKey) else frames

    return drive(limiter.plan(group, begins_chain, 0), code)


def test_predicted_key_frames_are_coded_once() -> None:
    """The next is predicted from what was coded last, so that no quality can be tried."""
    keys = Keys(1000, 100)
    limiter = limiter_of(RateLimits(bits_per_s=20_000))
    for number in range(30):
        before = len(keys.coded)
        coded = coded_within(limiter, keys, number == 0)
        assert coded.key is not None
        assert coded.key.predicted == (number > 0)
        assert len(keys.coded) - before == 1 or number == 0
    assert not any(begins_chain for begins_chain, _ in keys.coded[-29:])


@pytest.mark.parametrize("predicted", [20, 100, 600])
def test_the_bitrate_holds_however_much_predicted_key_frames_take(predicted: int) -> None:
    keys = Keys(1000, predicted)
    limiter = limiter_of(RateLimits(bits_per_s=20_000))
    bits = [8 * len(coded_within(limiter, keys, number == 0).key.data) for number in range(250)]  # type: ignore[union-attr]
    assert sum(bits[50:]) / 8 == pytest.approx(20_000, rel=TOLERANCE)


@pytest.mark.parametrize(
    ("most_bits", "begins", "coded", "too_large"),
    [
        (10_000, False, [False], 0),
        (1600, False, [False], 0),
        (1500, False, [False, True, True], 0),
        (1500, True, [True, True], 0),
        (2, False, [False, True], 1),
        (2, True, [True, True], 1),
    ],
)
def test_a_predicted_key_frame_that_is_too_large_gives_way_to_an_idr_picture(
    most_bits: int, begins: bool, coded: list[bool], too_large: int
) -> None:
    """Which may be coded again, coarser, until it fits; what does not fit at the coarsest is counted once."""
    keys = Keys(1000, 10)
    limiter = limiter_of(RateLimits(bits_per_frame=most_bits))
    if not begins:
        limiter._predicted.update(30, keys.code(False, 30), False)
    keys.sizes[False] = 200  # more than is expected
    keys.coded.clear()
    key = coded_within(limiter, keys, begins).key
    assert key is not None
    assert [begins_chain for begins_chain, _ in keys.coded] == coded
    assert keys.coded == sorted(keys.coded)
    assert key.predicted is not coded[-1]
    assert (8 * len(key.data) <= most_bits) is (not too_large)
    assert limiter.report() == {"too_large": too_large}


@pytest.mark.parametrize("limits", [RateLimits(bits_per_s=20_000), RateLimits(None, 500)])
def test_only_a_live_decoder_is_told_what_it_may_ask_for(limits: RateLimits) -> None:
    for delivery, limit in ((Live(), limits), (NoFeedback(), limits), (Live(), None)):
        config = EncoderSession(CONFIG, delivery, limits=limit).config
        assert config.wyner_ziv.limited == (delivery == Live() and limit is not None)


@pytest.mark.parametrize("bits_per_s", [None, 20_000])
@pytest.mark.parametrize("most_bits", [1, 500, 2000])
def test_frames_may_take_no_more_than_the_limit_on_the_mean(bits_per_s: int | None, most_bits: int) -> None:
    limits, layout = RateLimits(bits_per_s, most_bits), FrameLayout.of(CONFIG)
    frames = moving_texture(4, 16, 16)
    planes = tuple(EncodedFrame.of(layout, frame.luma, 8.0) for frame in frames[:3])
    limiter = RateLimiter(EncoderSession(CONFIG, Live(), limits=limits).config, Live(), limits)
    coded = coded_within(limiter, Keys(1000, 100), True, Group((), frames[3]), planes)
    told = [LENGTHS[code[0]] for code in coded.limits]
    headers = sum(8 * len(frame.header) for frame in planes)
    assert len(told) == 3
    assert sum(told) <= max(3 * most_bits - headers, 0)
    assert any(told) == (most_bits > 1)


def test_limits_are_for_those_who_choose_what_is_sent() -> None:
    with pytest.raises(ConfigError, match="require --serve or --no-feedback"):
        RateLimiter(CONFIG, ParityBuffer(), RateLimits(1000))


@given(st.lists(st.floats(0.0, 900_000.0), min_size=1, max_size=16))
def test_frames_together_are_told_what_is_allowed(allowed: list[float]) -> None:
    told = [LENGTHS[code[0]] for code in _limit_codes(allowed)]
    assert len(told) == len(allowed)
    assert sum(told) <= sum(allowed) + 1e-6
    assert sum(told) >= sum(allowed) - max(16.0, max(allowed) / 8.0 + 1.0) or max(told) > 900_000
