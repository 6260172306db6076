"""What finds, writes and reads disparity maps of one kind, and what decides among the maps that it finds."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from dvc.dibr.disparity.distortion import Distortion, Holes, backward_error, still_worth_covering
from dvc.dibr.disparity.error_tensor import Tensor
from dvc.dibr.disparity.integer_transforms import Labels
from dvc.dibr.disparity.tree_coding import Classes, classes_or_all
from dvc.entropy import RangeCoder

MAX_FAILURES = 2
"""How many tears or credits in a row may do no good before the others are left out."""
_LEAST_GAIN_BITS = 1e-6
"""By which a map is better than another one, per pixel."""


class Known(NamedTuple):
    """What a decoder knows before it reads a map."""

    # of each node of level j + 1 = 1, 2, ..., by the decoded reference: where it is 0, coefficients below are
    # as predicted
    classes: Sequence[Classes]
    previous: Any = None  # representation of the quality layer before, of the same kind and size


class DisparityCodec(ABC):
    """Finds, writes and reads disparity maps of one kind.

    Representations have the attribute `shape`, rows and columns of the map, and the method `disparity(level)`
    that returns labels of every 2^level-th pixel. A subclass has `_best`, `_write` and `_read`.

    Attributes
    ----------
    name : str
        What messages call it.
    layered : bool
        Whether a representation can be coded as the difference to a previous one.
    num_levels : int or None
        How often the map is halved; None: down to one pixel.
    """

    name: str
    layered = False
    num_levels: int | None = None

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
        tensor : ndarray of shape (H, W, L), float32
            Squared error of each label at each pixel, intensities from 0 to 1 (3.6).
        multiplier : float
            Error that a bit is worth.
        significance : sequence of ndarray, uint8, optional
            For each level from 1 on, where the decoded reference says that coefficients below may differ from
            what is predicted (3.3): not 0; by default everywhere.
        previous : representation, optional
            That of the quality layer before.
        distortion : Distortion, optional
            Measures what a map causes in rendered views; by default the tensor does.

        Returns
        -------
        representation
            The best that was found.
        """
        shape = tensor.shape[0], tensor.shape[1]
        return self._best(tensor, multiplier, self._known(shape, significance, previous), distortion)

    def encode(
        self, representation: Any, significance: Sequence[Classes] | None = None, previous: Any = None
    ) -> bytes:
        """Write a representation; inverse of `decode`.

        Parameters
        ----------
        representation : representation
            As `optimise` finds them.
        significance, previous : optional
            As `optimise` takes them.

        Returns
        -------
        bytes
            The code.
        """
        return self._write(representation, self._known(representation.shape, significance, previous))

    def decode(
        self,
        payload: bytes,
        shape: tuple[int, int],
        num_labels: int,
        significance: Sequence[Classes] | None = None,
        previous: Any = None,
    ) -> Any:
        """Read a representation: any, if the payload is damaged, but of valid labels.

        Parameters
        ----------
        payload : bytes
            The code.
        shape : tuple of two int
            Rows and columns of the map.
        num_labels : int
            How many labels there are.
        significance, previous : optional
            As the encoder took them.

        Returns
        -------
        representation
            The map.

        Raises
        ------
        BitstreamError
            If the code cannot have been written.
        """
        return self._read(payload, shape, num_labels, self._known(shape, significance, previous))

    def _known(self, shape: tuple[int, int], significance: Sequence[Classes] | None, previous: Any) -> Known:
        return Known(classes_or_all(shape, significance, self.num_levels), previous)

    @abstractmethod
    def _best(self, tensor: Tensor, multiplier: float, known: Known, distortion: Distortion | None) -> Any:
        """Find a representation; errors that it causes are those of `distortion`, or else of the tensor."""

    @abstractmethod
    def _write(self, representation: Any, known: Known) -> bytes:
        """Write a representation, with what the decoder knows."""

    @abstractmethod
    def _read(self, payload: bytes, shape: tuple[int, int], num_labels: int, known: Known) -> Any:
        """Read a representation; inverse of `_write`."""


class RangeCodedDisparities(DisparityCodec):
    """A codec that writes and reads in one pass, by the range coder."""

    def _write(self, representation: Any, known: Known) -> bytes:
        coder = RangeCoder.writer()
        self._code(coder, representation, known)
        return coder.to_bytes(shortest=True)

    def _read(self, payload: bytes, shape: tuple[int, int], num_labels: int, known: Known) -> Any:
        coder = RangeCoder.reader(payload)
        found = self._code(coder, self._empty(shape, num_labels, known), known)
        coder.check()
        return found

    @abstractmethod
    def _code(self, coder: RangeCoder, representation: Any, known: Known) -> Any:
        """Code a representation, and return that which was written or read."""

    @abstractmethod
    def _empty(self, shape: tuple[int, int], num_labels: int, known: Known) -> Any:
        """Return what is read into."""


Found = TypeVar("Found")


class Candidates(Generic[Found]):
    """Representations of one tensor that were tried, and the best of them by what it causes and costs."""

    def __init__(self, tensor: Tensor, multiplier: float, distortion: Distortion | None) -> None:
        self._tensor, self._multiplier, self._distortion = tensor, multiplier, distortion
        self._least = np.inf
        self._holes: list[Holes] = []
        self.best: Found | None = None

    def tensor(self, credit: float) -> Tensor:
        """Return the tensor in which labels that would cover holes of the best one have less error."""
        if credit == 0.0 or self._distortion is None:
            return self._tensor
        return self._distortion.claimed(self._tensor, self._holes, credit)

    def offer(self, found: Found, labels: Labels, num_bytes: int, credit: float = 0.0) -> bool:
        """Keep a representation if it is the best so far."""
        error, holes = backward_error(self._tensor, labels), list[Holes]()
        if self._distortion is not None:
            error, holes = self._distortion.measure(labels)
        cost = error + self._multiplier * 8 * num_bytes
        is_better = cost < self._least - _LEAST_GAIN_BITS * labels.size * self._multiplier
        if is_better:
            holes = still_worth_covering(holes, self._holes) if credit > 0.0 else holes
            self.best, self._least, self._holes = found, cost, holes
        return is_better


def climb(steps: Iterable[Any], refine: Callable[[Any], bool]) -> None:
    """Refine what is the best by one step after the other, until several in a row do no good."""
    num_failures = 0
    for step in steps:
        num_failures = 0 if refine(step) else num_failures + 1
        if num_failures == MAX_FAILURES:
            break
