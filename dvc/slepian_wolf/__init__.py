"""Slepian-Wolf coding of bit planes, by turbo codes or by parities of ranges; usable on its own."""

from dvc.slepian_wolf.coupling import NeighbourCoupling
from dvc.slepian_wolf.crc import CRC_BITS, crc, crc_words, joint_check
from dvc.slepian_wolf.families import (
    CASCADE,
    ParityEncoder,
    PlaneDecoder,
    num_codes,
    parity_encoders,
    plane_decoder,
)
from dvc.slepian_wolf.requests import (
    KINDS,
    Answer,
    Kind,
    ParityRequest,
    Place,
    RequestTable,
    ask,
    drive,
    together,
)
from dvc.slepian_wolf.results import FrameCheck, PlaneCost, PlaneResult
from dvc.slepian_wolf.turbo.codes import TurboCode, choose_code, family
from dvc.slepian_wolf.turbo.decoder import TurboDecoder
from dvc.slepian_wolf.turbo.encoder import encode_planes, encode_words
from dvc.slepian_wolf.turbo.plane import SlepianWolfSettings, decode_plane

__all__ = [
    "CASCADE",
    "CRC_BITS",
    "KINDS",
    "Answer",
    "FrameCheck",
    "Kind",
    "NeighbourCoupling",
    "ParityEncoder",
    "ParityRequest",
    "Place",
    "PlaneCost",
    "PlaneDecoder",
    "PlaneResult",
    "RequestTable",
    "SlepianWolfSettings",
    "TurboCode",
    "TurboDecoder",
    "ask",
    "choose_code",
    "crc",
    "crc_words",
    "decode_plane",
    "drive",
    "encode_planes",
    "encode_words",
    "family",
    "joint_check",
    "num_codes",
    "parity_encoders",
    "plane_decoder",
    "together",
]
