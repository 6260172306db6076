"""The contract of disparity codecs, the squared errors that they are given, and the choice among their maps.

Views are compensated backwards: each is sampled at the position of a reference pixel with the disparity of
the label ([Maitre2008] Eqs. (3.5), (3.6), (3.12), (3.31)). This ignores the holes that a map opens when
other views are rendered forward from it. If these errors are known, the codecs choose by them.
"""
# mypy: allow-untyped-defs, allow-untyped-calls, no-check-untyped-defs

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from dvc.arrays import Floats
from dvc.dibr.disparity.integer_transforms import Labels, level_shapes
from dvc.entropy import RangeCoder

Plane = NDArray[np.float32]
Tensor = NDArray[np.float32]
"""Errors of shape (rows, columns, labels)."""

MARGIN = 1e-6
"""Largest distance in px of a position from the picture, for rounding."""
Classes = NDArray[np.uint8]
"""Classes of nodes: 1 if the reference is significant, else 0."""
MAX_FAILURES = 2
"""Most steps in a row without a gain before a search ends."""
CREDITS = 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5
"""Credits, in turn, of labels that would cover holes: shares of the errors in these."""
_LEAST_GAIN_BITS = 1e-6
"""Least gain of a better map, in bits per pixel."""


class Holes(NamedTuple):
    """Holes of one view."""

    errors: Plane  # squared errors in holes, 0 elsewhere
    # lowest label that would be seen: 0 in holes, elsewhere the first in front of the surface
    first_label: Labels


class Distortion(Protocol):
    """Errors of the rendered views."""

    parallax: float
    """Motion per label in px, mean of all views with the reference."""

    def measure(self, labels: Labels) -> tuple[float, list[Holes]]:
        """Return the squared error of a map (sum over pixels, mean of views and reference), and its holes."""

    def claimed(self, tensor: Tensor, holes: Sequence[Holes], weight: float) -> Tensor:
        """Return a tensor that credits labels which would cover a hole with a share of its error."""


def error_tensor(
    reference: NDArray[np.floating],
    views: Sequence[NDArray[np.floating]],
    warps: Sequence[Floats],
    inverse_depths: Floats,
) -> Tensor:
    """Return the squared error of each label at each pixel, per view."""
    if not 0 < len(views) < 256 or len(views) != len(warps):
        raise ValueError(f"`views` must be 1 to 255, with a warp each, got {len(views)}, {len(warps)}")
    planes, target = [_with_channels(view) for view in views], _with_channels(reference)
    if any(plane.shape[2] != target.shape[2] for plane in planes):
        raise ValueError("`views` must have the channels of the reference")
    tensor = np.zeros((*target.shape[:2], len(inverse_depths)), np.float32)
    count = np.zeros(tensor.shape, np.uint8)
    for plane, warp in zip(planes, warps, strict=True):
        _add_squared_errors(target, plane, _homographies(warp, inverse_depths), tensor, count)
    _normalise_errors(tensor, count, len(views))
    return tensor


def _with_channels(image: NDArray[np.floating]) -> NDArray[np.float32]:
    return np.ascontiguousarray(image.reshape(*image.shape[:2], -1), np.float32)


def _homographies(warp: Floats, inverse_depths: Floats) -> Floats:
    homographies = np.tile(warp[:, :3], (len(inverse_depths), 1, 1))
    homographies[:, :, 2] += inverse_depths[:, None] * warp[:, 3]
    return homographies


def subtract_hole_errors(
    tensor: Tensor, holes: Sequence[Holes], warps: Sequence[Floats], inverse_depths: Floats, weight: float
) -> Tensor:
    """Credit each label with the errors in holes that it would cover."""
    credited = tensor.copy()
    share = np.float32(weight / (len(holes) + 1))
    for (errors, first_label), warp in zip(holes, warps, strict=True):
        inverse = adjugates(_homographies(warp, inverse_depths))
        _subtract_at_labels(errors, first_label, inverse, share, credited)
    return credited


def adjugates(homographies: Floats) -> Floats:
    """Return the inverses of homographies, up to positive scales; zeros if they are singular."""
    rows = homographies.transpose(1, 0, 2)
    columns = [np.cross(rows[(k + 1) % 3], rows[(k + 2) % 3]) for k in range(3)]
    determinants = (rows[0] * columns[0]).sum(axis=1)
    return np.asarray(np.stack(columns, axis=2) * np.sign(determinants)[:, None, None])


@kernel
def _add_squared_errors(target, view, homographies, tensor, count):
    """Add the squared errors of one view at every label, and count the pixels that it sees."""
    height, width, channels = view.shape
    share = np.float32(1.0 / channels)
    labels = tensor.shape[2]
    for m in range(tensor.shape[0]):
        for n in range(tensor.shape[1]):
            for k in range(labels):
                h = homographies[k]
                x = h[0, 0] * n + h[0, 1] * m + h[0, 2]
                y = h[1, 0] * n + h[1, 1] * m + h[1, 2]
                z = h[2, 0] * n + h[2, 1] * m + h[2, 2]
                if z != 1.0:
                    if z <= 0.0:
                        continue
                    x, y = x / z, y / z
                if not (-MARGIN <= x <= width - 1 + MARGIN and -MARGIN <= y <= height - 1 + MARGIN):
                    continue
                x0, y0 = min(max(int(x), 0), width - 1), min(max(int(y), 0), height - 1)
                x1, y1 = min(x0 + 1, width - 1), min(y0 + 1, height - 1)
                right, down = np.float32(x - x0), np.float32(y - y0)
                total = np.float32(0.0)
                for c in range(channels):
                    value = view[y0, x0, c]
                    if right != 0.0:
                        value += right * (view[y0, x1, c] - value)
                    if down != 0.0:
                        lower = view[y1, x0, c]
                        if right != 0.0:
                            lower += right * (view[y1, x1, c] - lower)
                        value += down * (lower - value)
                    total += (value - target[m, n, c]) ** 2
                if np.isfinite(total):
                    tensor[m, n, k] += share * total
                    count[m, n, k] += 1


@kernel
def _normalise_errors(tensor, count, num_views):
    """Turn sums over the views that see a pixel into shares of all views, the reference included."""
    height, width, labels = tensor.shape
    for m in range(height):
        for n in range(width):
            total, num_seen = 0.0, 0
            for k in range(labels):
                seen = np.float32(count[m, n, k])
                if seen > 0:
                    tensor[m, n, k] *= np.float32(num_views) / (seen * np.float32(num_views + 1))
                    total += tensor[m, n, k]
                    num_seen += 1
            blind = np.float32(total / num_seen) if num_seen > 0 else np.float32(0.0)
            for k in range(labels):
                if count[m, n, k] == 0:
                    tensor[m, n, k] = blind


@kernel
def _subtract_at_labels(plane, first_label, homographies, weight, tensor):
    """Subtract values of a plane from labels, from a first one on, that would draw there."""
    height, width, labels = tensor.shape
    for i in range(plane.shape[0]):
        for j in range(plane.shape[1]):
            if plane[i, j] == 0.0:
                continue
            for k in range(first_label[i, j], labels):
                h = homographies[k]
                z = h[2, 0] * j + h[2, 1] * i + h[2, 2]
                if z <= 0.0:
                    continue
                n = np.int64(np.floor((h[0, 0] * j + h[0, 1] * i + h[0, 2]) / z + 0.5))
                m = np.int64(np.floor((h[1, 0] * j + h[1, 1] * i + h[1, 2]) / z + 0.5))
                if 0 <= n < width and 0 <= m < height:
                    tensor[m, n, k] -= weight * plane[i, j]


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
    layered : bool
        Whether a representation can be coded as the difference to a previous one.
    num_levels : int or None
        Number of times that the map is halved; None: down to one pixel.
    """

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
        """Find the representation of least errors and bits: of the tensor, or of `distortion` if given.

        `multiplier` is the error that a bit is worth. Significance is, for each level from 1 on, not 0 if
        coefficients below may differ from their predictions (3.3); by default everywhere.
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
