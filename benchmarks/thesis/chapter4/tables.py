"""Tables of the chapter: what the thesis prints beside what was measured."""

from collections.abc import Mapping, Sequence

from benchmarks.thesis.chapter4.curves import MapPoint, PicturePoint
from benchmarks.thesis.chapter4.signals import SignalBands, largest_high
from dvc.web.gallery import Table


def map_table(name: str, curves: Mapping[str, Sequence[MapPoint]]) -> Table:
    """List the points of figure 4.8a."""
    rows = [
        (
            label,
            f"{point.rate_bpp:.4f}",
            f"{point.psnr_db:.2f}",
            f"{point.edges_bpp:.4f}",
            str(point.edges.count()),
        )
        for label, points in curves.items()
        for point in points
    ]
    head = ("transform", "rate [bpp]", "PSNR [dB]", "edges [bpp]", "edges")
    return Table(
        f"{name}: points of figure 4.8a", "Whole files, header and edges included", head, tuple(rows)
    )


def picture_table(name: str, points: Sequence[PicturePoint]) -> Table:
    """List the points of figure 4.8b."""
    rows = [
        (
            f"{point.rate_bpp:g}",
            *(f"{psnr:.2f}" for psnr in (point.standard_db, point.shape_adaptive_db, point.chosen_db)),
        )
        for point in points
    ]
    head = ("coefficients [bpp]", "no edges [dB]", "shared edges [dB]", "the better one [dB]")
    caption = "Luma at equal bits of coefficients, symmetric extension; edges count with the map"
    return Table(f"{name}: points of figure 4.8b", caption, head, tuple(rows))


def signal_table(bands: SignalBands) -> Table:
    """List the largest coefficients of figure 4.3."""
    pairs = zip(largest_high(bands.standard), largest_high(bands.shape_adaptive), strict=True)
    rows = [(str(scale), f"{theirs:.3f}", f"{ours:.1e}") for scale, (theirs, ours) in enumerate(pairs, 1)]
    caption = (
        "Largest absolute coefficient of each high band, the finest first; the signal is from 0.25 to 0.9"
    )
    head = ("scale", "standard", "shape-adaptive, cubic")
    return Table("Piecewise polynomials (figure 4.3)", caption, head, tuple(rows))
