"""Baselines of two views: matched disparities coded as a picture, two pictures, and a predicted frame.

Only the first of them gives further views. Its matching ignores rates and its coding ignores the purpose of
disparities; the renderer is that of this project.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import partial
from typing import Final, Literal

import av
import numpy as np
from numpy.typing import NDArray

from benchmarks.baselines.opencv_stereo import semi_global_baseline
from benchmarks.baselines.picture_coders import (
    AVIF,
    PICTURE_CODERS,
    Baseline,
    BaselineResult,
    CodedPicture,
    Ladder,
    PictureCoder,
    best,
    highest_fitting,
    quality_of,
)
from dvc.dibr.view_rendering import PictureAndDisparity, picture_of, render_pairs
from dvc.dibr.view_set import Views, views_of_array
from dvc.errors import ConfigError
from dvc.geometry.camera_array import CameraArray, DisparityLabels
from dvc.images.colour import Picture
from dvc.metrics import PEAK
from dvc.rd.anchors.anchor_files import without_overhead
from dvc.stereo.surfaces.reconstruct import reconstruct

Floats = NDArray[np.float64]

FIRST_SHARES, REFINEMENTS = (0.04, 0.1, 0.2, 0.35), 3
"""Shares of the disparities in the bytes that are tried first, and refinements of the best of them."""
LEVEL_OFFSETS = -6, -3, 0, 3, 6
"""Quality of the second picture minus that of the first."""
QP_OFFSETS = 0, 1, 2, 3, 4
"""QP of the P frame minus that of the I frame."""
LOWEST_QP, HIGHEST_QP = 8, 51


def semi_global_disparity(array: CameraArray, labels: DisparityLabels) -> Floats:
    """Match a left and a right view by OpenCV, holes filled."""
    baseline = array[1].position.m - array[0].position.m
    if baseline <= 0.0 or array[1].position.n != array[0].position.n or labels.lowest < 0.0:
        raise ConfigError("StereoSGBM takes a left and a right view, and disparities of at least 0")
    return semi_global_baseline(array[0].image, array[1].image, labels.highest * baseline) / baseline


MATCHERS: dict[str, Callable[[CameraArray, DisparityLabels], Floats]] = {
    "StereoSGBM": semi_global_disparity,
    "dvc.stereo": lambda array, labels: reconstruct(array, labels).surfaces[0].disparity.astype(np.float64),
}


@dataclass(eq=False)
class PictureAndDepth:
    """Reference and its disparities as two pictures, at the best split of the bytes that is tried."""

    name: str
    views: Views  # gray views of one reference
    disparity: Floats  # disparities of the reference
    labels: DisparityLabels  # range of the gray levels 0 to 255
    coder: PictureCoder
    _results: dict[tuple[int, int], BaselineResult] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        self._pictures = Ladder(self.coder, self.views.pictures[self.views.references[0]])
        span = max(self.labels.highest - self.labels.lowest, 1e-9)
        share = np.clip((self.disparity - self.labels.lowest) / span, 0.0, 1.0)
        self._depths = Ladder(self.coder, np.floor(share * PEAK + 0.5).astype(np.uint8))

    def best_within(self, max_bytes: int) -> BaselineResult | None:
        """Try several splits, then qualities next to that of the best one."""
        tried: dict[int, BaselineResult] = {}
        for share in FIRST_SHARES:
            if (depth := self._depths.within(share * max_bytes)) is not None:
                self._try(depth, max_bytes, tried)
        if not tried:
            self._try(self._depths.at(0), max_bytes, tried)
        step = max(self.coder.num_levels // 12, 1)
        for _ in range(REFINEMENTS if tried else 0):
            middle = max(tried, key=lambda level: tried[level].quality.pooled_db)
            for level in (middle - step, middle + step):
                if 0 <= level < self.coder.num_levels:
                    self._try(self._depths.at(level), max_bytes, tried)
            step = max(step // 2, 1)
        return best(list(tried.values()))

    def _try(self, depth: CodedPicture, max_bytes: int, tried: dict[int, BaselineResult]) -> None:
        """Code the reference in the bytes that a picture of disparities leaves, and render the views."""
        picture = self._pictures.within(max_bytes - depth.num_bytes)
        if depth.level in tried or picture is None:
            return
        key = picture.level, depth.level
        if key not in self._results:
            num_bytes = picture.num_bytes + depth.num_bytes
            quality = quality_of(self._rendered(picture.picture, depth.picture), self.views.pictures)
            setting = f"{self.coder.name} at {picture.level} and {depth.level}"
            self._results[key] = BaselineResult(num_bytes, quality, depth.num_bytes / num_bytes, setting)
        tried[depth.level] = self._results[key]

    def _rendered(self, picture: Picture, depth: Picture) -> list[Picture]:
        span = self.labels.highest - self.labels.lowest
        reference = self.views.viewpoints[self.views.references[0]]
        disparity = self.labels.lowest + span * depth.astype(np.float64) / PEAK
        pair = PictureAndDisparity(picture, disparity, reference)
        return [
            picture
            if viewpoint == reference
            else picture_of(render_pairs([pair], viewpoint, self.labels.step))
            for viewpoint in self.views.viewpoints
        ]


@dataclass(frozen=True, eq=False)
class TwoPictures:
    """Both views as pictures, at the best split of the bytes."""

    name: str
    pictures: tuple[Picture, Picture]
    coder: PictureCoder

    def best_within(self, max_bytes: int) -> BaselineResult | None:
        """Try several differences between both qualities."""
        ladders = Ladder(self.coder, self.pictures[0]), Ladder(self.coder, self.pictures[1])

        def pair_bytes(level: int, offset: int) -> int:
            return sum(coded.num_bytes for coded in _coded_pair(ladders, offset, level))

        results = []
        for offset in LEVEL_OFFSETS:
            level = highest_fitting(self.coder.num_levels, partial(pair_bytes, offset=offset), max_bytes)
            if level >= 0:
                first, second = _coded_pair(ladders, offset, level)
                num_bytes = first.num_bytes + second.num_bytes
                quality = quality_of([first.picture, second.picture], self.pictures)
                setting = f"{self.coder.name} at {first.level} and {second.level}"
                results.append(BaselineResult(num_bytes, quality, second.num_bytes / num_bytes, setting))
        return best(results)


def _coded_pair(ladders: tuple[Ladder, Ladder], offset: int, level: int) -> tuple[CodedPicture, CodedPicture]:
    highest = ladders[0].coder.num_levels - 1
    return ladders[0].at(level), ladders[1].at(min(max(level + offset, 0), highest))


@dataclass(frozen=True)
class VideoCoder:
    """A video encoder that codes an I frame and a P frame."""

    name: str
    library: Literal["libx264", "libx265"]  # name of the encoder in FFmpeg
    decoder: Literal["h264", "hevc"]  # name of the decoder in FFmpeg
    parameters: str  # all differences from the preset except QPs
    preset: str = "slow"


# Constant QPs, PSNR rather than looks, wide search as views are far from each other; one thread.
X264: Final = VideoCoder(
    "x264",
    "libx264",
    "h264",
    "psy=0:scenecut=0:mbtree=0:bframes=0:weightp=0:rc-lookahead=0:sync-lookahead=0:sliced-threads=0:"
    "threads=1:me=umh:merange=64",
)
X265: Final = VideoCoder(
    "x265",
    "libx265",
    "hevc",
    "log-level=-1:psy-rd=0:psy-rdoq=0:aq-mode=0:cutree=0:scenecut=0:bframes=0:b-adapt=0:weightp=0:"
    "rc-lookahead=0:lookahead-slices=0:pools=none:frame-threads=1:wpp=0:info=0:merange=64",
)


@dataclass(frozen=True, eq=False)
class PredictedFrame:
    """The first view as an I frame and the second one as a P frame of a video coder."""

    name: str
    pictures: tuple[Picture, Picture]
    coder: VideoCoder

    def best_within(self, max_bytes: int) -> BaselineResult | None:
        """Try several differences between both QPs."""
        results = []
        for offset in QP_OFFSETS:
            low, high, stream = LOWEST_QP - 1, HIGHEST_QP + 1 - offset, list[bytes]()
            while high - low > 1:
                qp = (low + high) // 2
                tried = list(encode_frames(self.pictures, self.coder, qp, offset))
                if sum(map(len, tried)) <= max_bytes:
                    high, stream = qp, tried
                else:
                    low = qp
            if stream:
                num_bytes, setting = sum(map(len, stream)), f"QP {high} and {high + offset}"
                quality = quality_of(decode_frames(stream, self.coder), self.pictures)
                results.append(BaselineResult(num_bytes, quality, len(stream[-1]) / num_bytes, setting))
        return best(results)


def encode_frames(pictures: Sequence[Picture], coder: VideoCoder, qp: int, offset: int) -> Iterator[bytes]:
    """Code an I frame, and P frames after it."""
    if coder.library not in av.codecs_available:
        raise ConfigError(f"this PyAV was built without the encoder {coder.library}")
    context = av.CodecContext.create(coder.library, "w")
    context.height, context.width = pictures[0].shape
    context.pix_fmt, context.thread_count = "gray", 1
    context.framerate, context.time_base = Fraction(25), Fraction(1, 25)
    # the QP is that of P frames
    words = f"qp={qp + offset}:ipratio={2.0 ** (offset / 6.0):.4f}:keyint=250:{coder.parameters}"
    context.options = {"preset": coder.preset, f"{coder.library[3:]}-params": words}
    try:
        context.open()
        packets = []
        for number, picture in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="gray")
            frame.pts = number
            packets += context.encode(frame)
        packets += context.encode(None)
    except (av.FFmpegError, ValueError) as err:
        raise ConfigError(f"{coder.name} does not code pictures of this size") from err
    for packet in packets:
        yield without_overhead(bytes(packet), coder.decoder)


def decode_frames(stream: Sequence[bytes], coder: VideoCoder) -> list[Picture]:
    """Decode the luma samples of frames as coded, independent of the range that the stream declares."""
    context = av.CodecContext.create(coder.decoder, "r")
    context.thread_count = 1
    frames = [frame for part in stream for frame in context.decode(av.Packet(part))]
    pictures = []
    for frame in (*frames, *context.decode(None)):
        plane = frame.planes[0]
        rows = np.frombuffer(bytes(plane), np.uint8).reshape(-1, plane.line_size)
        pictures.append(np.ascontiguousarray(rows[: plane.height, : plane.width]))
    return pictures


def baselines_of(array: CameraArray, labels: DisparityLabels) -> list[Baseline]:
    """Return all baselines that can code the two views of an array."""
    views = views_of_array(array, gray=True)
    first, second = views.pictures
    baselines: list[Baseline] = []
    for matcher, match in MATCHERS.items():
        try:
            disparity = match(array, labels)
        except ConfigError:
            continue
        for coder in PICTURE_CODERS:
            name = f"{matcher} and {coder.name}"
            baselines.append(PictureAndDepth(name, views, disparity, labels, coder))
    baselines.append(TwoPictures("two-view AVIF", (first, second), AVIF))
    for video in (X264, X265):
        baselines.append(PredictedFrame(f"P frame of {video.name}", (first, second), video))
    return baselines
