"""Everything to compare with, on a reference and one more view, in as many bytes as our file has."""

from collections.abc import Callable, Mapping

from benchmarks.baselines.independent import MATCHERS, IndependentCodec
from benchmarks.baselines.picture_coders import AVIF, PICTURE_CODERS
from benchmarks.baselines.quality import PeerResult
from benchmarks.baselines.two_views import X264, X265, VideoCoder, intra_and_predicted, two_pictures
from dvc.dibr.view_set import views_of_array
from dvc.errors import ConfigError
from dvc.geometry.camera_array import CameraArray, DisparityLabels

Peer = Callable[[int], PeerResult]
"""From a number of bytes to the best that fits."""
TWO_VIEW_AVIF = "two-view AVIF"
P_FRAMES: Mapping[str, VideoCoder] = {f"P frame of {coder.name}": coder for coder in (X264, X265)}


def independent_peers(array: CameraArray, labels: DisparityLabels, matcher: str) -> dict[str, Peer]:
    """Return independent coding of disparities of one matcher, by each picture coder."""
    disparity = MATCHERS[matcher](array, labels)
    views = views_of_array(array, gray=True)
    return {
        f"{matcher} and {coder.name}": IndependentCodec(views, disparity, labels, coder).best_within
        for coder in PICTURE_CODERS
    }


def two_view_peers(array: CameraArray) -> dict[str, Peer]:
    """Return codings of both views as they are."""
    first, second = views_of_array(array, gray=True).pictures
    both = first, second

    def _predicted(coder: VideoCoder) -> Peer:
        return lambda max_bytes: intra_and_predicted(both, coder, max_bytes)

    peers: dict[str, Peer] = {TWO_VIEW_AVIF: lambda max_bytes: two_pictures(both, AVIF, max_bytes)}
    return peers | {name: _predicted(coder) for name, coder in P_FRAMES.items()}


def all_peers(array: CameraArray, labels: DisparityLabels) -> dict[str, Peer]:
    """Return all that can be had for two views."""
    peers: dict[str, Peer] = {}
    for matcher in MATCHERS:
        try:
            peers |= independent_peers(array, labels, matcher)
        except ConfigError:
            continue
    return peers | two_view_peers(array)


def within(peer: Peer, max_bytes: int) -> PeerResult | None:
    """Return what a peer makes of a number of bytes."""
    try:
        return peer(max_bytes)
    except ConfigError:
        return None
