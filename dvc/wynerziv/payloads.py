"""Bit planes of a Wyner-Ziv frame, and its payloads.

A buffered payload is the header and the losslessly coded bins; the planes are digits of these. A punctured
payload is the header and the requested bits, in the order of the requests.
"""

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from dvc.entropy import RangeCoder, context_counts
from dvc.errors import BitstreamError
from dvc.slepian_wolf import Round
from dvc.wynerziv import _kernels, quantizer, transform
from dvc.wynerziv.quantizer import FrameLayout, Quantization

Bits = NDArray[np.uint8]
Words = NDArray[np.uint64]
Result = TypeVar("Result")


def _code_bins(coder: RangeCoder, layout: FrameLayout, quantization: Quantization, words: Words) -> None:
    """Code the bins of a frame from the words of its planes, or decode them into zeroed words."""
    counts = context_counts(np.full(_kernels.SURROUNDINGS**2 * _kernels.BIN_CONTEXTS, 50))
    energy = np.zeros(layout.num_bits, np.int32)
    for band in quantization.bands:
        planes = quantization.planes[band], quantization.first_plane[band]
        state = coder.room_for(layout.num_bits * 2 * (1 + planes[0]))
        zero, columns = quantization.zero_bin(band), layout.band_shape[1]
        _kernels.code_band(state, counts, band, planes, zero, columns, words, energy)


@dataclass(frozen=True, eq=False)
class EncodedFrame:
    """Bit planes of one Wyner-Ziv frame, from which all parity is computed."""

    layout: FrameLayout
    quantization: Quantization
    words: Words  # shape (num_words, N)

    @classmethod
    def of(cls, layout: FrameLayout, luma: NDArray[np.uint8], step: float = 1.0) -> Self:
        """Transform and quantise a frame; all planes of a coefficient position share a word."""
        core, extremes = transform.integer_core(luma)
        scale = transform.BAND_SCALE
        if layout.embedded:
            step_index = quantizer.index_of_step(step)
            step = quantizer.STEPS[step_index]
            planes = quantizer.embedded_planes(extremes, step)
            quantization = quantizer.quantization_of_step(step_index, tuple(planes.tolist()))
            words = np.zeros((quantization.num_words, layout.num_bits), np.uint64)
            origins = quantizer.ORIGINS[np.arange(transform.NUM_BANDS), planes]
            _kernels.pack_uniform(core, scale, step, origins, planes, words)
            return cls(layout, quantization, words)
        counts, ends = layout.max_planes, extremes * scale[:, None]
        indices = {
            band: quantizer.step_index(ends[band], 1 << count)
            for band, count in enumerate(counts)
            if count and band
        }
        quantization = layout.over_range(indices)
        words = np.zeros((quantization.num_words, layout.num_bits), np.uint64)
        step = quantizer.DC_RANGE / (1 << counts[0])
        _kernels.pack_uniform(core[:1], scale, step, np.zeros(1), np.array(counts, np.int64), words)
        for band, index in indices.items():
            step, first = quantizer.STEPS[index], quantization.first_plane[band]
            _kernels.pack_dead_zone(core[band], scale[band], step, counts[band], first, words)
        return cls(layout, quantization, words)

    @property
    def header(self) -> bytes:
        """Coded quantisers of the frame."""
        return self.quantization.header

    @classmethod
    def read(cls, layout: FrameLayout, payload: bytes) -> Self:
        """Read a frame from its buffered payload; inverse of `buffered_payload`."""
        quantization = layout.read_header(payload)
        words = np.zeros((quantization.num_words, layout.num_bits), np.uint64)
        header, data = payload[: len(quantization.header)], payload[len(quantization.header) :]
        if header != quantization.header:
            raise BitstreamError("the header of a Wyner-Ziv frame is not filled up with zeros")
        coder = RangeCoder.reader(data)
        _code_bins(coder, layout, quantization, words)
        coder.check_end(data)
        return cls(layout, quantization, words)

    def buffered_payload(self) -> bytes:
        """Pack the header and the planes; inverse of `read`."""
        coder = RangeCoder.writer()
        _code_bins(coder, self.layout, self.quantization, self.words)
        return self.header + coder.to_bytes(shortest=True)


def disagreement(found: str) -> BitstreamError:
    """Return the error of a punctured stream with the requests of another decoder."""
    return BitstreamError(
        f"the punctured stream was made for other predictions than this decoder's: {found}"
        " (are the libraries of the versions that docs/spec/bitstream.md names?)"
    )


class PuncturedFrame:
    """Answers each request with the next bits of a punctured payload."""

    def __init__(self, layout: FrameLayout, payload: bytes) -> None:
        header_bytes = len(layout.read_header(payload).header)
        self._bits = np.unpackbits(np.frombuffer(payload, np.uint8)[header_bytes:])
        self._position = 0

    def answer(self, requests: Round) -> list[Bits]:
        """Return the next bits for each request."""
        answers = []
        for request in requests:
            start, self._position = self._position, self._position + request.count
            if self._position > self._bits.size:
                needed = f"{self._position} are needed"
                raise disagreement(f"a Wyner-Ziv frame has {self._bits.size} bits, {needed}")
            answers.append(self._bits[start : self._position])
        return answers


class PunctureRecorder:
    """Collects the answers to requests for a punctured payload."""

    def __init__(self) -> None:
        self._bits: list[Bits] = []

    def watch(
        self, coroutine: Generator[Round, Sequence[Bits], Result]
    ) -> Generator[Round, Sequence[Bits], Result]:
        """Forward the requests of a coroutine and collect the answers."""
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
        """Pack the collected bits; `PuncturedFrame` answers from them."""
        bits = np.concatenate(self._bits) if self._bits else np.zeros(0, np.uint8)
        return header + np.packbits(bits).tobytes()
