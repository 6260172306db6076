"""Ways to represent a disparity map, by name."""

from collections.abc import Sequence
from typing import Any, Protocol

from dvc.depthcodec.trees.blocks import BlockCodec
from dvc.depthcodec.trees.coding import Classes
from dvc.depthcodec.trees.distortion import Distortion
from dvc.depthcodec.trees.error_tensor import Tensor
from dvc.depthcodec.trees.integer_transforms import L_TRANSFORM, S_TRANSFORM, Labels
from dvc.depthcodec.trees.quadtree import QuadtreeCodec
from dvc.depthcodec.trees.wavelet_codec import WaveletCodec


class Representation(Protocol):
    """A disparity map that can be written."""

    @property
    def num_labels(self) -> int:
        """Labels are from 0 to ``num_labels - 1``."""

    def disparity(self, level: int = 0) -> Labels:
        """Return the map of labels.

        Parameters
        ----------
        level : int, optional
            Resolution: 0 for full, each further one halves both sides.

        Returns
        -------
        ndarray of shape (ceil(H / 2^level), ceil(W / 2^level)), int32
            Labels.
        """


class DisparityCodec(Protocol):
    """Finds, writes and reads representations of one kind."""

    layered: bool
    """Whether a representation can be coded as the difference to a previous one."""

    @property
    def name(self) -> str:
        """As options call it."""

    def optimise(
        self,
        tensor: Tensor,
        multiplier: float,
        significance: Sequence[Classes] | None = None,
        previous: Any = None,
        distortion: Distortion | None = None,
    ) -> Any:
        """Find the representation of least errors and bits.

        Parameters
        ----------
        tensor : ndarray of shape (H, W, labels), float32
            Error of each label at each pixel, at least 0 and finite.
        multiplier : float
            Lambda: squared error per pixel that a bit is worth.
        significance : sequence of ndarray of shape (H_j+1, W_j+1), uint8, optional
            Class of each node of level j + 1 = 1, 2, ... by the decoded reference: where it is 0,
            coefficients below are as predicted; others are contexts. By default all are 1.
        previous : Representation, optional
            Of the same kind and size, from the quality layer before; only where `layered`.
        distortion : Distortion, optional
            What maps cause in other views, by which the representations that were tried are chosen; by
            default what the tensor tells.

        Returns
        -------
        Representation
            The map.
        """

    def encode(
        self, representation: Any, significance: Sequence[Classes] | None = None, previous: Any = None
    ) -> bytes:
        """Write a representation; inverse of `decode`.

        Parameters
        ----------
        representation : Representation
            As `optimise` or `decode` returned it.
        significance, previous : optional
            As for `optimise`.

        Returns
        -------
        bytes
            The payload.
        """

    def decode(
        self,
        payload: bytes,
        shape: tuple[int, int],
        num_labels: int,
        significance: Sequence[Classes] | None = None,
        previous: Any = None,
    ) -> Any:
        """Read a representation; inverse of `encode`.

        Parameters
        ----------
        payload : bytes
            As `encode` returned it, or any other.
        shape : tuple of int
            Rows and columns of the map.
        num_labels : int
            How many labels there are.
        significance, previous : optional
            As for `encode`.

        Returns
        -------
        Representation
            The map; any, if the payload is damaged, but of valid labels.

        Raises
        ------
        BitstreamError
            If the payload cannot have been written.
        """


METHODS: dict[str, DisparityCodec] = {
    "l": WaveletCodec(L_TRANSFORM),
    "s": WaveletCodec(S_TRANSFORM),
    "quadtree": QuadtreeCodec(),
    "blocks": BlockCodec(),
}
"""By the name that options have for them."""
