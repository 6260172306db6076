"""From a video to the folder that holds its map."""

from collections.abc import Callable
from pathlib import Path

from dvc.errors import ConfigError
from dvc.files import atomic_folder
from dvc.video import open_video
from dvc.video.readers import FrameLookup
from sfm.mapping.scene_map import SceneMap


def map_to_folder(
    path: str, folder: str | Path, mapper: str, report: Callable[[str], None] | None = None
) -> SceneMap:
    """Map a video that can be read several times, and write all that is known of its scene."""
    from sfm.mapping.sequence import map_video
    from sfm.output.scene_folder import write_scene

    with open_video(path) as reader:
        info = reader.info
    if info.live:
        raise ConfigError(f"{path} can be read only once: a map needs a file or a folder")
    scene = map_video(path, mapper=mapper, report=report)
    with atomic_folder(folder) as target, FrameLookup(path) as frame:
        write_scene(target, scene, frame, info.frame_rate, Path(path).name)
    return scene
