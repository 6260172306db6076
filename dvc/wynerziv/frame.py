"""What one Wyner-Ziv frame is on the wire: bands, bit planes, steps, CRC bits, parity and plain bits.

Planes are numbered over the whole frame in decoding order: bands in zigzag order, each from its most
significant plane down. A frame's payload starts with the step indices of its AC bands. In the buffered form
all CRC, plain and parity bits follow, plane by plane; in the punctured form only the bits that the decoder
asked for, in the order in which it did.
"""

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from dvc import turbo
from dvc.config import CodecConfig
from dvc.errors import BitstreamError
from dvc.wynerziv import bitplanes, quantizer, transform

Bits = NDArray[np.uint8]
Words = NDArray[np.uint64]
Request = TypeVar("Request")
Result = TypeVar("Result")


class PlaneQuestion(Protocol):
    """The part of a parity request that says which bits of a plane are wanted."""

    @property
    def plane(self) -> int:
        """Number of the plane in the frame."""

    @property
    def kind(self) -> str:
        """One of crc, parity, plain."""

    @property
    def code(self) -> int:
        """Number of the turbo code in the family; parity only."""

    @property
    def start(self) -> int:
        """First bit wanted."""

    @property
    def count(self) -> int:
        """How many bits are wanted."""


@dataclass(frozen=True)
class FrameLayout:
    """Where things are in a Wyner-Ziv frame of one configuration.

    Attributes
    ----------
    height, width : int
        Sides of the luma plane in pixels.
    levels : tuple of int
        Quantiser levels of the 16 bands, in zigzag order.
    crc_bits : int
        Length of each plane's checksum.
    """

    height: int
    width: int
    levels: tuple[int, ...]
    crc_bits: int

    @classmethod
    def of(cls, config: CodecConfig) -> "FrameLayout":
        """Return the layout of a configuration.

        Parameters
        ----------
        config : CodecConfig
            Configuration of the stream.

        Returns
        -------
        FrameLayout
            Layout of each of its Wyner-Ziv frames.
        """
        video = config.video
        return cls(video.height, video.width, config.wyner_ziv.levels, config.turbo.crc_bits)

    @cached_property
    def band_shape(self) -> tuple[int, int]:
        """Rows and columns of 4x4 blocks."""
        return transform.band_shape(self.height, self.width)

    @cached_property
    def num_bits(self) -> int:
        """Bits in a plane, which is blocks in a frame."""
        return self.band_shape[0] * self.band_shape[1]

    @cached_property
    def bands(self) -> tuple[int, ...]:
        """Bands that are sent, in decoding order."""
        return tuple(band for band, levels in enumerate(self.levels) if levels)

    @cached_property
    def first_plane(self) -> dict[int, int]:
        """Frame-wide number of each sent band's most significant plane."""
        counts = [quantizer.num_planes(self.levels[band]) for band in self.bands]
        return dict(zip(self.bands, np.cumsum([0, *counts[:-1]]).tolist(), strict=True))

    @cached_property
    def num_planes(self) -> int:
        """Planes in a frame."""
        return sum(quantizer.num_planes(levels) for levels in self.levels)

    @property
    def num_words(self) -> int:
        """Words of 64 bits that hold one bit of each plane."""
        return -(-self.num_planes // 64)

    @property
    def header_bytes(self) -> int:
        """Size of the step indices."""
        return -(-len(self._stepped_bands) * quantizer.STEP_INDEX_BITS // 8)

    @property
    def _stepped_bands(self) -> tuple[int, ...]:
        return tuple(band for band in self.bands if band > 0)

    def write_header(self, step_indices: dict[int, int]) -> bytes:
        """Pack the step indices; inverse of `read_header`.

        Parameters
        ----------
        step_indices : dict of int to int
            Index for `quantizer.step_from_index` of each AC band that is sent.

        Returns
        -------
        bytes
            `header_bytes` bytes.
        """
        values = np.array([step_indices[band] for band in self._stepped_bands], dtype=np.int64)
        return np.packbits(bitplanes.to_planes(values, quantizer.STEP_INDEX_BITS).T.ravel()).tobytes()

    def read_header(self, data: bytes) -> dict[int, int]:
        """Unpack the step indices; inverse of `write_header`.

        Parameters
        ----------
        data : bytes
            A payload of a frame; what follows the header is ignored.

        Returns
        -------
        dict of int to int
            Step index of each AC band that is sent.

        Raises
        ------
        BitstreamError
            If the payload is shorter than the header.
        """
        if len(data) < self.header_bytes:
            raise BitstreamError(
                f"Wyner-Ziv frame of {len(data)} bytes lacks its {self.header_bytes}-byte header"
            )
        bits = np.unpackbits(np.frombuffer(data[: self.header_bytes], np.uint8))
        used = bits[: len(self._stepped_bands) * quantizer.STEP_INDEX_BITS]
        values = bitplanes.from_planes(used.reshape(-1, quantizer.STEP_INDEX_BITS).T)
        return dict(zip(self._stepped_bands, values.tolist(), strict=True))

    def edges(self, band: int, step_indices: dict[int, int]) -> NDArray[np.float64]:
        """Return the borders of a band's bins.

        Parameters
        ----------
        band : int
            A band that is sent.
        step_indices : dict of int to int
            From `read_header`.

        Returns
        -------
        ndarray of shape (num_bins + 1,), float64
            See `quantizer.bin_edges`.
        """
        step = quantizer.step_from_index(step_indices[band]) if band else None
        return quantizer.bin_edges(self.levels[band], step)


def quantize_frame(layout: FrameLayout, luma: NDArray[np.uint8]) -> tuple[dict[int, int], Words]:
    """Transform and quantise a frame into bit planes, all planes of a coefficient position in one word.

    Parameters
    ----------
    layout : FrameLayout
        Layout of the frame.
    luma : ndarray of shape (H, W), uint8
        Luma samples.

    Returns
    -------
    step_indices : dict of int to int
        Step index of each AC band that is sent.
    words : ndarray of shape (ceil(num_planes / 64), num_bits), uint64
        Plane p stands in bit 63 - p % 64 of row p // 64; planes in decoding order.
    """
    from dvc.wynerziv import _kernels

    raster = np.empty((transform.NUM_BANDS, layout.num_bits))
    _kernels.transform_blocks(transform.pad_to_blocks(luma), transform.SCALE, raster)
    steps: dict[int, int] = {}
    words = np.zeros((layout.num_words, layout.num_bits), dtype=np.uint64)
    for band in layout.bands:
        coefficients = raster[transform.BLOCK * transform.ZIGZAG[band, 0] + transform.ZIGZAG[band, 1]]
        levels, first = layout.levels[band], layout.first_plane[band]
        planes = quantizer.num_planes(levels)
        if band:
            steps[band] = quantizer.step_index(coefficients, levels)
            step = quantizer.step_from_index(steps[band])
            _kernels.pack_dead_zone(coefficients, step, planes, first, words)
        else:
            _kernels.pack_uniform(coefficients, quantizer.DC_RANGE / levels, planes, first, words)
    return steps, words


class EncodedFrame:
    """All bits that may be asked of one Wyner-Ziv frame; parity is computed when a code is first needed.

    Parameters
    ----------
    layout : FrameLayout
        Layout of the frame.
    header : bytes
        Step indices, as `FrameLayout.write_header` packs them.
    words : ndarray of shape (W, N), uint64
        Bit planes, from `quantize_frame`.
    codes : sequence of TurboCode
        Code family of the configuration.
    interleaver_seed : int
        Seed of the interleavers.
    """

    def __init__(
        self,
        layout: FrameLayout,
        header: bytes,
        words: Words,
        codes: Sequence[turbo.TurboCode],
        interleaver_seed: int,
    ) -> None:
        self.header = header
        self._layout = layout
        self._words = words
        self._codes = codes
        self._seed = interleaver_seed
        self._parity: dict[int, Words] = {}
        self._crc = np.stack([turbo.crc_words(row, layout.crc_bits) for row in words])

    def _parity_words(self, code: int) -> Words:
        if code not in self._parity:
            self._parity[code] = np.empty_like(self._words)
            self._encode(code, self._parity[code])
        return self._parity[code]

    def _encode(self, code: int, parity: Words) -> None:
        for row, released in zip(self._words, parity, strict=True):
            turbo.encode_words(row, self._codes[code], self._seed, released)

    def answer(self, question: PlaneQuestion) -> Bits:
        """Return the bits that a request asks for.

        Parameters
        ----------
        question : PlaneQuestion
            Kind, plane, code and range.

        Returns
        -------
        ndarray of shape (count,), uint8
            The bits.

        Raises
        ------
        ValueError
            If the request asks for what does not exist.
        """
        if not 0 <= question.plane < self._layout.num_planes:
            raise ValueError(f"plane {question.plane} of {self._layout.num_planes}")
        if question.kind not in ("crc", "plain", "parity") or not 0 <= question.code < len(self._codes):
            raise ValueError(f"no {question.kind!r} bits of code {question.code}")
        if question.kind == "parity":
            words = self._parity_words(question.code)
        else:
            words = self._crc if question.kind == "crc" else self._words
        stop = question.start + question.count
        if not 0 <= question.start <= stop <= words.shape[1]:
            raise ValueError(f"bits {question.start}+{question.count} of {words.shape[1]}")
        row = words[question.plane // 64, question.start : stop]
        return ((row >> np.uint64(63 - question.plane % 64)) & np.uint64(1)).astype(np.uint8)

    def buffered_payload(self) -> bytes:
        """Pack the header and everything that may be asked; inverse of `BufferedFrame`.

        Returns
        -------
        bytes
            Payload of the buffered form: after the header, CRC, plain bits and the parity of each code; in
            each of them one big-endian word of ``ceil(num_planes / 8)`` bytes per bit position.
        """
        num_rows, num_bits = self._words.shape
        first = self._crc.shape[1] + num_bits
        words = np.empty((num_rows, first + len(self._codes) * num_bits), np.uint64)
        np.concatenate([self._crc, self._words], axis=1, out=words[:, :first])
        for code in range(len(self._codes)):
            self._encode(code, words[:, first + code * num_bits : first + (code + 1) * num_bits])
        size = -(-self._layout.num_planes // 8)
        return self.header + words.T.astype(">u8", order="C").view(np.uint8)[:, :size].tobytes()


class BufferedFrame:
    """Answers requests from a buffered payload; reads only the bits that are asked for.

    Parameters
    ----------
    layout : FrameLayout
        Layout of the frame.
    payload : bytes
        What `EncodedFrame.buffered_payload` packed.
    num_codes : int
        Codes in the family.

    Raises
    ------
    BitstreamError
        If the payload's size is not that of the layout.
    """

    def __init__(self, layout: FrameLayout, payload: bytes, num_codes: int) -> None:
        plain = layout.crc_bits
        self._first = {("crc", 0): 0, ("plain", 0): plain}
        self._first |= {("parity", code): plain + (code + 1) * layout.num_bits for code in range(num_codes)}
        size = -(-layout.num_planes // 8)
        expected = layout.header_bytes + size * (plain + (num_codes + 1) * layout.num_bits)
        if len(payload) != expected:
            raise BitstreamError(f"buffered Wyner-Ziv frame of {len(payload)} bytes, expected {expected}")
        self._words = np.frombuffer(payload, np.uint8)[layout.header_bytes :].reshape(-1, max(size, 1))

    def answer(self, question: PlaneQuestion) -> Bits:
        """Return the bits that a request asks for.

        Parameters
        ----------
        question : PlaneQuestion
            Kind, plane, code and range; taken from this program's own decoder, not from outside.

        Returns
        -------
        ndarray of shape (count,), uint8
            The bits.
        """
        code = question.code if question.kind == "parity" else 0
        first = self._first[question.kind, code] + question.start
        column = self._words[first : first + question.count, question.plane // 8]
        return (column >> np.uint8(7 - question.plane % 8)) & np.uint8(1)


class PuncturedFrame:
    """Answers requests from a punctured payload: whatever is asked, the next bits are the answer.

    Parameters
    ----------
    layout : FrameLayout
        Layout of the frame.
    payload : bytes
        Header and bits that `PunctureRecorder` collected.
    """

    def __init__(self, layout: FrameLayout, payload: bytes) -> None:
        self._bits = np.unpackbits(np.frombuffer(payload, np.uint8)[layout.header_bytes :])
        self._position = 0

    def answer(self, question: PlaneQuestion) -> Bits:
        """Return the next bits.

        Parameters
        ----------
        question : PlaneQuestion
            Only its count matters.

        Returns
        -------
        ndarray of shape (count,), uint8
            The bits.

        Raises
        ------
        BitstreamError
            If the payload ends before.
        """
        stop = self._position + question.count
        if stop > self._bits.size:
            raise BitstreamError(
                f"punctured Wyner-Ziv frame ends after {self._bits.size} bits, {stop} are needed"
            )
        bits = self._bits[self._position : stop]
        self._position = stop
        return bits

    def finish(self) -> None:
        """Check that the payload has been used up.

        Raises
        ------
        BitstreamError
            If bits are left over, which no encoder writes.
        """
        if self._bits.size - self._position >= 8:
            raise BitstreamError(
                f"punctured Wyner-Ziv frame has {self._bits.size - self._position} bits left over"
            )


class PunctureRecorder:
    """Collects the bits that were asked for, to be written as a punctured payload."""

    def __init__(self) -> None:
        self._bits: list[Bits] = []

    def watch(self, coroutine: Generator[Request, Bits, Result]) -> Generator[Request, Bits, Result]:
        """Pass requests and answers through, and keep the answers.

        Parameters
        ----------
        coroutine : generator
            Yields requests, is sent bits.

        Yields
        ------
        request
            Each request of the coroutine.

        Returns
        -------
        object
            What the coroutine returns.
        """
        try:
            request = next(coroutine)
            while True:
                bits = yield request
                self._bits.append(bits)
                request = coroutine.send(bits)
        except StopIteration as stop:
            result: Result = stop.value
            return result

    def payload(self, header: bytes) -> bytes:
        """Pack what was collected.

        Parameters
        ----------
        header : bytes
            Header of the frame.

        Returns
        -------
        bytes
            Payload of the punctured form.
        """
        bits = np.concatenate(self._bits) if self._bits else np.zeros(0, np.uint8)
        return header + np.packbits(bits).tobytes()
