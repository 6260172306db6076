"""All bits that may be asked of a Wyner-Ziv frame: at the encoder, and in payloads that hold them or some.

After the header, that payload holds the check bits, uncoded bits and parity of all planes; the punctured form
has, after the header, the bits that were asked for, in that order.
"""

from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dvc import slepian_wolf
from dvc.errors import BitstreamError
from dvc.slepian_wolf import ParityRequest, Round
from dvc.wynerziv import _kernels, quantizer, transform
from dvc.wynerziv.quantizer import FrameLayout, Quantization

Bits = NDArray[np.uint8]
Words = NDArray[np.uint64]
Result = TypeVar("Result")


Packing = Callable[[int], Words]
"""Gives words of at least so many of the first bands; their other planes, if there are, hold zeros."""


def quantize_frame(
    layout: FrameLayout, luma: NDArray[np.uint8], step_index: int = 0
) -> tuple[Quantization, Words]:
    """Transform and quantise a frame into bit planes, all planes of a coefficient position in one word."""
    quantization, packing = transform_frame(layout, luma, step_index)
    return quantization, packing(transform.NUM_BANDS)


def transform_frame(
    layout: FrameLayout, luma: NDArray[np.uint8], step_index: int = 0, room: NDArray[np.int16] | None = None
) -> tuple[Quantization, Packing]:
    """Transform a frame as `quantize_frame` does, but leave its planes for later."""
    core, extremes = transform.integer_core(luma, room)
    if layout.embedded:
        return _quantize_embedded(layout, core, extremes, step_index)
    quantization, words = _quantize_over_range(layout, core, extremes * transform.BAND_SCALE[:, None])
    return quantization, lambda _: words


def _quantize_embedded(
    layout: FrameLayout, core: NDArray[np.int16], extremes: NDArray[np.int16], step_index: int
) -> tuple[Quantization, Packing]:
    step = quantizer.step_from_index(step_index)
    planes = quantizer.embedded_planes(extremes, step)
    quantization = quantizer.quantization_of_step(step_index, tuple(planes.tolist()))

    def _pack(num_bands: int) -> Words:
        words = np.zeros((quantization.num_words, layout.num_bits), np.uint64)
        origins = quantizer.embedded_origins(planes)
        _kernels.pack_uniform(core[:num_bands], transform.BAND_SCALE, step, origins, planes, words)
        return words

    return quantization, _pack


def _quantize_over_range(
    layout: FrameLayout, core: NDArray[np.int16], extremes: NDArray[np.float64]
) -> tuple[Quantization, Words]:
    planes, scale = layout.max_planes, transform.BAND_SCALE
    indices = {
        band: quantizer.step_index(extremes[band], 1 << count)
        for band, count in enumerate(planes)
        if count and band
    }
    quantization = layout.over_range(indices)
    words = np.zeros((quantization.num_words, layout.num_bits), np.uint64)
    step = quantizer.DC_RANGE / (1 << planes[0])
    _kernels.pack_uniform(core[:1], scale, step, np.zeros(1), np.array(planes, np.int64), words)
    for band, index in indices.items():
        step, first = quantizer.step_from_index(index), quantization.first_plane[band]
        _kernels.pack_dead_zone(core[band], scale[band], step, planes[band], first, words)
    return quantization, words


def _wanted(request: ParityRequest) -> slice | NDArray[np.int64]:
    """Return which bits of a section are wanted."""
    if request.positions:
        return np.array(request.positions, np.int64)
    return slice(request.start, request.start + request.count)


class EncodedFrame:
    """Bit planes of one Wyner-Ziv frame with their check bits: all that may be asked for can be made of
    them.
    """

    def __init__(
        self,
        layout: FrameLayout,
        quantization: Quantization,
        words: Words | Packing,
        coder: slepian_wolf.PlaneCoder | None = None,
    ) -> None:
        self.layout, self.quantization = layout, quantization
        self.header = quantization.header
        self.num_packed_bands = 0
        self._packing: Packing | None = words if callable(words) else lambda _: words
        self._num_planes = quantization.num_planes
        self._coder = coder  # none, where nothing of the frame is asked for

    @property
    def words(self) -> Words:
        """Bit planes of all bands."""
        return self.pack(transform.NUM_BANDS)[0]

    @property
    def checks(self) -> Words:
        """Check bits of all planes."""
        return self.pack(transform.NUM_BANDS)[1]

    def pack(self, num_bands: int) -> tuple[Words, Words]:
        """Make sure that bit planes of the first bands are there; return them and their check bits."""
        if self._packing is not None and num_bands > self.num_packed_bands:
            self._words, self.num_packed_bands = self._packing(num_bands), num_bands
            if num_bands == transform.NUM_BANDS:
                self._packing = None  # what it holds is needed no more
            self._checks = np.empty((len(self._words), self.layout.crc_bits), np.uint64)
            for row, check in zip(self._words, self._checks, strict=True):
                check[:] = slepian_wolf.crc_words(row, self.layout.crc_bits)
        return self._words, self._checks

    def buffered_payload(self) -> bytes:
        """Pack the header and everything that may be asked; inverse of `BufferedFrame`."""
        assert self._coder is not None
        num_rows, num_bits = self.words.shape
        first = self.checks.shape[1] + num_bits
        words = np.empty((num_rows, first + self._coder.num_codes * num_bits), np.uint64)
        np.concatenate([self.checks, self.words], axis=1, out=words[:, :first])
        for code in range(self._coder.num_codes):
            parity = words[:, first + code * num_bits : first + (code + 1) * num_bits]
            for row, released in zip(self.words, parity, strict=True):
                self._coder.encode(code, row, released)
        size = -(-self._num_planes // 8)
        return self.header + words.T.astype(">u8", order="C").view(np.uint8)[:, :size].tobytes()


class BufferedFrame:
    """Answers requests from a buffered payload; reads only the bits that are asked for."""

    def __init__(self, layout: FrameLayout, payload: bytes, num_codes: int) -> None:
        quantization = layout.read_header(payload)
        self._crc_bits = uncoded = layout.crc_bits
        self._first = {("crc", 0): 0, ("uncoded", 0): uncoded}
        self._first |= {("parity", code): uncoded + (code + 1) * layout.num_bits for code in range(num_codes)}
        size = -(-quantization.num_planes // 8)
        header_bytes = len(quantization.header)
        expected = header_bytes + size * (uncoded + (num_codes + 1) * layout.num_bits)
        if len(payload) != expected:
            raise BitstreamError(f"buffered Wyner-Ziv frame of {len(payload)} bytes, expected {expected}")
        self._words = np.frombuffer(payload, np.uint8)[header_bytes:]
        self._words = self._words.reshape(-1, max(size, 1))

    def answer(self, request: ParityRequest) -> Bits:
        """Return the bits that a request asks for."""
        if request.kind == "joint":
            whole = replace(request, kind="crc", start=0, count=self._crc_bits, positions=())
            checks = [self.answer(replace(whole, plane=plane)) for plane in request.positions]
            return slepian_wolf.joint_check(np.stack(checks))[: request.count]
        code = request.code if request.kind == "parity" else 0
        column = self._words[self._first[request.kind, code] :][_wanted(request), request.plane // 8]
        return (column >> np.uint8(7 - request.plane % 8)) & np.uint8(1)


def disagreement(found: str) -> BitstreamError:
    """Return the error of a punctured stream that holds what another decoder asked for."""
    return BitstreamError(
        f"the punctured stream was made for other predictions than this decoder's: {found}"
        " (are the libraries of the versions that docs/bitstream.md names?)"
    )


class PuncturedFrame:
    """Answers requests from a punctured payload: whatever is asked, the next bits are the answer."""

    def __init__(self, layout: FrameLayout, payload: bytes) -> None:
        header_bytes = len(layout.read_header(payload).header)
        self._bits = np.unpackbits(np.frombuffer(payload, np.uint8)[header_bytes:])
        self._position = 0

    def answer(self, request: ParityRequest) -> Bits:
        """Return the next bits."""
        stop = self._position + request.count
        if stop > self._bits.size:
            raise disagreement(f"a Wyner-Ziv frame has {self._bits.size} bits, {stop} are needed")
        bits = self._bits[self._position : stop]
        self._position = stop
        return bits


class PunctureRecorder:
    """Collects the answers to requests as they pass, to be written as a punctured payload."""

    def __init__(self) -> None:
        self._bits: list[Bits] = []

    def watch(
        self, coroutine: Generator[Round, Sequence[Bits], Result]
    ) -> Generator[Round, Sequence[Bits], Result]:
        """Pass on requests of a coroutine, and keep the answers."""
        try:
            requests = next(coroutine)
            while True:
                answers = yield requests
                self._bits += answers
                requests = coroutine.send(answers)
        except StopIteration as stop:
            result: Result = stop.value
            return result

    def payload(self, header: bytes) -> bytes:
        """Pack what was collected; `PuncturedFrame` answers with it."""
        bits = np.concatenate(self._bits) if self._bits else np.zeros(0, np.uint8)
        return header + np.packbits(bits).tobytes()
