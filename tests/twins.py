"""Kernels as they are compiled, and as plain Python."""

from collections.abc import Callable
from typing import Any

Choose = Callable[[Any], Any]
"""Turns a kernel into the function under test: the fixture `choose`."""
