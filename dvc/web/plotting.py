"""Line plots that are readable without colour vision, with the same bytes for the same numbers."""

import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BytesIO
from typing import TYPE_CHECKING, Any, NamedTuple

from dvc.environment import without_settings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#B87F00", "#3D93CC")
"""Palette of Okabe and Ito, distinguishable without colour vision; markers and dashes differ as well."""
MARKERS = ("o", "s", "^", "D", "v", "P")
DASHES = ("solid", "dash", "dot", "dashdot", "longdash", "longdashdot")
MATPLOTLIB_DASHES = {
    "solid": (0, ()),
    "dash": (0, (5, 2)),
    "dot": (0, (1, 1.6)),
    "dashdot": (0, (5, 1.6, 1, 1.6)),
    "longdash": (0, (9, 2.5)),
    "longdashdot": (0, (9, 2, 1, 2)),
}
SIZE_INCHES = (7.0, 4.8)
DPI = 150
SUFFIXES = (".png", ".svg")
_SETTINGS = {"svg.hashsalt": "dvc3d", "svg.fonttype": "none", "font.size": 10}


class Line(NamedTuple):
    """One line of a plot."""

    label: str  # for the legend
    xs: Sequence[float]
    ys: Sequence[float]


@contextmanager
def new_figure(
    size_inches: tuple[float, float] = SIZE_INCHES, settings: Mapping[str, Any] = _SETTINGS
) -> "Iterator[Figure]":
    """Open a figure with the same bytes for the same results, independent of matplotlib settings."""
    with without_settings("matplotlibrc"):
        from matplotlib import style
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

    with style.context(["default", dict(settings)]):
        figure = Figure(figsize=size_inches, layout="constrained")
        FigureCanvasAgg(figure)
        yield figure


def contents(figure: "Figure", suffix: str) -> bytes:
    """Return a figure as a file."""
    written = BytesIO()
    metadata = {"Date": None} if suffix == ".svg" else {}
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # letters that the font lacks
        figure.savefig(written, format=suffix[1:], dpi=DPI, metadata=metadata)
    return written.getvalue()


def plain(text: str) -> str:
    """Escape a name that matplotlib would read as a formula or leave out of the legend."""
    return text.replace("$", r"\$").removeprefix("_")


def line_plot(lines: Sequence[Line], title: str, x_label: str, y_label: str) -> dict[str, bytes]:
    """Return a plot of lines as PNG and SVG."""
    with new_figure() as figure:
        axes = figure.add_subplot()
        for number, line in enumerate(lines):
            round_, i = divmod(number, len(COLOURS))
            axes.plot(
                line.xs,
                line.ys,
                color=COLOURS[i],
                marker=MARKERS[(i + round_) % len(MARKERS)],
                linestyle=MATPLOTLIB_DASHES[DASHES[i % len(DASHES)]],
                label=plain(line.label),
            )
        axes.set_title(plain(title), fontsize=10)
        axes.set_xlabel(x_label)
        axes.set_ylabel(y_label)
        axes.grid(color="#dddddd", linewidth=0.8)
        axes.set_axisbelow(True)
        axes.legend(loc="best", frameon=True)
        return {suffix: contents(figure, suffix) for suffix in SUFFIXES}
