"""Layout and payloads of a Wyner-Ziv frame: what is written is what can be asked for."""

from collections.abc import Generator, Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from dvc.config import DiscoverMatrix, VideoConfig, WynerZivConfig, codec_config
from dvc.config.sections import MAX_BAND_PLANES
from dvc.errors import BitstreamError
from dvc.slepian_wolf import ParityRequest, Round, drive
from dvc.wynerziv import _kernels, quantizer, transform
from dvc.wynerziv.payloads import EncodedFrame, PuncturedFrame, PunctureRecorder
from dvc.wynerziv.quantizer import FrameLayout
from tests.clips import moving_texture
from tests.reference import stream_reader
from tests.reference import wynerziv as reference
from tests.twins import Choose


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


def encoded_frame(layout: FrameLayout, seed: int, step_index: int = 16) -> EncodedFrame:
    return EncodedFrame.of(layout, random_luma(layout, seed), quantizer.STEPS[step_index])


def uncoded_planes(frame: EncodedFrame) -> np.ndarray:
    """Return the bits of all planes of a frame; shape (planes, N)."""
    chosen = np.arange(frame.quantization.num_planes)
    shifts = (63 - chosen % 64).astype(np.uint64)
    return ((frame.words[chosen // 64] >> shifts[:, None]) & np.uint64(1)).astype(np.uint8)


@given(layouts, st.data())
def test_header_round_trip(layout: FrameLayout, data: st.DataObject) -> None:
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
    frame = encoded_frame(layout, seed, step_index)
    quantization, expected = frame.quantization, 0
    for band in quantization.bands:
        assert quantization.first_plane[band] == expected
        assert quantization.planes[band] <= layout.max_planes[band]
        expected += quantization.planes[band]
    assert quantization.num_planes == expected
    assert frame.words.shape == (quantization.num_words, layout.num_bits)
    assert layout.num_bits == np.prod(layout.band_shape)


@given(layouts, st.integers(0, 2**32 - 1), step_indices)
def test_quantized_words_hold_the_digits_of_the_bins(layout: FrameLayout, seed: int, step_index: int) -> None:
    """The compiled encoder path puts the same bits into words as transform, quantiser and planes do."""
    frame = encoded_frame(layout, seed, step_index)
    quantization, planes = frame.quantization, uncoded_planes(frame)
    bands = transform.forward(random_luma(layout, seed)).reshape(16, -1)
    for band in quantization.bands:
        edges = quantization.edges(band)
        first, count = quantization.first_plane[band], quantization.planes[band]
        bins = reference.quantize(bands[band], edges)
        np.testing.assert_array_equal(planes[first : first + count], reference.to_planes(bins, count))


def hard_frames() -> list[np.ndarray]:
    """Return noise in black and white, chequerboards, stripes and flat frames, of odd sides."""
    noise = 255 * np.random.default_rng(8).integers(0, 2, (9, 14), dtype=np.uint8)
    rows, columns = np.mgrid[:9, :14]
    patterns = (rows + columns, rows, columns, rows // 2, columns // 2 + rows // 2)
    return [noise, *(255 * (pattern % 2).astype(np.uint8) for pattern in patterns), noise & 3, noise * 0]


@pytest.mark.parametrize("step_index", range(0, 64, 9))
def test_embedded_bins_are_those_of_the_formula(step_index: int) -> None:
    """From the finest step on, planes and bins of the largest and smallest coefficients are exact."""
    layout, step = layout_of(9, 14, None), quantizer.STEPS[step_index]
    most = 0
    for luma in hard_frames():
        bands = transform.forward(luma).reshape(16, -1)
        frame = EncodedFrame.of(layout, luma, step)
        quantization, words = frame.quantization, frame.words
        planes = [reference.embedded_planes(n, band.min(), band.max(), step) for n, band in enumerate(bands)]
        assert quantization.planes == tuple(planes)
        for n in range(layout.num_bits):
            numbers = [reference.embedded_bin(b, bands[b, n], step, planes[b]) for b in range(16)]
            digits = [digit for b in range(16) for digit in reference.binary_digits(numbers[b], planes[b])]
            got = [int(words[p // 64, n] >> np.uint64(63 - p % 64)) & 1 for p in range(len(digits))]
            assert got == digits
        most = max(most, sum(planes))
    assert step_index or most > 128


@pytest.mark.nojit
@settings(max_examples=50)
@given(layouts, st.integers(0, 2**32 - 1), step_indices)
def test_buffered_payload_gives_the_planes_back(layout: FrameLayout, seed: int, step_index: int) -> None:
    frame = encoded_frame(layout, seed, step_index)
    payload = frame.buffered_payload()
    read = EncodedFrame.read(layout, payload)
    assert read.quantization == frame.quantization
    np.testing.assert_array_equal(read.words, frame.words)
    levels = [] if layout.embedded else [1 << planes if planes else 0 for planes in layout.max_planes]
    config = {"width": layout.width, "height": layout.height, "levels": levels, "limited": False}
    assert stream_reader.read_frame(config, payload).planes == uncoded_planes(frame).tolist()


@pytest.mark.parametrize(("flat_rows", "share"), [(0, 1.05), (48, 0.85)])
def test_frames_take_about_the_entropy_of_their_bands(flat_rows: int, share: float) -> None:
    """Learning of contexts costs little; less is needed where a frame is flat in part."""
    luma = moving_texture(1, 96, 160)[0].luma
    luma[:flat_rows] = 128
    layout = layout_of(*luma.shape, None)
    frame = EncodedFrame.of(layout, luma, quantizer.STEPS[18])
    quantization = frame.quantization
    planes, entropy_bits = uncoded_planes(frame), 0.0
    for band in quantization.bands:
        first, count = quantization.first_plane[band], quantization.planes[band]
        bins = reference.from_planes(planes[first : first + count])
        shares = np.unique(bins, return_counts=True)[1] / bins.size
        entropy_bits -= bins.size * (shares * np.log2(shares)).sum()
    assert 0.5 * entropy_bits < 8 * len(frame.buffered_payload()) < share * entropy_bits


@settings(max_examples=300)
@given(
    layouts, st.integers(0, 2**32 - 1), st.lists(st.integers(0, 2**16 - 1), max_size=4), st.binary(max_size=9)
)
def test_any_payload_is_refused_or_the_only_one_of_its_planes(
    layout: FrameLayout, seed: int, flips: list[int], end: bytes
) -> None:
    changed = bytearray(encoded_frame(layout, seed).buffered_payload())
    for flip in flips:
        changed[flip // 8 % len(changed)] ^= 1 << flip % 8
    for data in (bytes(changed[: len(changed) - len(end) % 3]) + end, 7 * end):
        try:
            frame = EncodedFrame.read(layout, data)
        except BitstreamError:
            continue
        assert frame.words.shape == (frame.quantization.num_words, layout.num_bits)
        assert frame.buffered_payload() == data


@pytest.mark.parametrize("levels", [None, MATRICES[7]])
def test_buffered_payload_with_more_bytes_is_refused(levels: tuple[int, ...] | None) -> None:
    layout = layout_of(16, 16, levels)
    payload = encoded_frame(layout, 0).buffered_payload()
    for more in (b"\0", b"\1", bytes(9), b"\xff" * 9):
        with pytest.raises(BitstreamError, match="do not end as they are written"):
            EncodedFrame.read(layout, payload + more)
    header = layout.read_header(payload).header
    with pytest.raises(BitstreamError, match="damaged"):
        EncodedFrame.read(layout, header + b"\xff" * 40)


def test_header_that_is_not_filled_up_with_zeros_is_refused() -> None:
    layout = layout_of(8, 8, None)
    header = quantizer.quantization_of_step(9, (0,) * 16).header
    assert EncodedFrame.read(layout, header + b"\0").quantization.num_planes == 0
    with pytest.raises(BitstreamError, match="zeros"):
        EncodedFrame.read(layout, header[:-1] + bytes([header[-1] | 1]) + b"\0")


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
        (found,) = source.answer([ParityRequest(0, 3, "parity", 2, 7, count)])
        np.testing.assert_array_equal(found, bits)
    with pytest.raises(BitstreamError, match="are needed"):
        source.answer([ParityRequest(0, 0, "uncoded", 0, 0, 9)])


@pytest.mark.nojit
@pytest.mark.parametrize("levels", [2, 16, 256])
def test_quantising_kernels_equal_their_twins(levels: int, choose: Choose) -> None:
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
