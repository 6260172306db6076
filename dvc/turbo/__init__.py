"""Turbo codes for Slepian-Wolf coding of bit planes; usable on their own."""

from dvc.turbo.codes import TurboCode, choose_code, family
from dvc.turbo.crc import crc
from dvc.turbo.decoder import TurboDecoder
from dvc.turbo.encoder import encode_planes
from dvc.turbo.slepian_wolf import PlaneRequest, PlaneResult, SlepianWolfSettings, decode_plane

__all__ = [
    "PlaneRequest",
    "PlaneResult",
    "SlepianWolfSettings",
    "TurboCode",
    "TurboDecoder",
    "choose_code",
    "crc",
    "decode_plane",
    "encode_planes",
    "family",
]
