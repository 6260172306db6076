"""Where things are in a Wyner-Ziv frame: bands, bit planes, and the header with the step of each band.

Planes are numbered over the whole frame in decoding order: bands in zigzag order, each from its most
significant plane down. A frame's payload starts with the step indices of its AC bands.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dvc.config import CodecConfig
from dvc.errors import BitstreamError
from dvc.wynerziv import bitplanes, quantizer, transform


@dataclass(frozen=True)
class FrameLayout:
    """Where things are in a Wyner-Ziv frame of one configuration.

    Attributes
    ----------
    height, width : int
        Sides of the luma plane in pixels.
    levels : tuple of int
        Quantiser levels of the 16 bands, in zigzag order.
    planes : tuple of int
        Bit planes of each of them; 0 where it is not sent.
    crc_bits : int
        Length of each plane's checksum.
    """

    height: int
    width: int
    levels: tuple[int, ...]
    planes: tuple[int, ...]
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
        video, quantised = config.video, config.wyner_ziv
        return cls(video.height, video.width, quantised.levels, quantised.planes, config.turbo.crc_bits)

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
        return {band: sum(self.planes[:band]) for band in self.bands}

    @cached_property
    def num_planes(self) -> int:
        """Planes in a frame."""
        return sum(self.planes)

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
