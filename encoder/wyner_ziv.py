"""Wyner-Ziv side of the encoder: transform, quantiser and bit planes; and what is written of them."""

from collections.abc import Sequence
from typing import ClassVar

from dvc import slepian_wolf
from dvc.config import CodecConfig, Delivery, Live, NoFeedback
from dvc.stream import Form
from dvc.video import Frame
from dvc.wynerziv import quantizer
from dvc.wynerziv.encoder_buffer import EncoderBuffer
from dvc.wynerziv.payloads import EncodedFrame, quantize_frame
from dvc.wynerziv.quantizer import FrameLayout


class WynerZivEncoder:
    """Encodes Wyner-Ziv frames of one configuration, of which a decoder may ask for any parity."""

    form: ClassVar[Form] = Form.BUFFERED

    def __init__(self, config: CodecConfig) -> None:
        self._layout = FrameLayout.of(config)
        self._coder = slepian_wolf.plane_coder(config)

    def encode(self, frame: Frame, step: float = 1.0) -> EncodedFrame:
        """Encode one frame; parity is computed when it is asked for."""
        step_index = quantizer.index_of_step(step)
        return EncodedFrame(self._layout, *quantize_frame(self._layout, frame.luma, step_index))

    def encode_group(self, frames: Sequence[Frame], steps: Sequence[float]) -> tuple[EncodedFrame, ...]:
        """Encode the frames of a group of pictures."""
        return tuple(map(self.encode, frames, steps))

    def payloads(self, frames: Sequence[EncodedFrame]) -> tuple[bytes, ...]:
        """Return what a stream holds of frames."""
        return tuple(frame.buffered_payload() for frame in frames)

    def encoder_buffer(self, num_slots: int) -> EncoderBuffer:
        """Return what answers requests for frames of this configuration."""
        return EncoderBuffer(self._layout, self._coder, num_slots)


class LiveEncoder(WynerZivEncoder):
    """Encodes Wyner-Ziv frames for a decoder that asks: a record holds no more than their headers."""

    def payloads(self, frames: Sequence[EncodedFrame]) -> tuple[bytes, ...]:
        """Return the headers of frames."""
        return tuple(frame.header for frame in frames)


def wyner_ziv_encoder(config: CodecConfig, delivery: Delivery) -> WynerZivEncoder | None:
    """Return the encoder for a way of delivery; none without feedback, where nothing is sent."""
    if isinstance(delivery, NoFeedback):
        return None
    return LiveEncoder(config) if isinstance(delivery, Live) else WynerZivEncoder(config)
