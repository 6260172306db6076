"""Tables of the chapter: what the thesis prints beside what was measured."""

from collections.abc import Mapping, Sequence

from dvc.dibr.thesis.chapter4.coefficients import STEP, HighBands
from dvc.dibr.thesis.chapter4.curves import SHAPE_ADAPTIVE, STANDARD, MapPoint, PicturePoint
from dvc.dibr.thesis.chapter4.signals import SignalBands, largest_high
from dvc.page.gallery import Table

THESIS_MAP_DB = {("teddy", 0.04): (36.21, 39.86)}
"""PSNR by both transforms, by set and rate."""


def map_table(name: str, rates: Sequence[float], curves: Mapping[str, Sequence[MapPoint]]) -> Table:
    """List the points of figure 4.8a."""
    head = (
        "rate [bpp]",
        "standard [dB]",
        "shape-adaptive [dB]",
        "gain [dB]",
        "edges [bpp]",
        "edges",
        "thesis [dB]",
    )
    rows = []
    for rate, theirs, ours in zip(rates, curves[STANDARD], curves[SHAPE_ADAPTIVE], strict=True):
        thesis = THESIS_MAP_DB.get((name, rate))
        label = "-" if thesis is None else f"{thesis[0]:.2f} to {thesis[1]:.2f}"
        cells = (f"{theirs.psnr_db:.2f}", f"{ours.psnr_db:.2f}", f"{ours.psnr_db - theirs.psnr_db:+.2f}")
        rows.append((f"{rate:g}", *cells, f"{ours.edges_bpp:.4f}", str(ours.edges.count()), label))
    caption = f"{name}: whole files, header and edges included; edges are those that are worth their bits"
    return Table(f"{name}: depth map (figure 4.8a)", caption, head, tuple(rows))


def picture_table(name: str, points: Sequence[PicturePoint], edges_bpp: float) -> Table:
    """List the points of figure 4.8b."""
    head = (
        "coefficients [bpp]",
        "no edges [dB]",
        "shared edges [dB]",
        "as written [dB]",
        "gain as written [dB]",
    )
    rows = [
        (
            f"{point.rate_bpp:g}",
            f"{point.standard_db:.2f}",
            f"{point.shape_adaptive_db:.2f}",
            f"{point.chosen_db:.2f}",
            f"{point.gain_db:+.2f}",
        )
        for point in points
    ]
    caption = (
        f"{name}: luma at equal bits of coefficients, order 0, edges of {edges_bpp:.4f} bpp that count with "
        "the map; as written: without them where they do not help"
    )
    return Table(f"{name}: picture (figure 4.8b)", caption, head, tuple(rows))


def entropy_table(by_scene: Mapping[str, Mapping[str, HighBands]]) -> Table:
    """List the entropies of figure 4.6."""
    rows = [
        (scene, name, f"{found.entropy_bpp:.3f}", f"{100.0 * found.nonzero_share:.2f}")
        for scene, bands in by_scene.items()
        for name, found in bands.items()
    ]
    caption = f"High bands of the map, quantised in steps of 1/{round(1 / STEP)} of its range"
    head = ("scene", "transform", "entropy [bits per pixel]", "not zero [%]")
    return Table("Entropy of coefficients (figure 4.6)", caption, head, tuple(rows), 2)


def signal_table(bands: SignalBands) -> Table:
    """List the largest coefficients of figure 4.3."""
    pairs = zip(largest_high(bands.standard), largest_high(bands.shape_adaptive), strict=True)
    rows = [(str(scale), f"{theirs:.3f}", f"{ours:.1e}") for scale, (theirs, ours) in enumerate(pairs, 1)]
    caption = (
        "Largest absolute coefficient of each high band, the finest first; the signal is from 0.25 to 0.9"
    )
    head = ("scale", "standard", "shape-adaptive, cubic")
    return Table("Piecewise polynomials (figure 4.3)", caption, head, tuple(rows))
