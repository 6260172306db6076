"""Independent coding: disparities by stereo matching, then disparities and reference as two pictures.

Matching knows nothing of rates, and coding nothing of what disparities are for. The same renderer makes the
other views of both; the split of the bytes between both pictures is the best of those that were tried.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from benchmarks.baselines.picture_coders import CodedPicture, Ladder, PictureCoder
from benchmarks.baselines.quality import PeerResult, Quality, quality_of
from dvc.dibr.view_rendering import PictureAndDisparity, picture_of, render_pairs
from dvc.dibr.view_set import Views
from dvc.errors import ConfigError
from dvc.geometry.camera_array import CameraArray, DisparityLabels
from dvc.images.colour import Picture

Floats = NDArray[np.float64]

PEAK = 255
FIRST_SHARES = 0.04, 0.1, 0.2, 0.35
"""Shares of the disparities that are tried first; then those beside the best one."""
REFINEMENTS = 3


def semi_global_disparity(array: CameraArray, labels: DisparityLabels) -> Floats:
    """Match a left and a right view by OpenCV, holes filled."""
    from dvc.stereo.opencv_baseline import semi_global_baseline

    baseline = array[1].position.m - array[0].position.m
    if baseline <= 0.0 or array[1].position.n != array[0].position.n or labels.lowest < 0.0:
        raise ConfigError("StereoSGBM takes a left and a right view, and disparities from 0 on")
    return semi_global_baseline(array[0].image, array[1].image, labels.highest * baseline) / baseline


def stereo_disparity(array: CameraArray, labels: DisparityLabels) -> Floats:
    """Match views as `dvc-stereo reconstruct` does."""
    from dvc.stereo.surfaces.reconstruction import reconstruct
    from dvc.stereo.surfaces.settings import StereoSettings

    found = reconstruct(array, labels, StereoSettings())
    return found.surfaces[0].disparity.astype(np.float64)


MATCHERS: dict[str, Callable[[CameraArray, DisparityLabels], Floats]] = {
    "StereoSGBM": semi_global_disparity,
    "dvc.stereo": stereo_disparity,
}
"""By name."""


@dataclass(eq=False)
class IndependentCodec:
    """Reference and disparities as two pictures."""

    views: Views  # gray, of one reference
    disparity: Floats  # of the reference
    labels: DisparityLabels  # range of the disparities: gray levels 0 and 255 are its ends
    coder: PictureCoder  # of both pictures
    _pictures: Ladder = field(init=False, repr=False)
    _depths: Ladder = field(init=False, repr=False)
    _results: dict[tuple[int, int], PeerResult] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        self._pictures = Ladder(self.coder, self.views.pictures[self.views.references[0]])
        place = (self.disparity - self.labels.lowest) / max(self.labels.highest - self.labels.lowest, 1e-9)
        levels = np.floor(np.clip(place, 0.0, 1.0) * PEAK + 0.5).astype(np.uint8)
        self._depths = Ladder(self.coder, levels)

    def best_within(
        self, max_bytes: int, measure: Callable[[Quality], float] = lambda quality: quality.pooled_db
    ) -> PeerResult:
        """Code at the best split."""
        tried: dict[int, PeerResult] = {}
        for share in FIRST_SHARES:
            if (depth := self._depths.within(share * max_bytes)) is not None:
                self._try(depth, max_bytes, tried)
        if not tried:
            self._try(self._depths.at(0), max_bytes, tried)
        if not tried:
            raise ConfigError(f"{max_bytes} bytes are too few for two pictures of {self.coder.name}")
        step = max(self.coder.num_levels // 12, 1)
        for _ in range(REFINEMENTS):
            best = max(tried, key=lambda level: measure(tried[level].quality))
            for level in (best - step, best + step):
                if 0 <= level < self.coder.num_levels:
                    self._try(self._depths.at(level), max_bytes, tried)
            step = max(step // 2, 1)
        return max(tried.values(), key=lambda result: measure(result.quality))

    def _try(self, depth: CodedPicture, max_bytes: int, tried: dict[int, PeerResult]) -> None:
        """Give what a disparity picture leaves to the reference, and note what becomes of the views."""
        picture = self._pictures.within(max_bytes - depth.num_bytes)
        if depth.level in tried or picture is None:
            return
        key = picture.level, depth.level
        if key not in self._results:
            num_bytes = picture.num_bytes + depth.num_bytes
            quality = quality_of(self._rendered(picture.picture, depth.picture), self.views.pictures)
            setting = f"{self.coder.name} at {picture.level} and {depth.level}"
            self._results[key] = PeerResult(num_bytes, quality, depth.num_bytes / num_bytes, setting)
        tried[depth.level] = self._results[key]

    def _rendered(self, picture: Picture, depth: Picture) -> list[Picture]:
        span = self.labels.highest - self.labels.lowest
        disparity = self.labels.lowest + span * depth.astype(np.float64) / PEAK
        own = self.views.viewpoints[self.views.references[0]]
        pair = PictureAndDisparity(picture, disparity, own)
        return [
            picture if viewpoint == own else picture_of(render_pairs([pair], viewpoint, self.labels.step))
            for viewpoint in self.views.viewpoints
        ]
