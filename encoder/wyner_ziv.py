"""Wyner-Ziv side of the encoder: transform, quantiser, bit planes and their parity."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dvc import slepian_wolf
from dvc.config import CodecConfig
from dvc.video import Frame
from dvc.wynerziv import quantizer, transform
from dvc.wynerziv.answers.open_frames import OpenFrames
from dvc.wynerziv.buffered import EncodedFrame, transform_frame
from dvc.wynerziv.layout import FrameLayout


class WynerZivEncoder:
    """Encodes Wyner-Ziv frames of one configuration."""

    def __init__(self, config: CodecConfig, *, lazily: bool = False) -> None:
        self._layout = FrameLayout.of(config)
        self._lazily = lazily
        self._rooms: list[NDArray[np.int16]] = []
        self._encoders = slepian_wolf.parity_encoders(config.turbo.family, config.turbo.interleaver_seed)

    def encode(self, frame: Frame, step: float = 1.0) -> EncodedFrame:
        """Encode one frame; parity is computed when it is asked for."""
        return self.encode_group([frame], [step])[0]

    def encode_group(self, frames: Sequence[Frame], steps: Sequence[float]) -> tuple[EncodedFrame, ...]:
        """Encode the frames of a group of pictures."""
        encoded = []
        for index, (frame, step) in enumerate(zip(frames, steps, strict=True)):
            room = self._room(index) if self._lazily else None
            step_index = quantizer.index_of_step(step)
            quantization, packing = transform_frame(self._layout, frame.luma, step_index, room)
            encoded.append(EncodedFrame(self._layout, quantization, packing, self._encoders))
            if not self._lazily:
                encoded[-1].pack(transform.NUM_BANDS)
        return tuple(encoded)

    def _room(self, index: int) -> NDArray[np.int16]:
        """Return memory for coefficients, the same for frames of one place in their group."""
        if index == len(self._rooms):
            self._rooms.append(np.empty((transform.NUM_BANDS, self._layout.num_bits), np.int16))
        return self._rooms[index]

    def open_frames(self, num_slots: int) -> OpenFrames:
        """Return what answers requests for frames of this configuration."""
        return OpenFrames(self._layout, self._encoders, num_slots)
