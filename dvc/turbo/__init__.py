"""Slepian-Wolf coding of bit planes, by turbo codes or by parities of ranges; usable on its own."""

from dvc.turbo.cascade.coupling import NeighbourCoupling
from dvc.turbo.cascade.frame import joint_check
from dvc.turbo.codes import CASCADE, TurboCode, choose_code, family, num_codes
from dvc.turbo.crc import CRC_BITS, crc, crc_words
from dvc.turbo.decoder import TurboDecoder
from dvc.turbo.encoder import encode_planes, encode_words
from dvc.turbo.families import ParityEncoder, PlaneDecoder, parity_encoders, plane_decoder
from dvc.turbo.requests import KINDS, Answer, Kind, ParityRequest, Place, RequestTable, ask, drive, together
from dvc.turbo.results import FrameCheck, PlaneCost, PlaneResult
from dvc.turbo.slepian_wolf import SlepianWolfSettings, decode_plane

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
