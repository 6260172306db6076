"""Prediction of Wyner-Ziv frames at the decoder: one file a method, found by name."""

from collections.abc import Callable

from decoder.side_information.block_motion import BlockMotionInterpolation
from decoder.side_information.protocol import SideInformationMethod
from dvc.config import CodecConfig

METHODS: dict[str, Callable[[CodecConfig], SideInformationMethod]] = {
    BlockMotionInterpolation.name: lambda config: BlockMotionInterpolation(config.side_information),
}
"""How to build each method from the configuration, by the name that the configuration uses."""
