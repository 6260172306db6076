"""Range coder: sequences of decisions and of numbers below a bound, as bytes and back.

The interval that a sequence has been narrowed to is kept in 64 bits, probabilities are multiples of
2^-24, and bytes leave in words of 32 bits, big endian. Trailing zeros are dropped, and a reader appends them.
Streams are those of the default range coder of the library `constriction`. Its models cannot be called from
compiled loops, and need a call for each decision that depends on the last one.

References
----------
Martin, "Range encoding: an algorithm for removing redundancy from a digitised message", 1979.
"""

from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from dvc._jit import inlined_kernel, kernel
from dvc.errors import BitstreamError

# Fields of a state. LOW is the start of a writer's interval, and the offset of a reader's data from it.
LOW, RANGE, POSITION, READING, FAILED = range(5)

_MAX = np.uint64(2**64 - 1)
_NONE, _ONE = np.uint64(0), np.uint64(1)
_WORD_BITS, _MIN_RANGE, _LAST_WORD = np.uint64(32), np.uint64(2**32), np.uint64(2**32 - 1)
_PRECISION, _TOTAL = np.uint64(24), np.uint64(2**24)
_FREE_WEIGHT = 2.0**24 - 2  # weight of the parts, as either decision has one in any case


class CoderState(NamedTuple):
    """State of a coder for compiled functions.

    Attributes
    ----------
    fields : ndarray of shape (5,), uint64
        Interval, place in the words, direction, and whether something went wrong.
    words : ndarray of shape (W,), uint32
        Bytes written so far, with room for more, or bytes to read.
    """

    fields: NDArray[np.uint64]
    words: NDArray[np.uint32]


class RangeCoder:
    """Writes a sequence, or reads one, given the same models; made by `writer` or `reader`.

    Parameters
    ----------
    state : CoderState
        Start of the interval.

    Examples
    --------
    >>> coder = RangeCoder.writer()
    >>> [coder.uniform(1000, value) for value in (7, 950)]
    [7, 950]
    >>> coder = RangeCoder.reader(coder.to_bytes())
    >>> [coder.uniform(1000) for _ in range(2)]
    [7, 950]
    """

    def __init__(self, state: CoderState) -> None:
        self._state = state

    @classmethod
    def writer(cls) -> Self:
        """Return a coder that writes."""
        return cls(CoderState(np.array([0, _MAX, 0, 0, 0], np.uint64), np.empty(64, np.uint32)))

    @classmethod
    def reader(cls, data: bytes) -> Self:
        """Return a coder that reads what `to_bytes` returned, or any bytes."""
        padded = data + bytes(max(8 - len(data), -len(data) % 4))
        words = np.frombuffer(padded, ">u4").astype(np.uint32)
        point = int(words[0]) << 32 | int(words[1])
        return cls(CoderState(np.array([point, _MAX, 2, 1, 0], np.uint64), words))

    def room_for(self, num_symbols: int) -> CoderState:
        """Return the state for compiled functions that code at most this number of symbols."""
        fields, words = self._state
        position = int(fields[POSITION])
        if not fields[READING] and position + num_symbols > words.size:
            size = max(position + num_symbols, 2 * words.size)
            self._state = CoderState(fields, np.empty(size, np.uint32))
            self._state.words[:position] = words[:position]
        return self._state

    def uniform(self, bound: int, value: int = 0) -> int:
        """Code a number below a bound as `code_uniform` does; `BitstreamError` if the data are damaged."""
        value = int(code_uniform(self.room_for(1), bound, value))
        self.check()
        return value

    @staticmethod
    def _shortest(low: int, width: int, num_bytes: int) -> bytes:
        """Return the number with the most trailing zeros inside the interval, for any continuation."""
        for zeros in range(64, -1, -8):
            inside = low + 2**zeros - 1 >> zeros << zeros
            if inside < low + width:
                return inside.to_bytes(num_bytes).rstrip(b"\0") or b"\0"
        raise AssertionError("the interval holds its beginning")

    def check(self) -> None:
        """Raise `BitstreamError` if the data read cannot have been written."""
        if self._state.fields[FAILED]:
            raise BitstreamError("the range-coded data are damaged")

    def check_end(self, data: bytes) -> None:
        """Raise `BitstreamError` unless the data read are the shortest ones, as `to_bytes` writes them."""
        self.check()
        above, width, position, reading, _ = (int(field) for field in self._state.fields)
        assert reading, "written data are complete"
        low = int.from_bytes(data[: 4 * position].ljust(4 * position, b"\0")) - above
        if data != self._shortest(low, width, 4 * position):
            raise BitstreamError("the range-coded data do not end as they are written")

    def to_bytes(self, shortest: bool = False) -> bytes:
        """Return the written data without zeros at the end: the shortest ones, or those of `constriction`."""
        low, width, position, reading, failed = (int(field) for field in self._state.fields)
        assert not reading, "a reader has no data to return"
        assert not failed, "more was written than there was room for"
        number = int.from_bytes(self._state.words[:position].astype(">u4").tobytes()) << 32
        if shortest:
            return self._shortest((number << 32) + low, width, 4 * position + 8)
        if width < _MAX:  # else nothing was written
            number += low + 2**32 - 1 >> 32  # a word inside the interval, for any continuation
        return number.to_bytes(4 * position + 4).rstrip(b"\0") or b"\0"


@inlined_kernel
def code_decision(coder: CoderState, probability: float, decision: int) -> int:
    """Code a decision, compiled.

    Parameters
    ----------
    coder : CoderState
        Where to write or to read.
    probability : float
        Of a 1.
    decision : int
        0 or 1; of no meaning when reading.

    Returns
    -------
    int
        The decision.
    """
    first_one = np.uint64((1.0 - probability) * _FREE_WEIGHT) + _ONE
    one = _quantile(coder) >= first_one if coder.fields[READING] else decision > 0
    if one:
        _narrow(coder, first_one, _TOTAL - first_one)
    else:
        _narrow(coder, _NONE, first_one)
    return int(one)


@inlined_kernel
def has_room(coder: CoderState, num_symbols: int) -> bool:
    """Return whether the buffer has room for more decisions and numbers, compiled."""
    if coder.fields[READING]:
        return True
    return bool(np.int64(coder.fields[POSITION]) + num_symbols <= coder.words.size)


@kernel
def is_settled(coder: CoderState, probability: float, num_bytes: int) -> bool:
    """Return whether a decision is the same for any continuation of the data, compiled."""
    missing = 4 * np.int64(coder.fields[POSITION]) - num_bytes
    if missing <= 0:
        return True
    if missing >= 8:
        return False
    first_one = np.uint64((1.0 - probability) * _FREE_WEIGHT) + _ONE
    border = (coder.fields[RANGE] >> _PRECISION) * first_one
    low = coder.fields[LOW]
    return bool(low >= border or border - low > (_ONE << np.uint64(8 * missing)) - _ONE)


@kernel
def code_uniform(coder: CoderState, bound: int, value: int) -> int:
    """Code a number with equally probable values, compiled.

    Parameters
    ----------
    coder : CoderState
        Where to write or to read.
    bound : int
        At least 1, where nothing is coded, at most 2^24.
    value : int
        The number, from 0 to ``bound - 1``; of no meaning when reading.

    Returns
    -------
    int
        The number.
    """
    if bound <= 1:
        return 0
    width = _TOTAL // np.uint64(bound)
    if coder.fields[READING]:
        value = min(int(np.int64(_quantile(coder) // width)), bound - 1)
    start = np.uint64(value) * width
    _narrow(coder, start, width if value < bound - 1 else _TOTAL - start)
    return value


@inlined_kernel
def _quantile(coder: CoderState) -> np.uint64:
    """Return where in the interval the data are, of 2^24 equal parts."""
    fields = coder.fields
    quantile = fields[LOW] // (fields[RANGE] >> _PRECISION)
    if quantile >= _TOTAL:  # remainder of the equal parts
        fields[FAILED] = _ONE
        return np.uint64(_TOTAL - _ONE)
    return np.uint64(quantile)


@inlined_kernel
def _narrow(coder: CoderState, start: np.uint64, width: np.uint64) -> None:
    """Narrow the interval to some of 2^24 equal parts; write or read a word once few are left."""
    fields = coder.fields
    part = fields[RANGE] >> _PRECISION
    fields[RANGE] = part * width
    if fields[READING]:
        fields[LOW] -= part * start
    elif part * start <= _MAX - fields[LOW]:
        fields[LOW] += part * start
    else:
        fields[LOW] = part * start - (_MAX - fields[LOW]) - _ONE
        _carry(coder)
    if fields[RANGE] < _MIN_RANGE:
        fields[RANGE] <<= _WORD_BITS
        word = fields[LOW] >> _WORD_BITS
        fields[LOW] <<= _WORD_BITS
        position = np.int64(fields[POSITION])
        fields[POSITION] += _ONE
        if fields[READING]:
            if position < coder.words.size:
                fields[LOW] |= np.uint64(coder.words[position])
        elif position < coder.words.size:
            coder.words[position] = word
        else:
            fields[FAILED] = _ONE


@kernel
def _carry(coder: CoderState) -> None:
    """Add one to the written data."""
    k = np.int64(coder.fields[POSITION]) - 1
    while coder.words[k] == _LAST_WORD:
        coder.words[k] = 0
        k -= 1
    coder.words[k] += np.uint32(1)
