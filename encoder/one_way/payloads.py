"""Payloads of the one-way form: what a group of pictures needs, told by its own frames and tracks."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dvc.config import CodecConfig
from dvc.video.frames import Plane
from dvc.wynerziv.buffered import EncodedFrame
from dvc.wynerziv.hierarchy import group_order, reference_distance
from dvc.wynerziv.one_way import encode_payload
from encoder.groups import Group
from encoder.one_way.needs import NeedEstimator
from encoder.one_way.residuals import motion_field, residual_magnitudes


class OneWayEncoder:
    """Chooses and packs what is sent of Wyner-Ziv frames, group after group.

    Parameters
    ----------
    config : CodecConfig
        Configuration of the stream, with nested bins and tracks of the encoder.
    margin_percent : int
        What is sent beyond the need that is expected.
    """

    def __init__(self, config: CodecConfig, margin_percent: int) -> None:
        self._config = config
        self._needs = NeedEstimator(config, margin_percent)
        self._before: Plane | None = None

    def payloads(self, group: Group, frames: Sequence[EncodedFrame]) -> tuple[bytes, ...]:
        """Pack the Wyner-Ziv frames of the next group.

        Parameters
        ----------
        group : Group
            The group; all are asked for, one after the other.
        frames : sequence of EncodedFrame
            Its Wyner-Ziv frames: all but the last, or all where no key frame ends it.

        Returns
        -------
        tuple of bytes
            Payload of each frame, in order of display.
        """
        lumas = [frame.luma for frame in (*group.wyner_ziv, group.key)]
        before, self._before = self._before, lumas[-1]
        if not frames:
            return ()
        assert before is not None
        lumas = [before, *lumas]
        gop, payloads = self._config.gop, [b""] * len(frames)
        anchored = len(frames) == len(lumas) - 1
        for index, around in group_order(
            0, len(lumas) - 1, gop.references != "keys", gop.anchor_distance if anchored else 0
        ):
            instants = [instant for instant in around if instant is not None]
            fields = [_field(group, index, instant, before.shape) for instant in instants]
            magnitudes = residual_magnitudes(lumas[index], [lumas[k] for k in instants], fields)
            frame, distance = frames[index - 1], reference_distance(around)
            sent = self._needs.choose(frame.quantization, magnitudes, distance, frame.layout.num_bits)
            seed = self._config.turbo.interleaver_seed
            payloads[index - 1] = encode_payload(frame, sent, seed)
        return tuple(payloads)


def _field(group: Group, index: int, reference: int, shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Tell where blocks of a frame are in another of its group."""
    positions = np.empty((0, len(group.wyner_ziv) + 2, 2))
    if group.tracks is not None:
        positions = group.tracks.positions
    return motion_field(positions[:, index], positions[:, reference], (shape[0], shape[1]))
