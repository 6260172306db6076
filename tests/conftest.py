"""What all tests share: the hypothesis profile, small videos, and the real sequences where present."""

import os
import signal
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from dvc._jit import python_twin
from dvc.video import Frame, chroma_shape
from dvc.video.frames import Plane
from tests import browser as browsers
from tests.twins import Choose

if TYPE_CHECKING:
    from playwright.sync_api import Browser

# Jobs in the background ignore the interrupt, and processes that the tests start would inherit that.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

os.environ["DVC_COMPILATION_NOTICE"] = ""  # what commands write does not depend on the cache of kernels

LIBRARIES = ("GLIBC_", "NPY_", "NUMBA_", "OMP_", "OPENBLAS_", "OPENCV_", "PYTHON")
"""How variables begin by which libraries choose their code."""

# The first call of a compiled kernel can take seconds, and so can anything on a busy machine.
settings.register_profile(
    "dvc", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("dvc")


@pytest.fixture(autouse=True)
def _environment_stays() -> Iterator[None]:
    """Refuse tests that leave other settings of libraries to those after them."""
    before = dict(os.environ)
    yield
    changed = {name for name, _ in before.items() ^ os.environ.items()}
    assert not {name for name in changed if name.startswith(LIBRARIES)}


@pytest.fixture
def rng() -> np.random.Generator:
    """Return a fresh generator."""
    return np.random.default_rng(5)


@pytest.fixture(params=["compiled", "python"])
def choose(request: pytest.FixtureRequest) -> Choose:
    """Return what turns a kernel into the function under test."""
    return python_twin if request.param == "python" else lambda kernel: kernel


@pytest.fixture(scope="session")
def shared_sequences() -> Path:
    """Return the folder of real sequences beside the project; skip the test where there is none."""
    folder = Path(__file__).resolve().parents[1].parent / "shared" / "sequences"
    if not folder.is_dir():
        pytest.skip(f"no real sequences in {folder}")
    return folder


@pytest.fixture(scope="session")
def moving_frames() -> Callable[..., list[Frame]]:
    """Return a function that makes a moving pattern with a little noise, in colour or grey."""

    def make(count: int, width: int, height: int, *, grey: bool = False) -> list[Frame]:
        rng = np.random.default_rng(count * 7919 + width * 31 + height)
        rows, columns = np.mgrid[:height, :width]

        def plane(k: int, step: int) -> Plane:
            wave = 128 + 60 * np.sin((columns * step + 3 * k) / 9) + 40 * np.cos((rows * step - k) / 7)
            samples: Plane = np.clip(wave + rng.normal(0, 3, wave.shape), 0, 255).astype(np.uint8)
            return samples

        chroma_rows, chroma_columns = chroma_shape(height, width)
        frames = []
        for k in range(count):
            luma = plane(k, 1)
            cb, cr = (plane(k + i, 2)[:chroma_rows, :chroma_columns].copy() for i in (5, 11))
            frames.append(Frame(luma, None if grey else (cb, cr)))
        return frames

    return make


@pytest.fixture(scope="module")
def browser(request: pytest.FixtureRequest) -> Iterator["Browser"]:
    """Start a browser; without one tests of pages are skipped, or fail where it is required."""
    yield from _started_browser(request, browsers.ARGUMENTS)


@pytest.fixture(scope="module")
def graphics_browser(request: pytest.FixtureRequest) -> Iterator["Browser"]:
    """Start a browser with WebGL 2, as `browser` does."""
    yield from _started_browser(request, browsers.GRAPHICS_ARGUMENTS)


def _started_browser(request: pytest.FixtureRequest, arguments: Sequence[str]) -> Iterator["Browser"]:
    from playwright.sync_api import sync_playwright

    browsers.deny_real_time()
    path = browsers.find()
    if path is None and browsers.is_required():
        pytest.fail(browsers.missing())
    if path is None:
        request.node.add_marker(pytest.mark.skip(browsers.missing()))  # of the module: one line for all tests
        pytest.skip(browsers.missing())
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=path, args=list(arguments), timeout=60_000)
        yield started
        started.close()
