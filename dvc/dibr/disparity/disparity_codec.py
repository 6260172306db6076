"""The contract of disparity codecs, and the choice among the maps that they try."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from dvc.dibr.disparity.error_tensor import Distortion, Holes, Tensor
from dvc.dibr.disparity.integer_transforms import Labels, level_shapes
from dvc.entropy import RangeCoder

Classes = NDArray[np.uint8]
"""Classes of nodes: 1 if the reference is significant, else 0."""
MAX_FAILURES = 2
"""Most steps in a row without a gain before a search ends."""
CREDITS = 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5
"""Credits, in turn, of labels that would cover holes: shares of the errors in these."""
_LEAST_GAIN_BITS = 1e-6
"""Least gain of a better map, in bits per pixel."""


def all_significant(shape: tuple[int, int], num_levels: int | None = None) -> list[Classes]:
    """Return classes of significance that forbid nothing."""
    return [np.ones(size, np.uint8) for size in level_shapes(shape, num_levels)[1:]]


class Known(NamedTuple):
    """Data that a decoder has before it reads a map."""

    # class of each node of level 1, 2, ..., by the decoded reference: coefficients below class 0 are as
    # predicted
    classes: Sequence[Classes]
    previous: Any = None  # representation of the previous quality layer, of the same kind and size


class DisparityCodec(ABC):
    """Finds, writes and reads disparity maps of one kind.

    Representations have the attribute `shape`, rows and columns of the map, and the method `disparity(level)`
    that returns labels of every 2^level-th pixel. A subclass has `_best`, `_write` and `_read`.

    Attributes
    ----------
    name : str
        Name in messages.
    layered : bool
        Whether a representation can be coded as the difference to a previous one.
    num_levels : int or None
        Number of times that the map is halved; None: down to one pixel.
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
            For each level from 1 on, not 0 if coefficients below may differ from their predictions, by the
            decoded reference (3.3); by default everywhere.
        previous : representation, optional
            Representation of the previous quality layer.
        distortion : Distortion, optional
            Measures the errors of rendered views; by default the tensor does.

        Returns
        -------
        representation
            The best one.
        """
        shape = tensor.shape[0], tensor.shape[1]
        return self._best(tensor, multiplier, self._known(shape, significance, previous), distortion)

    def encode(
        self, representation: Any, significance: Sequence[Classes] | None = None, previous: Any = None
    ) -> bytes:
        """Write a result of `optimise`, with the same significance and previous representation."""
        return self._write(representation, self._known(representation.shape, significance, previous))

    def decode(
        self,
        payload: bytes,
        shape: tuple[int, int],
        num_labels: int,
        significance: Sequence[Classes] | None = None,
        previous: Any = None,
    ) -> Any:
        """Read a representation, or raise `BitstreamError`; damage may also give other valid labels."""
        return self._read(payload, shape, num_labels, self._known(shape, significance, previous))

    def _known(self, shape: tuple[int, int], significance: Sequence[Classes] | None, previous: Any) -> Known:
        if significance is None:
            return Known(all_significant(shape, self.num_levels), previous)
        return Known(significance[: self.num_levels], previous)

    @abstractmethod
    def _best(self, tensor: Tensor, multiplier: float, known: Known, distortion: Distortion | None) -> Any:
        """Find a representation; errors are those of `distortion`, or else of the tensor."""

    @abstractmethod
    def _write(self, representation: Any, known: Known) -> bytes:
        """Write a representation."""

    @abstractmethod
    def _read(self, payload: bytes, shape: tuple[int, int], num_labels: int, known: Known) -> Any:
        """Read a representation; inverse of `_write`."""


class RangeCodedDisparities(DisparityCodec):
    """Base of codecs with one function that writes and reads, by the range coder."""

    def _write(self, representation: Any, known: Known) -> bytes:
        coder = RangeCoder.writer()
        self._code(coder, representation, known)
        return coder.to_bytes(shortest=True)

    def _read(self, payload: bytes, shape: tuple[int, int], num_labels: int, known: Known) -> Any:
        coder = RangeCoder.reader(payload)
        representation = self._code(coder, self._empty(shape, num_labels, known), known)
        coder.check()
        return representation

    @abstractmethod
    def _code(self, coder: RangeCoder, representation: Any, known: Known) -> Any:
        """Write a representation, or read one into an empty one; return it."""

    @abstractmethod
    def _empty(self, shape: tuple[int, int], num_labels: int, known: Known) -> Any:
        """Return an empty representation to read into."""


Representation = TypeVar("Representation")


class Candidates(Generic[Representation]):
    """Representations of one tensor that were tried, and the best of them by error and rate."""

    def __init__(self, tensor: Tensor, multiplier: float, distortion: Distortion | None) -> None:
        self._tensor, self._multiplier, self._distortion = tensor, multiplier, distortion
        self._least = np.inf
        self._holes: list[Holes] = []
        self.best: Representation  # set by the first `offer`

    def tensor(self, credit: float) -> Tensor:
        """Return the tensor with a credit for labels that would cover holes of the best one."""
        if credit == 0.0 or self._distortion is None:
            return self._tensor
        return self._distortion.claimed(self._tensor, self._holes, credit)

    def offer(self, candidate: Representation, labels: Labels, num_bytes: int, credit: float = 0.0) -> bool:
        """Keep a representation if it is better than all before; return whether it is."""
        if self._distortion is not None:
            error, holes = self._distortion.measure(labels)
        else:
            chosen = np.take_along_axis(self._tensor, labels[:, :, None], 2)
            error, holes = float(chosen.sum(dtype=np.float64)), []
        cost = error + self._multiplier * 8 * num_bytes
        is_better = cost < self._least - _LEAST_GAIN_BITS * labels.size * self._multiplier
        if is_better:
            if credit > 0.0:  # holes that are covered now may open again
                holes = [
                    now._replace(errors=np.where(now.errors > 0.0, now.errors, before.errors))
                    for now, before in zip(holes, self._holes, strict=True)
                ]
            self.best, self._least, self._holes = candidate, cost, holes
        return is_better


def climb(steps: Iterable[Any], refine: Callable[[Any], bool]) -> None:
    """Refine the best by one step after the other, until several in a row bring no gain."""
    num_failures = 0
    for step in steps:
        num_failures = 0 if refine(step) else num_failures + 1
        if num_failures == MAX_FAILURES:
            break
