"""Other codecs of two views in as many bytes: what joint coding gains over coding one after the other."""

from collections.abc import Callable, Mapping
from functools import cache, partial
from typing import Any

from benchmarks.figures.harness import Figure, Measured, Setting
from benchmarks.figures.stereo.runs import MOTORCYCLE, data_folder
from dvc.dibr.codec.views import views_of_array
from dvc.dibr.peers.comparison import Peer, two_view_peers, within
from dvc.dibr.peers.independent import MATCHERS, IndependentCodec
from dvc.dibr.peers.picture_coders import PICTURE_CODERS
from dvc.dibr.peers.quality import PeerResult, Quality
from dvc.dibr.stream.header import DisparityMethod
from dvc.dibr.thesis.curves import Point, curve
from dvc.dibr.thesis.scenes import Scene, load_scenes
from dvc.errors import ConfigError

AREA = "dibr"
SLOPES: Mapping[str, tuple[float, ...]] = {"teddy": (2e-3, 4e-4), "cones": (2e-3,), MOTORCYCLE: (2e-3,)}
"""Of our files, by the pair; others may take as many bytes."""
INDEPENDENT = {"independent-sgbm": "StereoSGBM", "independent-stereo": "dvc.stereo"}
TWO_VIEWS = {
    "two-view-avif": "two-view AVIF",
    "p-frame-x264": "P frame of x264",
    "p-frame-x265": "P frame of x265",
}
MEASURES: Mapping[str, Callable[[Quality], float]] = {
    "pooled_db": lambda quality: quality.pooled_db,
    "mean_db": lambda quality: quality.mean_db,
}
"""PSNR by (3.1), and the mean of the PSNRs of both views."""


@cache
def _pair(name: str) -> Scene:
    data = None if name == MOTORCYCLE else data_folder(name)
    (scene,) = load_scenes(data, [name])
    return Scene(name, scene.pair, scene.labels)


@cache
def _ours(name: str) -> list[Point]:
    scene = _pair(name)
    return curve(scene.views, scene.labels, DisparityMethod.L, SLOPES[name])


def _compared(ours: Point, found: Mapping[str, PeerResult]) -> dict[str, Any]:
    """Put our PSNRs beside the best of others, for each way to take the mean."""
    quality, row = ours.quality, {"rate_bpp": ours.rate_bpp, "bytes": ours.num_bytes}
    for measure, of in MEASURES.items():
        row[f"ours_{measure}"] = of(quality)
        row[f"theirs_{measure}"] = of(found[measure].quality)
        row[f"gain_{measure}"] = of(quality) - of(found[measure].quality)
    return {**row, "their_bytes": found["pooled_db"].num_bytes, "their_setting": found["pooled_db"].setting}


def _text(rows: Mapping[str, Mapping[str, Any]]) -> str:
    each = (f"{name} {row['gain_pooled_db']:+.2f} ({row['gain_mean_db']:+.2f})" for name, row in rows.items())
    return ", ".join(each) + " dB"


def independent(setting: Setting, clip: str, matcher: str) -> Measured:
    """Compare with disparities of a matcher and the reference as two pictures, at their best split."""
    del clip
    rows = {}
    for name in tuple(SLOPES)[: setting.choose(len(SLOPES), 1)]:
        scene = _pair(name)
        disparity = MATCHERS[matcher](scene.array, scene.labels)
        views = views_of_array(scene.array, gray=True)
        codecs = [IndependentCodec(views, disparity, scene.labels, coder) for coder in PICTURE_CODERS]
        for point in _ours(name):
            found = {measure: _best(codecs, point.num_bytes, of) for measure, of in MEASURES.items()}
            rows[f"{name} at {point.rate_bpp:.2f} bpp"] = _compared(point, found)
    gains = [row[f"gain_{measure}"] for row in rows.values() for measure in MEASURES]
    best = {row["their_setting"].rpartition(" at ")[0] for row in rows.values()}
    return Measured(_text(rows), min(gains) > 0.0, dict(rows), f"best coder: {' or '.join(sorted(best))}")


def _best(codecs: list[IndependentCodec], max_bytes: int, measure: Callable[[Quality], float]) -> PeerResult:
    found = []
    for codec in codecs:
        try:
            found.append(codec.best_within(max_bytes, measure))
        except ConfigError:
            continue
    return max(found, key=lambda result: measure(result.quality))


def two_views(setting: Setting, clip: str, peer: str) -> Measured:
    """Compare with both views coded as they are, from which no other view can be had."""
    del clip
    rows = {}
    for name in tuple(SLOPES)[: setting.choose(len(SLOPES), 1)]:
        coded: Peer = two_view_peers(_pair(name).array)[peer]
        for point in _ours(name):
            result = within(coded, point.num_bytes)
            if result is not None:
                found = dict.fromkeys(MEASURES, result)
                rows[f"{name} at {point.rate_bpp:.2f} bpp"] = _compared(point, found)
    return Measured(_text(rows), None, dict(rows), "these two views only; ours gives any view between")


FIGURES = (
    *(
        Figure(
            AREA,
            name,
            f"two gray views in as many bytes: ours less disparities by {matcher} with the reference, AVIF "
            "or JPEG 2000 at the best split; PSNR by (3.1), and mean of PSNRs in brackets",
            "> 0 dB each",
            partial(independent, matcher=matcher),
            slow=True,
        )
        for name, matcher in INDEPENDENT.items()
    ),
    *(
        Figure(
            AREA,
            name,
            f"two gray views in as many bytes: ours less {peer}; PSNR by (3.1), and mean of PSNRs in "
            "brackets",
            "printed: where it wins and loses",
            partial(two_views, peer=peer),
            slow=True,
        )
        for name, peer in TWO_VIEWS.items()
    ),
)
"""The figures of this module."""
