"""Payloads of the no-feedback form: what is packed is unpacked; what cannot be is refused."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc import slepian_wolf
from dvc._jit import python_twin
from dvc.errors import BitstreamError
from dvc.slepian_wolf.ldpc.graph import syndrome
from dvc.wynerziv import _kernels, quantizer
from dvc.wynerziv.lengths import length_code
from dvc.wynerziv.no_feedback import NoFeedbackFrame, SentPlanes, encode_payload
from dvc.wynerziv.payloads import EncodedFrame, quantize_frame
from dvc.wynerziv.quantizer import FrameLayout

SEED = 0
LAYOUT = FrameLayout(24, 32, True, (0,) * 16, 16)
LUMA = np.random.default_rng(1).integers(0, 256, (24, 32), dtype=np.uint8)
QUANTIZATION, WORDS = quantize_frame(LAYOUT, LUMA, quantizer.index_of_step(20.0))
FRAME = EncodedFrame(LAYOUT, QUANTIZATION, WORDS)


def depths(dc: int, *others: int) -> tuple[int, ...]:
    """Return planes of the 16 bands, the last ones none."""
    return (dc, *others, *(0,) * (15 - len(others)))


@pytest.mark.parametrize(
    "sent",
    [
        SentPlanes(depths(4, 3, 3, 1), (length_code(60), length_code(150))),
        SentPlanes(depths(2), (length_code(16), 0)),
        SentPlanes(depths(0, 1, 0, 2), (0, length_code(33))),
        SentPlanes(depths(0), (0, 0)),
        SentPlanes(depths(3, 3), (0, length_code(90))),
    ],
)
def test_round_trip(sent: SentPlanes) -> None:
    """Planes, check bits and syndromes come back; a block without syndrome is none."""
    payload = encode_payload(FRAME, sent, SEED)
    frame = NoFeedbackFrame.read(LAYOUT, payload, SEED)
    assert frame.quantization == QUANTIZATION
    assert frame.sent == sent
    for number, block in enumerate(frame.blocks):
        graph = sent.graph(number, QUANTIZATION, LAYOUT.num_bits, SEED)
        if graph is None:
            assert block is None
            continue
        assert block is not None
        np.testing.assert_array_equal(block.syndrome, syndrome(WORDS, graph))
        planes = [(WORDS[p // 64] >> np.uint64(63 - p % 64)) & np.uint64(1) for p in graph.planes]
        checks = slepian_wolf.crc(np.stack(planes).astype(np.uint8), LAYOUT.crc_bits)
        np.testing.assert_array_equal(block.check, slepian_wolf.joint_check(checks))
    header_bits = 8 * len(payload) - frame.syndrome_bits - frame.check_bits
    assert 0 <= header_bits < 200


@pytest.mark.nojit
def test_kernel_is_its_python(monkeypatch: pytest.MonkeyPatch) -> None:
    """To the last bit."""
    sent = SentPlanes(depths(4, 3, 3, 1), (length_code(60), length_code(150)))
    payload = encode_payload(FRAME, sent, SEED)
    monkeypatch.setattr(_kernels, "write_blocks", python_twin(_kernels.write_blocks))
    assert encode_payload(FRAME, sent, SEED) == payload


@pytest.mark.parametrize("cut", range(0, 24, 3))
def test_a_cut_payload_is_refused(cut: int) -> None:
    """Wherever it ends too early."""
    sent = SentPlanes(depths(4, 3), (length_code(60), length_code(60)))
    payload = encode_payload(FRAME, sent, SEED)
    assert cut < len(payload)
    with pytest.raises(BitstreamError):
        NoFeedbackFrame.read(LAYOUT, payload[:cut], SEED)


def test_planes_that_a_band_does_not_have_are_refused() -> None:
    """So is what is left over."""
    too_many = SentPlanes(depths(QUANTIZATION.planes[0] + 1), (0, 0))
    payload = QUANTIZATION.header
    with pytest.raises(BitstreamError, match="more bit planes of a band are sent than it has"):
        NoFeedbackFrame.read(LAYOUT, encode_payload(FRAME, too_many, SEED), SEED)
    none = encode_payload(FRAME, SentPlanes(depths(0), (0, 0)), SEED)
    assert none.startswith(payload)
    with pytest.raises(BitstreamError, match="left over"):
        NoFeedbackFrame.read(LAYOUT, none + b"\0", SEED)


@given(st.binary(max_size=80), st.booleans())
def test_any_bytes_are_read_or_refused(data: bytes, after_header: bool) -> None:
    """Nothing but a frame or a `BitstreamError` comes of them."""
    payload = QUANTIZATION.header + data if after_header else data
    try:
        frame = NoFeedbackFrame.read(LAYOUT, payload, SEED)
    except BitstreamError:
        return
    assert frame.syndrome_bits + frame.check_bits <= 8 * len(payload)
    assert all(depth <= own for depth, own in zip(frame.sent.depths, frame.quantization.planes, strict=True))


def test_blocks_that_would_take_all_memory_are_refused() -> None:
    """A few bytes may not promise planes without end."""
    layout = FrameLayout(8192, 8192, True, (0,) * 16, 16)
    quantization = quantizer.quantization_of_step(0, (12,) * 16)
    payload = (
        quantization.header
        + np.packbits(
            np.array([int(digit) for digit in "1100" + "1" * 15 + "00000000" + "00000001"], np.uint8)
        ).tobytes()
    )
    with pytest.raises(BitstreamError, match="a block of"):
        NoFeedbackFrame.read(layout, payload + bytes(20), SEED)
