"""Tables of the chapter: what the thesis prints beside what was measured."""

from collections.abc import Mapping, Sequence

from benchmarks.baselines.quality import PeerResult
from benchmarks.thesis.chapter3.curves import Curves, Point
from dvc.web.gallery import Table

_TITLES = {"l": "L", "s": "S", "blocks": "8x8 blocks"}
THESIS_GAINS_DB = {"tsukuba": {"l": -0.09, "s": -0.12}, "teddy": {"l": 0.84, "s": 0.70}}
THESIS_LAYER_LOSS_DB = {"tsukuba": {"l": 0.29, "s": 0.29}, "teddy": {"l": 0.34, "s": 0.47}}
THESIS_MULTIPLIERS = {0.1: 1e-2, 0.5: 2e-3, 1.0: 4e-4}
"""By the rate of the reference view in bits per pixel."""
THESIS_SHARES = {0.1: "not 13 to 23", 0.5: "13 to 23", 1.0: "13 to 23"}
"""In per cent, by the same: 'except at very low bitrates'."""
NOTHING = "-"


def title(method: str) -> str:
    """Return what a method is called."""
    return _TITLES.get(method, method)


def points_table(name: str, curves: Curves) -> Table:
    """List all points of the curves of figure 3.13."""
    head = ("method", "lambda", "bytes", "rate [bpp]", "PSNR by (3.1) [dB]", "mean of PSNRs [dB]")
    rows = [
        (
            title(method),
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
