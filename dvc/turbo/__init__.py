"""Turbo codes for Slepian-Wolf coding of bit planes; usable on their own."""

from dvc.turbo.codes import TurboCode, choose_code, family
from dvc.turbo.crc import crc, crc_words
from dvc.turbo.decoder import TurboDecoder
from dvc.turbo.encoder import encode_planes, encode_words
from dvc.turbo.slepian_wolf import PlaneRequest, PlaneResult, SlepianWolfSettings, decode_plane

__all__ = [
    "PlaneRequest",
    "PlaneResult",
    "SlepianWolfSettings",
    "TurboCode",
    "TurboDecoder",
    "choose_code",
    "crc",
    "crc_words",
    "decode_plane",
    "encode_planes",
    "encode_words",
    "family",
]
