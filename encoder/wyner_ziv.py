"""Wyner-Ziv side of the encoder: transform, quantiser and bit planes; and what is written of them."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from dvc import slepian_wolf
from dvc.config import CodecConfig, Delivery, EstimatedRate, Live
from dvc.stream import Form
from dvc.video import Frame
from dvc.wynerziv import quantizer, transform
from dvc.wynerziv.encoder_buffer import EncoderBuffer
from dvc.wynerziv.payloads import EncodedFrame, transform_frame
from dvc.wynerziv.quantizer import FrameLayout
from encoder.groups import Group
from encoder.rate_control.bitrate import ExpectedBits
from encoder.rate_control.controller import GroupPlan, RateController


class WynerZivEncoder:
    """Encodes Wyner-Ziv frames of one configuration, of which a decoder may ask for any parity."""

    form: ClassVar[Form] = Form.BUFFERED
    cpu_field: ClassVar[str] = "parity_cpu_s"
    """What the time of `payloads` counts as."""

    def __init__(self, config: CodecConfig, rate_margin_percent: int = 0) -> None:
        self._layout = FrameLayout.of(config)
        self._coder = slepian_wolf.plane_coder(config)
        self._controller = RateController(config, rate_margin_percent)
        self._plan: GroupPlan | None = None
        self.work = self._controller.work

    def encode(self, frame: Frame, step: float = 1.0) -> EncodedFrame:
        """Encode one frame; parity is computed when it is asked for."""
        encoded = self._transformed(frame, step, None)
        encoded.pack(transform.NUM_BANDS)
        return encoded

    def encode_group(self, frames: Sequence[Frame], steps: Sequence[float]) -> tuple[EncodedFrame, ...]:
        """Encode the frames of a group of pictures."""
        return tuple(map(self.encode, frames, steps))

    def payloads(self, group: Group, frames: Sequence[EncodedFrame]) -> tuple[bytes, ...]:
        """Return what a stream holds of the frames of a group."""
        del group
        return tuple(frame.buffered_payload() for frame in frames)

    def expect(self, group: Group, frames: Sequence[EncodedFrame], qp: int) -> ExpectedBits:
        """Tell what headers of the next group take, and by the QP of its key frame what else is estimated."""
        self._plan = self._controller.plan(group, frames, qp)
        headers = np.array([8 * len(frame.header) for frame in frames])
        bits = self._plan.frame_bits()
        return ExpectedBits(float(headers.sum()), float(bits.max(initial=0.0)), bits - headers)

    def encoder_buffer(self, num_slots: int) -> EncoderBuffer:
        """Return what answers requests for frames of this configuration."""
        return EncoderBuffer(self._layout, self._coder, num_slots)

    def _transformed(self, frame: Frame, step: float, memory: NDArray[np.int16] | None) -> EncodedFrame:
        """Transform a frame; its planes are packed when they are needed."""
        step_index = quantizer.index_of_step(step)
        quantization, packing = transform_frame(self._layout, frame.luma, step_index, memory)
        return EncodedFrame(self._layout, quantization, packing)


class LiveEncoder(WynerZivEncoder):
    """Encodes Wyner-Ziv frames for a decoder that asks: a record holds no more than their headers."""

    def payloads(self, group: Group, frames: Sequence[EncodedFrame]) -> tuple[bytes, ...]:
        """Return the headers of the frames of a group."""
        del group
        if self._plan is not None:
            self._controller.go_on(self._plan)
        return tuple(frame.header for frame in frames)


class RateControlledEncoder(WynerZivEncoder):
    """Encodes Wyner-Ziv frames without a feedback channel: as much as is estimated to be needed."""

    form = Form.NO_FEEDBACK
    cpu_field = "rate_control_cpu_s"

    def __init__(self, config: CodecConfig, delivery: EstimatedRate) -> None:
        super().__init__(config, delivery.rate_margin_percent)
        self._memory: list[NDArray[np.int16]] = []

    def encode_group(self, frames: Sequence[Frame], steps: Sequence[float]) -> tuple[EncodedFrame, ...]:
        """Transform the frames of a group; planes are packed as needed, as long as it is the last group."""
        while len(self._memory) < len(frames):
            self._memory.append(np.empty((transform.NUM_BANDS, self._layout.num_bits), np.int16))
        return tuple(map(self._transformed, frames, steps, self._memory))

    def expect(self, group: Group, frames: Sequence[EncodedFrame], qp: int) -> ExpectedBits:
        """Choose what is sent of the frames of the next group, and tell what that takes."""
        self._plan = self._controller.plan(group, frames, qp)
        bits = self._plan.frame_bits()
        return ExpectedBits(float(bits.sum()), float(bits.max(initial=0.0)))

    def payloads(self, group: Group, frames: Sequence[EncodedFrame]) -> tuple[bytes, ...]:
        """Pack what is sent of the frames of a group, chosen here if it was not."""
        plan, self._plan = self._plan or self._controller.plan(group, frames), None
        return self._controller.payloads(plan)


def wyner_ziv_encoder(config: CodecConfig, delivery: Delivery) -> WynerZivEncoder:
    """Return the encoder for a way of delivery."""
    if isinstance(delivery, EstimatedRate):
        return RateControlledEncoder(config, delivery)
    return LiveEncoder(config) if isinstance(delivery, Live) else WynerZivEncoder(config)
