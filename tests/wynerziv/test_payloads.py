"""Layout and payloads of a Wyner-Ziv frame: what is written is what can be asked for."""

from collections.abc import Generator, Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from dvc import slepian_wolf
from dvc._jit import python_twin
from dvc.config import MAX_BAND_PLANES, DiscoverMatrix, VideoConfig, WynerZivConfig, codec_config
from dvc.errors import BitstreamError
from dvc.slepian_wolf import ParityRequest, Round, drive
from dvc.slepian_wolf.cascade.orders import bit_orders
from dvc.slepian_wolf.crc import POLYNOMIALS, joint_check_of_words
from dvc.slepian_wolf.turbo.codes import CLASSICAL
from dvc.slepian_wolf.turbo.encoder import encode_planes
from dvc.wynerziv import _kernels, quantizer, transform
from dvc.wynerziv.payloads import (
    BufferedFrame,
    EncodedFrame,
    PuncturedFrame,
    PunctureRecorder,
    quantize_frame,
)
from dvc.wynerziv.quantizer import FrameLayout
from tests.coders import coder_of
from tests.reference import wynerziv_planes as reference


def layout_of(height: int, width: int, levels: tuple[int, ...] | None) -> FrameLayout:
    quantised = WynerZivConfig(levels=levels or ())
    return FrameLayout.of(codec_config(VideoConfig(width, height, 25, 1), wyner_ziv=quantised))


MATRICES = [DiscoverMatrix(q).wyner_ziv.levels for q in range(1, 9)]
layouts = st.builds(
    layout_of,
    st.integers(1, 17),
    st.integers(1, 17),
    st.one_of(
        st.sampled_from(MATRICES),
        st.tuples(*[st.sampled_from([0, 2, 4, 16, 64, 256])] * 16).filter(any),
        st.none(),
    ),
)
step_indices = st.integers(0, 63)


def random_luma(layout: FrameLayout, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    shape = layout.height, layout.width
    return np.clip(rng.normal(rng.uniform(0, 255), rng.uniform(1, 90), shape), 0, 255).astype(np.uint8)


def encoded_frame(layout: FrameLayout, seed: int, step_index: int = 16, coder: str = "turbo") -> EncodedFrame:
    quantization, words = quantize_frame(layout, random_luma(layout, seed), step_index)
    return EncodedFrame(layout, quantization, words, coder_of(coder))


def uncoded_planes(frame: EncodedFrame) -> np.ndarray:
    """Return the bits of all planes of a frame; shape (planes, N)."""
    chosen = np.arange(frame.quantization.num_planes)
    shifts = (63 - chosen % 64).astype(np.uint64)
    return ((frame.words[chosen // 64] >> shifts[:, None]) & np.uint64(1)).astype(np.uint8)


@given(layouts, st.data())
def test_header_round_trip(layout: FrameLayout, data: st.DataObject) -> None:
    """What a frame's quantisers are survives, whatever follows the header."""
    if layout.embedded:
        planes = tuple(data.draw(st.tuples(*[st.integers(0, MAX_BAND_PLANES)] * 16)))
        quantization = quantizer.quantization_of_step(data.draw(step_indices), planes)
    else:
        bands = [band for band, planes in enumerate(layout.max_planes) if planes and band]
        quantization = layout.over_range({band: data.draw(step_indices) for band in bands})
    header = quantization.header
    assert layout.read_header(header + b"parity") == quantization
    if header:
        with pytest.raises(BitstreamError, match="header of a Wyner-Ziv frame"):
            layout.read_header(header[:-1])


@given(st.binary(max_size=30))
def test_any_header_is_read_or_refused(data: bytes) -> None:
    """No bytes ask for more planes than there may be, and what is read is what was written."""
    layout = layout_of(8, 8, None)
    try:
        quantization = layout.read_header(data)
    except BitstreamError:
        return
    assert all(0 <= planes <= MAX_BAND_PLANES for planes in quantization.planes)
    header = quantization.header
    assert layout.read_header(header) == quantization
    assert len(header) <= len(data)


@given(layouts, st.integers(0, 2**32 - 1), step_indices)
def test_planes_are_numbered_band_by_band(layout: FrameLayout, seed: int, step_index: int) -> None:
    """Each band's planes follow those of the band before, and all are counted."""
    quantization, words = quantize_frame(layout, random_luma(layout, seed), step_index)
    expected = 0
    for band in quantization.bands:
        assert quantization.first_plane[band] == expected
        assert quantization.planes[band] <= layout.max_planes[band]
        expected += quantization.planes[band]
    assert quantization.num_planes == expected
    assert words.shape == (quantization.num_words, layout.num_bits)
    assert layout.num_bits == np.prod(layout.band_shape)


@given(layouts, st.integers(0, 2**32 - 1), step_indices)
def test_quantized_words_hold_the_digits_of_the_bins(layout: FrameLayout, seed: int, step_index: int) -> None:
    """The compiled encoder path puts the same bits into words as transform, quantiser and planes do."""
    luma = random_luma(layout, seed)
    quantization, _ = quantize_frame(layout, luma, step_index)
    planes = uncoded_planes(encoded_frame(layout, seed, step_index))
    bands = transform.forward(luma).reshape(16, -1)
    for band in quantization.bands:
        edges = quantization.edges(band)
        first, count = quantization.first_plane[band], quantization.planes[band]
        bins = reference.quantize(bands[band], edges)
        np.testing.assert_array_equal(planes[first : first + count], quantizer.to_planes(bins, count))


def hard_frames() -> list[np.ndarray]:
    """Return noise in black and white, chequerboards, stripes and flat frames, of odd sides."""
    noise = 255 * np.random.default_rng(8).integers(0, 2, (9, 14), dtype=np.uint8)
    rows, columns = np.mgrid[:9, :14]
    patterns = (rows + columns, rows, columns, rows // 2, columns // 2 + rows // 2)
    return [noise, *(255 * (pattern % 2).astype(np.uint8) for pattern in patterns), noise & 3, noise * 0]


@pytest.mark.parametrize("step_index", range(0, 64, 9))
def test_embedded_bins_are_those_of_the_formula(step_index: int) -> None:
    """From the finest step on, planes and bins of the largest and smallest coefficients are exact."""
    layout, step = layout_of(9, 14, None), quantizer.step_from_index(step_index)
    most = 0
    for luma in hard_frames():
        bands = transform.forward(luma).reshape(16, -1)
        quantization, words = quantize_frame(layout, luma, step_index)
        planes = [reference.embedded_planes(n, band.min(), band.max(), step) for n, band in enumerate(bands)]
        assert quantization.planes == tuple(planes)
        for n in range(layout.num_bits):
            numbers = [reference.embedded_bin(b, bands[b, n], step, planes[b]) for b in range(16)]
            digits = [digit for b in range(16) for digit in reference.binary_digits(numbers[b], planes[b])]
            got = [int(words[p // 64, n] >> np.uint64(63 - p % 64)) & 1 for p in range(len(digits))]
            assert got == digits
        most = max(most, sum(planes))
    assert step_index or most > 128


@settings(max_examples=25)
@given(layouts, st.integers(0, 2**32 - 1), st.data())
def test_buffered_payload_answers_by_positions(layout: FrameLayout, seed: int, data: st.DataObject) -> None:
    """Parities of ranges, and check bits of several planes, are those of the planes."""
    frame = encoded_frame(layout, seed, coder="cascade")
    buffered = BufferedFrame(layout, frame.buffered_payload(), coder_of("cascade").num_codes)
    planes = uncoded_planes(frame)
    for _ in range(4 if len(planes) else 0):
        plane = data.draw(st.integers(0, len(planes) - 1))
        order = data.draw(st.integers(0, coder_of("cascade").num_codes - 1))
        positions = data.draw(st.sets(st.integers(0, layout.num_bits - 1), min_size=1))
        where = tuple(sorted(positions))
        request = ParityRequest(0, plane, "parity", order, 0, len(where), where)
        orders = bit_orders(layout.num_bits, 1)
        expected = [planes[plane, orders[order, : end + 1]].sum() % 2 for end in where]
        np.testing.assert_array_equal(buffered.answer(request), expected)
        several = tuple(sorted(data.draw(st.sets(st.integers(0, len(planes) - 1), min_size=1))))
        joint = ParityRequest(0, several[0], "joint", 0, 0, 7, several)
        checks = np.concatenate([slepian_wolf.crc(planes[p], layout.crc_bits) for p in several])
        np.testing.assert_array_equal(buffered.answer(joint), slepian_wolf.crc(checks, layout.crc_bits)[:7])


def test_answers_are_the_codes_of_the_planes() -> None:
    """Check and parity bits are those of `dvc.slepian_wolf` for the plane alone."""
    layout = layout_of(16, 20, MATRICES[7])
    frame = encoded_frame(layout, 5)
    buffered = BufferedFrame(layout, frame.buffered_payload(), 1)
    planes = uncoded_planes(frame)
    parity = encode_planes(planes, CLASSICAL, 1)
    check = slepian_wolf.crc(planes, layout.crc_bits)
    for plane in (0, 6, len(planes) - 1):
        whole = ParityRequest(0, plane, "parity", 0, 0, layout.num_bits)
        np.testing.assert_array_equal(buffered.answer(whole), parity[plane])
        whole = ParityRequest(0, plane, "crc", 0, 0, layout.crc_bits)
        np.testing.assert_array_equal(buffered.answer(whole), check[plane])
        part = ParityRequest(0, plane, "uncoded", 0, 3, 11)
        np.testing.assert_array_equal(buffered.answer(part), planes[plane, 3:14])


@pytest.mark.parametrize("change", [-1, 1])
def test_buffered_payload_of_another_size_is_refused(change: int) -> None:
    """A payload that is a byte short or long cannot be a frame of the layout."""
    layout = layout_of(16, 16, MATRICES[0])
    payload = encoded_frame(layout, 0).buffered_payload()
    wrong = payload[:-1] if change < 0 else payload + b"\0"
    with pytest.raises(BitstreamError, match="expected"):
        BufferedFrame(layout, wrong, 1)


@given(st.lists(st.integers(0, 30), max_size=8), st.integers(0, 2**32 - 1))
def test_punctured_payload_replays_what_was_recorded(counts: list[int], seed: int) -> None:
    """The bits that a decoder was given come back from the payload, in order, and use it up."""
    layout = layout_of(8, 8, MATRICES[0])
    bands = [band for band, planes in enumerate(layout.max_planes) if planes and band]
    header = layout.over_range(dict.fromkeys(bands, 9)).header
    rng = np.random.default_rng(seed)
    recorder = PunctureRecorder()

    def asking() -> Generator[Round, Sequence[NDArray[np.uint8]], list[NDArray[np.uint8]]]:
        answers: list[NDArray[np.uint8]] = []
        for start in range(0, len(counts), 2):
            several = counts[start : start + 2]
            answers += yield [ParityRequest(0, k, "uncoded", 0, 0, count) for k, count in enumerate(several)]
        return answers

    def answer(requests: Round) -> list[NDArray[np.uint8]]:
        return [rng.integers(0, 2, request.count, dtype=np.uint8) for request in requests]

    given_bits = drive(recorder.watch(asking()), answer)
    payload = recorder.payload(header)
    assert len(payload) == len(header) + -(-sum(counts) // 8)
    source = PuncturedFrame(layout, payload)
    for count, bits in zip(counts, given_bits, strict=True):
        np.testing.assert_array_equal(source.answer(ParityRequest(0, 3, "parity", 2, 7, count)), bits)
    with pytest.raises(BitstreamError, match="are needed"):
        source.answer(ParityRequest(0, 0, "uncoded", 0, 0, 9))


@pytest.mark.nojit
@pytest.mark.parametrize("twin", [False, True])
@pytest.mark.parametrize("levels", [2, 16, 256])
def test_quantising_kernels_equal_their_twins(levels: int, twin: bool) -> None:
    """Compiled and as Python, the kernels set the digits of the bins, on borders as well."""
    rng = np.random.default_rng(levels)
    step = 4.0  # a power of two, so that the borders themselves are exact
    edges = quantizer.bin_edges(levels, step)
    inner = edges[1:-1]
    coefficients = np.concatenate(
        [rng.normal(0.0, levels, 40), edges, inner, np.nextafter(inner, -np.inf), [0.0]]
    )
    dc = rng.uniform(0.0, 1020.0, coefficients.size)
    planes = levels.bit_length() - 1
    words = np.zeros((2, coefficients.size), np.uint64)
    choose = python_twin if twin else (lambda kernel: kernel)
    choose(_kernels.pack_dead_zone)(coefficients, 1.0, step, planes, 60, words)
    bands = np.zeros((7, dc.size))  # the first six only take their places
    bands[6] = 2.0 * dc
    counts, scale = np.array([12, 12, 12, 12, 12, planes, planes]), np.full(7, 0.5)
    choose(_kernels.pack_uniform)(bands, scale, 1024.0 / levels, np.zeros(7), counts, words)
    for n in range(coefficients.size):
        number = reference.find_bin(coefficients[n], edges)
        digits = reference.binary_digits(number, planes)
        number = reference.find_bin(dc[n], quantizer.bin_edges(levels, None))
        digits += reference.binary_digits(number, planes)
        got = [int(words[p // 64, n] >> np.uint64(63 - p % 64)) & 1 for p in range(60, 60 + 2 * planes)]
        assert got == digits


def test_joint_check_of_words_is_that_of_bits() -> None:
    """Wherever planes stand, by the kernel and by its Python."""
    words = np.random.default_rng(4).integers(0, 2**64, (2, 16), dtype=np.uint64)
    planes = np.array([0, 3, 63, 64, 100])
    bits = [(words[p // 64] >> np.uint64(63 - p % 64)) & np.uint64(1) for p in planes.tolist()]
    expected = slepian_wolf.joint_check(np.stack(bits))
    for kernel in (joint_check_of_words, python_twin(joint_check_of_words)):
        np.testing.assert_array_equal(kernel(words, planes, POLYNOMIALS[16]), expected)


@pytest.mark.parametrize("levels", [None, MATRICES[7]])
def test_bands_may_be_packed_one_after_the_other(levels: tuple[int, ...] | None) -> None:
    """Planes of the first bands are those that are there once all are packed, and they are packed once."""
    layout = layout_of(24, 32, levels)
    whole = encoded_frame(layout, 1)
    asked = encoded_frame(layout, 1)
    for num_bands in (1, 3, transform.NUM_BANDS, 2):
        words, checks = asked.pack(num_bands)
        assert asked.num_packed_bands == max(num_bands, asked.num_packed_bands)
        np.testing.assert_array_equal(words[:1], whole.words[:1])
        np.testing.assert_array_equal(checks[:1], whole.checks[:1])
    np.testing.assert_array_equal(asked.words, whole.words)
