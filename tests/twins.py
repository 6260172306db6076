"""Kernels as they are compiled, and as plain Python."""

from collections.abc import Callable
from types import ModuleType
from typing import Any

import pytest

from dvc._jit import python_twin

Choose = Callable[[Any], Any]
"""Turns a kernel into the function under test: the fixture `choose`."""


def compiled_and_python(module: ModuleType, *names: str) -> Any:
    """Return a fixture that runs kernels of a module compiled, and as Python."""

    @pytest.fixture(params=["compiled", "python"])
    def _kind(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
        for name in names if request.param == "python" else ():
            monkeypatch.setattr(module, name, python_twin(getattr(module, name)))

    return _kind
