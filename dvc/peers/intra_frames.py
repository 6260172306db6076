"""An intra frame of x265 as a coder of gray pictures; the stream alone counts, without messages."""

from dataclasses import replace

from dvc.imagecodec.colour import Picture
from dvc.peers.picture_coders import PictureCoder
from dvc.peers.two_views import X265, decode_frames, encode_frames

HIGHEST_QP = 51
_CODER = replace(X265, preset="veryslow")


def _encode(picture: Picture, level: int) -> bytes:
    """Code one frame; QPs fall with the level."""
    return b"".join(encode_frames((picture,), _CODER, HIGHEST_QP - level, 0))


def _decode(stream: bytes) -> Picture:
    (picture,) = decode_frames([stream], _CODER)
    return picture


X265_INTRA = PictureCoder("x265 intra", HIGHEST_QP + 1, _encode, _decode)
