"""A rendered scene as a video: read frame by frame, or written to files with depth and cameras."""

import json
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

from dvc.errors import ConfigError
from dvc.files import Closing, atomic_folder, atomic_output, same_file
from dvc.pfm import write_pfm
from dvc.video import Frame, VideoInfo, create_video
from dvc.video.frames import check_size
from sequences.renderer import RenderedFrame, render_frame
from sequences.scenes import descriptions, scene


class RenderedSequence(Closing):
    """Frames of a rendered scene, a `dvc.video.VideoReader`; the scene is built when the first is asked for.

    Parameters
    ----------
    name : str
        Scene.
    width, height : int
        Size in pixels.
    start : int
        First frame.
    num_frames : int, optional
        Length; the scene's usual one if None.
    seed : int
        Seed of the scene and of the sensor noise.
    noise_sigma : float
        Sensor noise in luma levels.
    jobs : int
        Frames rendered at the same time; the result does not depend on it.
    detail : float
        Share of leaves and light directions, see `sequences.scenes.scene`.

    Raises
    ------
    ConfigError
        If there is no such scene, or a number is out of range.
    VideoError
        If the size is not one that frames may have.
    """

    def __init__(
        self,
        name: str,
        width: int = 352,
        height: int = 288,
        *,
        start: int = 0,
        num_frames: int | None = None,
        seed: int = 0,
        noise_sigma: float = 0.0,
        jobs: int = 1,
        detail: float = 1.0,
    ) -> None:
        if name not in descriptions():
            raise ConfigError(f"no scene is called {name!r}; there are {', '.join(descriptions())}")
        description = descriptions()[name]
        count = description.num_frames if num_frames is None else num_frames
        if count < 1 or start < 0 or seed < 0 or jobs < 1:
            raise ConfigError(
                "a sequence needs at least 1 frame and 1 job, and start and seed from 0; "
                f"got {count} frames, {jobs} jobs, start {start}, seed {seed}"
            )
        if not 0.0 <= noise_sigma < 128.0:
            raise ConfigError(f"noise must be in [0, 128) luma levels, got {noise_sigma:g}")
        check_size(width, height, name)
        self.name, self.start, self.num_frames, self.seed, self.jobs = name, start, count, seed, jobs
        self.noise_sigma, self.detail = noise_sigma, detail
        notices = ("rendered, BT.601 limited range",)
        self._info = VideoInfo(width, height, description.frame_rate, count, notices)
        self._frames: Iterator[RenderedFrame] | None = None

    @property
    def info(self) -> VideoInfo:
        """What is known of the video."""
        return self._info

    def rendered(self) -> Iterator[RenderedFrame]:
        """Yield the frames not read yet with depth and camera; at most `jobs` are in the making."""
        if self._frames is None:
            self._frames = self._render()
        return self._frames

    def __iter__(self) -> Iterator[Frame]:
        """Yield the pictures not read yet."""
        return (rendered.frame for rendered in self.rendered())

    def close(self) -> None:
        """Stop rendering; harmless when repeated."""
        self._frames = iter(())

    def _render(self) -> Iterator[RenderedFrame]:
        built = scene(self.name, self.seed, self.detail)

        def make(index: int) -> RenderedFrame:
            return render_frame(built, index, *self._info.size, noise_sigma=self.noise_sigma)

        indices = range(self.start, self.start + self.num_frames)
        if self.jobs == 1:
            yield from map(make, indices)
            return
        with ThreadPoolExecutor(self.jobs) as pool:
            waiting: deque[Future[RenderedFrame]] = deque()
            try:
                for index in indices:
                    waiting.append(pool.submit(make, index))
                    if len(waiting) == self.jobs:
                        yield waiting.popleft().result()
                while waiting:
                    yield waiting.popleft().result()
            finally:
                for future in waiting:
                    future.cancel()


def render(
    sequence: RenderedSequence,
    video: str | Path,
    *,
    cameras: str | Path | None = None,
    depth: str | Path | None = None,
    progress: Callable[[int], None] = lambda _: None,
) -> None:
    """Write a sequence as a video, and on demand its cameras and depth maps, complete or not at all.

    Parameters
    ----------
    sequence : RenderedSequence
        What to render.
    video : str or Path
        Video file; its suffix chooses the format.
    cameras : str or Path, optional
        JSON file of ``K`` and ``cam_from_world`` per frame.
    depth : str or Path, optional
        Folder, new or empty, for a PFM file of metres per frame (inf for the sky).
    progress : callable, optional
        Called with the number of frames just done.

    Raises
    ------
    DvcError
        If something cannot be written.
    """
    if cameras is not None and same_file(video, cameras):
        raise ConfigError(f"video and cameras cannot both be written to {video}")
    info = sequence.info
    views = []
    with ExitStack() as stack:
        camera_file = None if cameras is None else stack.enter_context(atomic_output(cameras))
        folder = None if depth is None else stack.enter_context(atomic_folder(depth))
        writer = stack.enter_context(create_video(video, info.size, info.frame_rate))
        for index, rendered in enumerate(sequence.rendered(), start=sequence.start):
            writer.write(rendered.frame)
            if folder is not None:
                write_pfm(folder / f"{index:04d}.pfm", rendered.depth)
            views.append({"index": index, **rendered.camera.to_dict()})
            progress(1)
        if camera_file is not None:
            camera_file.write_text(json.dumps(_camera_document(sequence, views), indent=1) + "\n")


def _camera_document(sequence: RenderedSequence, views: list[dict[str, object]]) -> dict[str, object]:
    return {
        "scene": sequence.name,
        "seed": sequence.seed,
        "frame_rate": str(sequence.info.frame_rate),
        "pixel_centre": "first pixel at (0, 0); x is the column, y the row",
        "units": "metres and pixels; camera axes x right, y down, z forward",
        "frames": views,
    }
