"""Prediction of Wyner-Ziv frames at the decoder: one file a method, found by name."""

from collections.abc import Callable
from functools import partial

from decoder.side_information.block_motion import BlockMotionInterpolation
from decoder.side_information.protocol import SideInformationMethod
from decoder.side_information.scene import FUSED, INTERPOLATORS, SceneInterpolation
from decoder.side_information.tracked_scene import TrackedSceneInterpolation
from dvc.config import CodecConfig


def _scene(name: str, config: CodecConfig) -> SideInformationMethod:
    if name == FUSED and config.codec == "2d":
        return BlockMotionInterpolation(config.side_information)
    if config.tracks.kind == "none":
        return SceneInterpolation(name, config)
    return TrackedSceneInterpolation(name, config)


METHODS: dict[str, Callable[[CodecConfig], SideInformationMethod]] = {
    BlockMotionInterpolation.name: lambda config: BlockMotionInterpolation(config.side_information),
    **{name: partial(_scene, name) for name in INTERPOLATORS},
}
"""How to build each method from the configuration, by the name that the configuration uses."""
