"""Methods that `--side-information` and the configuration may name."""

from collections.abc import Callable
from functools import partial

from decoder.side_information.block_motion import BlockMotionInterpolation
from decoder.side_information.mesh import MeshInterpolator
from decoder.side_information.protocol import SceneInterpolatorType, SideInformationMethod
from decoder.side_information.scene_interpolators import (
    AveragedDepthInterpolator,
    BlockInterpolator,
    FusedInterpolator,
)
from decoder.side_information.tracked_scene import TrackedSceneInterpolation
from decoder.side_information.untracked_scene import SceneInterpolation
from dvc.config import CodecConfig
from dvc.extensions import SIDE_INFORMATION, Registry, maker

Method = Callable[[CodecConfig], SideInformationMethod]
INTERPOLATORS: dict[str, SceneInterpolatorType] = {
    AveragedDepthInterpolator.name: AveragedDepthInterpolator,
    BlockInterpolator.name: BlockInterpolator,
    MeshInterpolator.name: MeshInterpolator,
    FusedInterpolator.name: FusedInterpolator,
}
"""Models of the motion between key frames from a scene, by the name of the method."""


def _block_motion(config: CodecConfig) -> SideInformationMethod:
    del config
    return BlockMotionInterpolation()


def _scene(method: str, config: CodecConfig) -> SideInformationMethod:
    interpolator = INTERPOLATORS[method]
    if interpolator is FusedInterpolator and config.codec == "2d":
        return _block_motion(config)  # nothing to fuse it with
    if config.tracks.kind == "none":
        return SceneInterpolation(interpolator, config)
    return TrackedSceneInterpolation(interpolator, config)


METHODS: Registry[Method] = Registry(
    SIDE_INFORMATION,
    {BlockMotionInterpolation.name: _block_motion, **{name: partial(_scene, name) for name in INTERPOLATORS}},
    partial(maker, SIDE_INFORMATION),
)
"""Factories of the methods, from the configuration, by the name in it."""
