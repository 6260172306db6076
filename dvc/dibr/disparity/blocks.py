"""Blocks of 8 x 8 pixels with one disparity each, of least squared error alone, in codes of fixed length.

References
----------
[Maitre2008] Section 3.4: the simplest codec to compare with.
"""

from dataclasses import dataclass

import numpy as np

from dvc.dibr.disparity.disparity_codec import DisparityCodec, Known
from dvc.dibr.disparity.distortion import Distortion
from dvc.dibr.disparity.error_tensor import Tensor
from dvc.dibr.disparity.integer_transforms import Labels
from dvc.errors import BitstreamError

SIDE_PX = 8


@dataclass(frozen=True, eq=False)
class BlockMap:
    """A map of labels, constant in blocks."""

    labels: Labels  # label of each block
    shape: tuple[int, int]  # rows and columns of the map
    num_labels: int  # how many labels there are

    def disparity(self, level: int = 0) -> Labels:
        """Return the map of labels, every 2^level-th pixel."""
        full = self.labels.repeat(SIDE_PX, axis=0).repeat(SIDE_PX, axis=1)
        return full[: self.shape[0] : 1 << level, : self.shape[1] : 1 << level]


class BlockCodec(DisparityCodec):
    """Blocks of least squared error; neither lambda nor significance play a part."""

    name = "blocks"

    def _best(
        self, tensor: Tensor, multiplier: float, known: Known, distortion: Distortion | None
    ) -> BlockMap:
        sums = np.add.reduceat(tensor, np.arange(0, tensor.shape[0], SIDE_PX), axis=0)
        sums = np.add.reduceat(sums, np.arange(0, tensor.shape[1], SIDE_PX), axis=1)
        shape = tensor.shape[0], tensor.shape[1]
        return BlockMap(sums.argmin(axis=2).astype(np.int32), shape, tensor.shape[2])

    def _write(self, representation: BlockMap, known: Known) -> bytes:
        width = bits_of_label(representation.num_labels)
        digits = representation.labels.ravel()[:, None] >> np.arange(width)[::-1] & 1
        return np.packbits(digits.astype(np.uint8)).tobytes()

    def _read(self, payload: bytes, shape: tuple[int, int], num_labels: int, known: Known) -> BlockMap:
        width = bits_of_label(num_labels)
        blocks = -(-shape[0] // SIDE_PX), -(-shape[1] // SIDE_PX)
        count = blocks[0] * blocks[1] * width
        if len(payload) != -(-count // 8):
            raise BitstreamError(f"the labels of blocks are {len(payload)} bytes, not {-(-count // 8)}")
        digits = np.unpackbits(np.frombuffer(payload, np.uint8))[:count].reshape(*blocks, width)
        labels = (digits @ (1 << np.arange(width)[::-1])).astype(np.int32)
        if labels.size and labels.max() >= num_labels:
            raise BitstreamError(f"a block has label {labels.max()} of {num_labels}")
        return BlockMap(labels, shape, num_labels)


def bits_of_label(num_labels: int) -> int:
    """Return how many bits a label takes in codes of fixed length."""
    return (num_labels - 1).bit_length()
