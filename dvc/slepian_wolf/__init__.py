"""Slepian-Wolf coding of bit planes: turbo codes and Cascade; usable on its own."""

from dvc.slepian_wolf.checks import CRC_BITS, crc, crc_words, joint_check
from dvc.slepian_wolf.coders import plane_coder
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
