"""Groups of pictures that are encoded before a decoder has room for them, since their frames have come."""

import zlib
from collections import deque
from typing import NamedTuple

import numpy as np

from dvc.bits import decode_bytes, encode_varint
from dvc.config import CodecConfig
from dvc.stream import decode_gop, encode_gop
from dvc.wynerziv.payloads import EncodedFrame
from dvc.wynerziv.quantizer import FrameLayout
from encoder.frame_queue import FrameQueue
from encoder.kept_groups import KeptGroup
from encoder.session import EncodedGroup
from encoder.spool import Spool

_FAST = 1
"""Level of compression."""


class _Waiting(NamedTuple):
    number: int
    first_frame: int


class GroupsAhead:
    """Keeps them in a spool, and says when there is another one to be encoded."""

    def __init__(self, spool: Spool, queue: FrameQueue, config: CodecConfig) -> None:
        self._spool, self._queue = spool, queue
        self._length, self._layout = config.gop.length, FrameLayout.of(config)
        self._waiting: deque[_Waiting] = deque()

    @property
    def can_grow(self) -> bool:
        """Whether there is room for another group, whose frames have come."""
        return self._spool.has_room and self._queue.holds(self._length)

    def add(self, group: KeptGroup) -> None:
        """Let a group wait."""
        record, frames = group.encoded.record, group.encoded.frames
        packed = encode_gop(record)
        planes = b"".join(frame.words.tobytes() for frame in frames)
        self._spool.put(encode_varint(len(packed)) + packed + zlib.compress(planes, _FAST))
        self._waiting.append(_Waiting(group.number, group.first_frame))

    def take(self) -> KeptGroup | None:
        """Return the first one, if there is any."""
        if not self._waiting:
            return None
        number, first_frame = self._waiting.popleft()
        data = self._spool.take()
        packed, position = decode_bytes(data, 0, len(data))
        record = decode_gop(packed)
        planes = bytearray(
            zlib.decompress(data[position:])
        )  # kernels are compiled for words that may be written
        words = np.frombuffer(planes, np.uint64).reshape(-1, self._layout.num_bits)
        frames, row = [], 0
        for header in record.wyner_ziv:
            quantization = self._layout.read_header(header)
            rows = words[row : row + quantization.num_words]
            frames.append(EncodedFrame(self._layout, quantization, rows))
            row += quantization.num_words
        return KeptGroup(number, first_frame, EncodedGroup(record, tuple(frames)))
