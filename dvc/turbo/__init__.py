"""Turbo codes for Slepian-Wolf coding of bit planes; usable on their own."""

from dvc.turbo.codes import TurboCode, choose_code, family
from dvc.turbo.crc import crc, crc_words
from dvc.turbo.decoder import TurboDecoder
from dvc.turbo.encoder import encode_planes, encode_words
from dvc.turbo.requests import KINDS, Answer, Kind, ParityRequest, drive
from dvc.turbo.slepian_wolf import PlaneResult, SlepianWolfSettings, decode_plane

__all__ = [
    "KINDS",
    "Answer",
    "Kind",
    "ParityRequest",
    "PlaneResult",
    "SlepianWolfSettings",
    "TurboCode",
    "TurboDecoder",
    "choose_code",
    "crc",
    "crc_words",
    "decode_plane",
    "drive",
    "encode_planes",
    "encode_words",
    "family",
]
