"""Slepian-Wolf coding of bit planes: turbo codes and Cascade; usable on its own."""

from dvc.config import CascadeConfig, CodecConfig, TurboConfig
from dvc.extensions import PLANE_CODERS, make
from dvc.slepian_wolf.cascade.cascade_coder import CascadeCoder
from dvc.slepian_wolf.checks import CRC_BITS, crc, crc_words, joint_check
from dvc.slepian_wolf.coupling import NeighbourCoupling
from dvc.slepian_wolf.plane_protocol import FrameCheck, PlaneCoder, PlaneCost, PlaneDecoder, PlaneResult
from dvc.slepian_wolf.requests import (
    KINDS,
    MAX_RUN_BITS,
    Answer,
    Kind,
    ParityRequest,
    Part,
    Place,
    RequestTable,
    Round,
    Run,
    ask,
    beginning,
    drive,
    side_by_side,
)
from dvc.slepian_wolf.turbo.turbo_coder import TurboCoder

__all__ = [
    "CRC_BITS",
    "KINDS",
    "MAX_RUN_BITS",
    "Answer",
    "FrameCheck",
    "Kind",
    "NeighbourCoupling",
    "ParityRequest",
    "Part",
    "Place",
    "PlaneCoder",
    "PlaneCost",
    "PlaneDecoder",
    "PlaneResult",
    "RequestTable",
    "Round",
    "Run",
    "ask",
    "beginning",
    "crc",
    "crc_words",
    "drive",
    "joint_check",
    "plane_coder",
    "side_by_side",
]


def plane_coder(config: CodecConfig) -> PlaneCoder:
    """Return the coder of planes of a configuration.

    Parameters
    ----------
    config : CodecConfig
        Its section `coder` holds the settings.

    Returns
    -------
    PlaneCoder
        The coder.
    """
    if isinstance(config.coder, CascadeConfig):
        return CascadeCoder(config.coder, config.seed)
    if isinstance(config.coder, TurboConfig):
        return TurboCoder(config.seed)
    coder: PlaneCoder = make(PLANE_CODERS, config.coder.name, config.seed)
    return coder
