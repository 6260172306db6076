"""Tables of the chapter: what the thesis prints beside what was measured."""

import math
from collections.abc import Mapping, Sequence

from dvc.dibr.peers.quality import PeerResult
from dvc.dibr.thesis.curves import Curves, Point, differences, worst_loss
from dvc.page.gallery import Table

ANCHOR = "quadtree"
TITLES = {"l": "L transform", "s": "S transform", ANCHOR: "quadtree", "blocks": "8x8 blocks"}
"""By the name that options have."""
THESIS_GAINS_DB = {"tsukuba": {"l": -0.09, "s": -0.12}, "teddy": {"l": 0.84, "s": 0.70}}
THESIS_LAYER_LOSS_DB = {"tsukuba": {"l": 0.29, "s": 0.29}, "teddy": {"l": 0.34, "s": 0.47}}
THESIS_MULTIPLIERS = {0.1: 1e-2, 0.5: 2e-3, 1.0: 4e-4}
"""By the rate of the reference view in bits per pixel."""
NOTHING = "-"


def points_table(name: str, curves: Curves) -> Table:
    """List all points of the curves of figure 3.13."""
    head = ("method", "lambda", "bytes", "rate [bpp]", "PSNR by (3.1) [dB]", "mean of PSNRs [dB]")
    rows = [
        (
            TITLES[method],
            f"{point.multiplier:.2e}",
            str(point.num_bytes),
            f"{point.rate_bpp:.3f}",
            f"{point.quality.pooled_db:.2f}",
            f"{point.quality.mean_db:.2f}",
        )
        for method, points in curves.items()
        for point in points
    ]
    caption = f"{name}: whole files over pixels of the reference, all views rendered from the decoded file"
    return Table(f"{name}: points of figure 3.13", caption, head, tuple(rows))


def gains_table(by_scene: Mapping[str, Curves]) -> Table:
    """Compare methods with the quadtree."""
    head = ("scene", "method", "BD-PSNR [dB]", "BD-rate [%]", "thesis [dB]")
    rows: list[tuple[str, ...]] = []
    gains: dict[str, list[float]] = {}
    for scene, curves in by_scene.items():
        for method, points in curves.items():
            if method == ANCHOR or ANCHOR not in curves:
                continue
            found = differences(points, curves[ANCHOR])
            cells = (NOTHING, NOTHING) if found is None else (f"{found[0]:+.2f}", f"{found[1]:+.1f}")
            if found is not None:
                gains.setdefault(method, []).append(found[0])
            thesis = THESIS_GAINS_DB.get(scene, {}).get(method)
            label = NOTHING if thesis is None else f"{thesis:+.2f}"
            rows.append((scene, TITLES[method], *cells, label))
    rows += [
        ("mean", TITLES[method], f"{sum(values) / len(values):+.2f}", "", "")
        for method, values in gains.items()
    ]
    caption = "Bjontegaard differences against the quadtree at the same lambdas, PSNR by (3.1)"
    return Table("Methods against the quadtree (figure 3.13)", caption, head, tuple(rows), 2)


def share_table(by_scene: Mapping[str, Curves]) -> Table:
    """List multiplier and share of disparities where the reference is nearest to the rates of the thesis."""
    head = ("scene", "method", "reference [bpp]", "lambda", "lambda, thesis", "share of disparities [%]")
    rows = []
    for scene, curves in by_scene.items():
        for method in ("l", "s"):
            for rate, thesis in THESIS_MULTIPLIERS.items() if method in curves else ():
                point = min(curves[method], key=lambda one: abs(math.log(one.reference_bpp / rate)))
                label = f"about {thesis:.0e} at {rate:g} bpp"
                bpp, share = f"{point.reference_bpp:.3f}", f"{100.0 * point.share:.1f}"
                rows.append((scene, TITLES[method], bpp, f"{point.multiplier:.2e}", label, share))
    caption = "Split of the rate; the thesis reports 13 to 23 % but for very low rates"
    return Table("Share of the disparities (figure 3.15)", caption, head, tuple(rows), 2)


def layers_table(by_scene: Mapping[str, Curves], layered: Mapping[str, Curves]) -> Table:
    """State what quality layers cost."""
    head = ("scene", "method", "layers", "largest loss [dB]", "thesis, at most [dB]")
    rows = []
    for scene, curves in layered.items():
        for method, points in curves.items():
            loss = worst_loss(points, by_scene[scene][method])
            thesis = THESIS_LAYER_LOSS_DB.get(scene, {}).get(method)
            label = NOTHING if thesis is None else f"{thesis:.2f}"
            cost = NOTHING if loss is None else f"{loss:.2f}"
            rows.append((scene, TITLES[method], str(len(points)), cost, label))
    caption = "Loss of PSNR by (3.1) at equal rates against files of one layer"
    return Table("Quality layers (figure 3.14)", caption, head, tuple(rows), 2)


def decomposition_table(by_scene: Mapping[str, Mapping[str, Point]]) -> Table:
    """Compare decompositions."""
    head = ("scene", "decomposition", "rate [bpp]", "disparities [bytes]", "PSNR by (3.1) [dB]")
    rows = [
        (
            scene,
            label,
            f"{point.rate_bpp:.3f}",
            str(point.disparity_bytes),
            f"{point.quality.pooled_db:.2f}",
        )
        for scene, points in by_scene.items()
        for label, point in points.items()
    ]
    caption = "L transform at one lambda: down to one pixel, or stopped earlier"
    return Table("Decomposition", caption, head, tuple(rows), 2)


def peers_table(name: str, ours: Sequence[Point], theirs: Mapping[str, Sequence[PeerResult | None]]) -> Table:
    """Compare with other codecs in as many bytes."""
    head = (
        "rate [bpp]",
        "codec",
        "bytes",
        "PSNR by (3.1) [dB]",
        "mean of PSNRs [dB]",
        "ours less this, mean [dB]",
        "second part [%]",
    )
    rows = []
    for index, point in enumerate(ours):
        rate, own = f"{point.rate_bpp:.3f}", point.quality
        cells = (str(point.num_bytes), f"{own.pooled_db:.2f}", f"{own.mean_db:.2f}")
        rows.append((rate, "ours, L transform", *cells, "", f"{100.0 * point.share:.0f}"))
        for peer, results in theirs.items():
            result = results[index]
            if result is None:
                rows.append((rate, peer, "needs more", NOTHING, NOTHING, NOTHING, NOTHING))
                continue
            found = result.quality
            cells = (str(result.num_bytes), f"{found.pooled_db:.2f}", f"{found.mean_db:.2f}")
            gain = f"{own.mean_db - found.mean_db:+.2f}"
            rows.append((rate, peer, *cells, gain, f"{100.0 * result.split:.0f}"))
    caption = (
        f"{name}, reference and one more view: the best that others make of at most as many bytes; "
        "second part: disparities, or the second view; P frames and two pictures give no other views"
    )
    return Table(f"{name}: other codecs", caption, head, tuple(rows), 2)
