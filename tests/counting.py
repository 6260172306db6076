"""Kernels on numbers that count what is done to them, to hold models of operations against the code."""

import operator
from collections import Counter
from collections.abc import Callable
from types import FunctionType
from typing import Any

import numpy as np

from dvc._jit import python_twin
from encoder.encoder_report import Operations

_KINDS = {
    "adds": ("add", "sub"),
    "multiplies": ("mul", "truediv", "floordiv", "mod", "pow"),
    "logic": ("and_", "or_", "xor", "lshift", "rshift"),
    "compares": ("lt", "le", "gt", "ge", "eq", "ne"),
}


class Tally(Counter[str]):
    """How often each kind of operation was done, and how many bytes were moved."""

    def operations(self) -> Operations:
        """Return what was counted."""
        return Operations(**{name: self[name] for name in (*_KINDS, "bytes")})


class Value:
    """A number that came out of data: what is done with it counts."""

    __slots__ = ("number", "tally")
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, number: Any, tally: Tally) -> None:
        self.number, self.tally = number, tally

    def __index__(self) -> int:
        return operator.index(self.number)

    def __int__(self) -> int:
        return int(self.number)

    def __float__(self) -> float:
        return float(self.number)

    def __bool__(self) -> bool:
        return bool(self.number)

    def __neg__(self) -> "Value":
        self.tally["adds"] += 1
        return Value(-self.number, self.tally)

    def __abs__(self) -> "Value":
        self.tally["compares"] += 1
        return Value(abs(self.number), self.tally)


def _plain(number: Any) -> Any:
    number = number.number if isinstance(number, Value) else number
    return number.item() if isinstance(number, np.generic) else number


def _operator(name: str, kind: str, mirrored: bool) -> Callable[[Value, Any], Any]:
    function = getattr(operator, name)

    def done(self: Value, other: Any) -> Any:
        self.tally[kind] += 1
        pair = (self.number, _plain(other))
        found = function(*(reversed(pair) if mirrored else pair))
        return found if kind == "compares" else Value(found, self.tally)

    return done


for _kind, _names in _KINDS.items():
    for _name in _names:
        setattr(Value, f"__{_name.strip('_')}__", _operator(_name, _kind, mirrored=False))
        if _kind != "compares":
            setattr(Value, f"__r{_name.strip('_')}__", _operator(_name, _kind, mirrored=True))


class Data:
    """An array of data: what is read and written counts as bytes that are moved."""

    def __init__(self, array: np.ndarray[Any, Any], tally: Tally) -> None:
        self.array, self.tally = array, tally

    @property
    def shape(self) -> tuple[int, ...]:
        """Sides of the array."""
        return self.array.shape

    @property
    def size(self) -> int:
        """Elements of the array."""
        return self.array.size

    def view(self, of: Any) -> "Data":
        """Return the same bytes as numbers of another type."""
        return Data(self.array.view(of.of), self.tally)

    def __getitem__(self, key: Any) -> Any:
        found = self.array[key]
        if isinstance(found, np.ndarray):
            return Data(found, self.tally)
        self.tally["bytes"] += found.itemsize
        return Value(found.item(), self.tally)

    def __setitem__(self, key: Any, given: Any) -> None:
        if isinstance(given, Data):
            self.tally["bytes"] += given.array.nbytes
            given = given.array
        self.array[key] = _plain(given)
        self.tally["bytes"] += self.array[key].nbytes


class _Type:
    """A type of numpy that keeps numbers counting."""

    def __init__(self, of: type, tally: Tally) -> None:
        self.of, self.tally = of, tally

    def __call__(self, number: Any) -> Any:
        if isinstance(number, Value):
            return Value(self.of(number.number).item(), self.tally)
        return self.of(number)


class _Numpy:
    """What kernels use of numpy; arrays that they make hold data if `scratch` says so."""

    inf, nan = np.inf, np.nan

    def __init__(self, tally: Tally, scratch: bool) -> None:
        self._tally, self._scratch = tally, scratch
        names = "bool_ uint8 int16 int32 uint32 int64 uint64 uintp float32 float64"
        for name in names.split():
            setattr(self, name, _Type(getattr(np, name), tally))

    def _made(self, array: np.ndarray[Any, Any]) -> Any:
        return Data(array, self._tally) if self._scratch else array

    def empty(self, shape: Any, of: Any = None) -> Any:
        return self._made(np.zeros(shape, getattr(of, "of", np.float64)))

    zeros = empty

    def full(self, shape: Any, value: Any) -> Any:
        return self._made(np.full(shape, value))

    def _rounded(self, number: Any, found: Any) -> Any:
        return Value(found.item(), self._tally) if isinstance(number, Value) else found

    def rint(self, number: Any) -> Any:
        return self._rounded(number, np.rint(_plain(number)))

    def floor(self, number: Any) -> Any:
        return self._rounded(number, np.floor(_plain(number)))


def counting(kernel: Callable[..., Any], tally: Tally, *, scratch: bool = True) -> Callable[..., Any]:
    """Make a kernel, and all that it calls, count what is done to `Data`."""
    twin = python_twin(kernel)

    def _extreme(of: Callable[..., Any]) -> Callable[..., Any]:
        def found(*numbers: Any) -> Any:
            if not any(isinstance(number, Value) for number in numbers):
                return of(*numbers)
            tally["compares"] += len(numbers) - 1
            return Value(of(*map(_plain, numbers)), tally)

        return found

    known = {**twin.__globals__, "np": _Numpy(tally, scratch), "min": _extreme(min), "max": _extreme(max)}
    for name in twin.__code__.co_names:
        called = twin.__globals__.get(name)
        if hasattr(called, "py_func") or isinstance(called, FunctionType):
            known[name] = counting(called, tally, scratch=scratch)
    return FunctionType(twin.__code__, known, twin.__name__, twin.__defaults__)
