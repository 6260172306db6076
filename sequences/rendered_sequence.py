"""Rendered scenes as videos, read frame by frame or written to files, and pictures of a camera array."""

import json
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import cv2

from dvc.errors import ConfigError
from dvc.files import atomic_folder, atomic_output, same_file
from dvc.picture_files import write_pfm
from dvc.video import VideoInfo, VideoReader, create_video
from dvc.video.frames import check_size
from sequences.rendered_scenes import RenderedFrame, render_frame, render_picture, scene
from sequences.scene_layouts import POSITIONS, VIDEO_SCENES


class RenderedSequence(VideoReader):
    """Frames of a rendered scene, a `dvc.video.VideoReader`; the scene is built for the first frame.

    Parameters
    ----------
    name : str
        Scene.
    width, height : int
        Size in pixels.
    start : int
        First frame.
    num_frames : int, optional
        Length; the usual one of the scene if None.
    seed : int
        Seed of the scene and of the sensor noise.
    noise_sigma : float
        Sensor noise in luma levels.
    jobs : int
        Number of frames rendered at the same time; the result does not depend on it.

    Raises
    ------
    ConfigError
        If the scene does not exist, or a number is out of range.
    VideoError
        If frames cannot have that size.
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
    ) -> None:
        if name not in VIDEO_SCENES:
            raise ConfigError(f"no scene is called {name!r}; the scenes are {', '.join(VIDEO_SCENES)}")
        description = VIDEO_SCENES[name]
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
        self.noise_sigma = noise_sigma
        notices = ("rendered, BT.601 limited range",)
        info = VideoInfo(width, height, description.frame_rate, count, notices)
        self._rendered = self._render()
        super().__init__(info, (rendered.frame for rendered in self._rendered), lambda: None)

    def rendered(self) -> Iterator[RenderedFrame]:
        """Yield the frames not read yet with depth and camera; at most `jobs` are rendered at once."""
        return self._rendered

    def close(self) -> None:
        """Stop rendering; a second call has no effect."""
        super().close()
        self._rendered = iter(())

    def _render(self) -> Iterator[RenderedFrame]:
        built = scene(self.name, self.seed)

        def make(index: int) -> RenderedFrame:
            return render_frame(built, index, *self.info.size, noise_sigma=self.noise_sigma)

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
    """Write a sequence as a video, optionally with cameras and depth maps: all files or none.

    Parameters
    ----------
    sequence : RenderedSequence
        Frames to render.
    video : str or Path
        Video file; its suffix selects the format.
    cameras : str or Path, optional
        JSON file of ``K`` and ``cam_from_world`` per frame.
    depth : str or Path, optional
        Folder, new or empty, for a PFM file of metres per frame (inf for the sky).
    progress : callable, optional
        Function that is called with the number of frames just rendered.

    Raises
    ------
    DvcError
        If an output cannot be written.
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
            document = {
                "scene": sequence.name,
                "seed": sequence.seed,
                "frame_rate": str(info.frame_rate),
                "pixel_centre": "first pixel at (0, 0); x is the column, y the row",
                "units": "metres and pixels; camera axes x right, y down, z forward",
                "frames": views,
            }
            camera_file.write_text(json.dumps(document, indent=1) + "\n")


def write_array(
    name: str,
    folder: str | Path,
    width: int = 320,
    height: int = 240,
    *,
    seed: int = 0,
    progress: Callable[[int], None] = lambda _: None,
) -> None:
    """Write all views of a camera array: pictures, depth, `cameras.json` and `views.csv`."""
    cameras, rows = [], ["file,m,n"]
    with atomic_folder(folder) as made:
        for index, (m, n) in enumerate(POSITIONS):
            image, depth, camera = render_picture(scene(name, seed), index, width, height)
            stem, pose = f"toy-{m}-{n}", camera.cam_from_world
            (made / f"{stem}.png").write_bytes(cv2.imencode(".png", image[:, :, ::-1])[1].tobytes())
            write_pfm(made / f"depth-{stem}.pfm", depth)
            entry = {"file": f"{stem}.png", "K": camera.K.tolist()}
            cameras.append({**entry, "R": pose[:, :3].tolist(), "t": pose[:, 3].tolist()})
            rows.append(f"{stem}.png,{m},{n}")
            progress(1)
        (made / "cameras.json").write_text(json.dumps(cameras, indent=1) + "\n", encoding="utf-8")
        (made / "views.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
