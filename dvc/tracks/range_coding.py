"""Range coding of decisions and of numbers below a bound: the coder of `constriction` on bytes."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc.errors import BitstreamError

_WORD_BYTES = 4


class RangeWriter:
    """Collects symbols and the probabilities that both sides know; the counterpart of `RangeReader`."""

    def __init__(self) -> None:
        from constriction import stream

        self._coder: Any = stream.queue.RangeEncoder()
        self._decision: Any = stream.model.Bernoulli(perfect=False)
        self._uniform: Any = stream.model.Uniform()

    def write_decisions(self, decisions: NDArray[np.int32], probabilities: NDArray[np.float64]) -> None:
        """Append decisions.

        Parameters
        ----------
        decisions : ndarray of shape (n,), int32
            Each 0 or 1.
        probabilities : ndarray of shape (n,), float64
            Of a 1, between 0 and 1.
        """
        self._coder.encode(decisions, self._decision, probabilities)

    def write_uniform(self, values: NDArray[np.int32], bounds: NDArray[np.int32]) -> None:
        """Append numbers all of whose values are as probable; inverse of `RangeReader.read_uniform`.

        Parameters
        ----------
        values : ndarray of shape (n,), int32
            Each from 0 to its bound less 1.
        bounds : ndarray of shape (n,), int32
            At least 1, where nothing is written, at most 2^24.
        """
        undecided = bounds > 1
        self._coder.encode(values[undecided], self._uniform, bounds[undecided])

    def to_bytes(self) -> bytes:
        """Return what was written.

        Returns
        -------
        bytes
            At least one; zeros at the end are left out.
        """
        words = self._coder.get_compressed()
        return bytes(words.astype(">u4").tobytes().rstrip(b"\0")) or b"\0"


class RangeReader:
    """Reads what `RangeWriter` has written, given the same probabilities; goes on for ever past the end.

    Parameters
    ----------
    data : bytes
        What to read.
    """

    def __init__(self, data: bytes) -> None:
        from constriction import stream

        padded = data + bytes(-len(data) % _WORD_BYTES)
        self._coder: Any = stream.queue.RangeDecoder(np.frombuffer(padded, ">u4").astype(np.uint32))
        self._decision = stream.model.Bernoulli
        self._uniform = stream.model.Uniform

    def read_decision(self, probability: float) -> int:
        """Read one decision.

        Parameters
        ----------
        probability : float
            Of a 1.

        Returns
        -------
        int
            0 or 1.

        Raises
        ------
        BitstreamError
            If the data cannot have been written.
        """
        return self._read(self._decision(probability, perfect=False))

    def read_uniform(self, bound: int) -> int:
        """Read a number; inverse of `RangeWriter.write_uniform`.

        Parameters
        ----------
        bound : int
            As it was written with.

        Returns
        -------
        int
            From 0 to ``bound - 1``.

        Raises
        ------
        BitstreamError
            If the data cannot have been written.
        """
        return self._read(self._uniform(bound)) if bound > 1 else 0

    def _read(self, model: Any) -> int:
        try:
            return int(self._coder.decode(model))
        except (AssertionError, ValueError) as err:
            raise BitstreamError("the range-coded data are damaged") from err
