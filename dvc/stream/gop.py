"""Syntax of a group of pictures (GOP): Wyner-Ziv frames and mostly a key frame that ends it."""

from dataclasses import dataclass
from typing import NamedTuple

from dvc.bits import decode_bytes, decode_varint, encode_varint
from dvc.config import MAX_GOP_LENGTH
from dvc.errors import BitstreamError
from dvc.stream.deviations import Deviations, decode_deviations, encode_deviations
from dvc.stream.records import framed_size

DIGEST_BYTES = 4
_WITHOUT_KEY = 4 * MAX_GOP_LENGTH  # added to the first field, of which all before is less
_LONG_TERM = 2 * _WITHOUT_KEY  # and this
_DEVIATIONS = 2 * _LONG_TERM  # and this


class LongTermReference(NamedTuple):
    """An earlier key frame that P-type frames of a group are predicted from, too."""

    groups_back: int  # how many groups before this one it ended one; at least 1
    matches: bytes  # where the tracks of the group are in it, as `dvc.tracks.encode_matches` writes it


@dataclass(frozen=True)
class GopRecord:
    """What one group of pictures adds to a stream."""

    num_frames: int  # its Wyner-Ziv frames and the key frame that closes it; 1 for the first key frame
    key: bytes  # the key frame; empty where all frames are Wyner-Ziv frames
    tracks: bytes = b""  # point tracks; empty in codecs without geometry
    wyner_ziv: tuple[bytes, ...] = ()  # one payload for each Wyner-Ziv frame, in order of display
    digest: int | None = None  # CRC-32 of the decoded Wyner-Ziv frames; punctured form only
    long_term: LongTermReference | None = None  # only where no key frame ends the group
    deviations: Deviations | None = None  # only where frames are not at the constant frame rate

    def __post_init__(self) -> None:
        if not 1 <= self.num_frames <= MAX_GOP_LENGTH:
            raise ValueError(f"`num_frames` must be from 1 to {MAX_GOP_LENGTH}, got {self.num_frames}")
        if len(self.wyner_ziv) != self.num_frames - 1 and not self.without_key:
            raise ValueError(
                f"`wyner_ziv` must have {self.num_frames - 1} payloads, got {len(self.wyner_ziv)}"
            )
        if self.long_term is not None and not self.without_key:
            raise ValueError("`long_term` is for groups that no key frame ends")
        if self.deviations is not None and len(self.deviations.ticks) != self.num_frames:
            raise ValueError(
                f"`deviations` must be of {self.num_frames} frames, got {len(self.deviations.ticks)}"
            )

    @property
    def without_key(self) -> bool:
        """Whether its last frame is a Wyner-Ziv frame, too."""
        return len(self.wyner_ziv) == self.num_frames and not self.key

    @property
    def tracks_bytes(self) -> int:
        """Size of the tracks, and of their matches in the long-term reference."""
        return len(self.tracks) + (len(self.long_term.matches) if self.long_term else 0)


@dataclass(frozen=True)
class GopBits:
    """Where the bits of a GOP record go; all of them are somewhere."""

    # type, lengths and CRC-32 of the record, number of frames, lengths of the tracks, digest, time stamps,
    # which key frame is the long-term reference
    header: int
    key: int  # payload of the key frame
    tracks: int  # payload of the tracks, and of their matches in the long-term reference
    wyner_ziv: tuple[int, ...]  # payload of each Wyner-Ziv frame
    wyner_ziv_header: tuple[int, ...]  # length of each of these payloads

    @property
    def total(self) -> int:
        """Size of the record in bits."""
        return self.header + self.key + self.tracks + sum(self.wyner_ziv) + sum(self.wyner_ziv_header)


def encode_gop(record: GopRecord) -> bytes:
    """Write the payload of a GOP record; inverse of `decode_gop`.

    The first integer is twice the number of frames, plus one if there are tracks, plus 1024 if no key frame
    ends the group, plus 2048 if it has a long-term reference, plus 4096 if it has time stamps of its own; it
    says how many Wyner-Ziv payloads there are. The key frame is what is left, so that it needs no length.

    Parameters
    ----------
    record : GopRecord
        The group of pictures.

    Returns
    -------
    bytes
        The payload.
    """
    first = record.num_frames << 1 | bool(record.tracks)
    first += _WITHOUT_KEY * record.without_key + _LONG_TERM * (record.long_term is not None)
    first += _DEVIATIONS * (record.deviations is not None)
    parts = [encode_varint(first)]
    if record.digest is not None:
        parts.append(record.digest.to_bytes(DIGEST_BYTES, "little"))
    if record.deviations is not None:
        parts.append(encode_deviations(record.deviations))
    if record.tracks:
        parts += [encode_varint(len(record.tracks)), record.tracks]
    if record.long_term is not None:
        groups_back, matches = record.long_term
        parts += [encode_varint(groups_back), encode_varint(len(matches)), matches]
    for payload in record.wyner_ziv:
        parts += [encode_varint(len(payload)), payload]
    parts.append(record.key)
    return b"".join(parts)


class GopHead(NamedTuple):
    """First field of a GOP payload."""

    num_frames: int  # that the GOP adds
    has_tracks: bool  # whether tracks follow
    without_key: bool  # whether its last frame is a Wyner-Ziv frame
    has_long_term: bool  # whether it names an earlier key frame
    has_deviations: bool  # whether its frames have time stamps of their own
    position: int  # of the byte after the field


def decode_head(payload: bytes, position: int = 0) -> GopHead:
    """Read the first field of a GOP payload."""
    value, position = decode_varint(payload, position)
    has_deviations = value >= _DEVIATIONS
    value -= _DEVIATIONS * has_deviations
    has_long_term = value >= _LONG_TERM
    value -= _LONG_TERM * has_long_term
    without_key = value >= _WITHOUT_KEY
    num_frames = (value - _WITHOUT_KEY * without_key) >> 1
    if not 1 <= num_frames <= MAX_GOP_LENGTH:
        raise BitstreamError(f"{num_frames} frames, from 1 to {MAX_GOP_LENGTH} are allowed")
    if has_long_term and not without_key:
        raise BitstreamError("a long-term reference of a group that a key frame ends")
    return GopHead(num_frames, bool(value & 1), without_key, has_long_term, has_deviations, position)


def decode_gop(payload: bytes, with_digest: bool = False) -> GopRecord:
    """Read the payload of a GOP record; inverse of `encode_gop`.

    Parameters
    ----------
    payload : bytes
        The payload.
    with_digest : bool, optional
        Whether groups with Wyner-Ziv frames have a digest of them.

    Returns
    -------
    GopRecord
        The group of pictures.

    Raises
    ------
    BitstreamError
        If a length does not fit.
    """
    num_frames, has_tracks, without_key, has_long_term, has_deviations, position = decode_head(payload)
    tracks, long_term, digest, num_payloads = b"", None, None, num_frames - (not without_key)
    deviations = None
    if with_digest and num_payloads > 0:
        if len(payload) < position + DIGEST_BYTES:
            raise BitstreamError("the record ends within the digest")
        digest = int.from_bytes(payload[position : position + DIGEST_BYTES], "little")
        position += DIGEST_BYTES
    if has_deviations:
        deviations, position = decode_deviations(payload, position, num_frames)
    if has_tracks:
        tracks, position = decode_bytes(payload, position, len(payload))
        if not tracks:
            raise BitstreamError("tracks are announced, but empty")
    if has_long_term:
        if not has_tracks:
            raise BitstreamError("a long-term reference without tracks")
        groups_back, position = decode_varint(payload, position)
        matches, position = decode_bytes(payload, position, len(payload))
        long_term = LongTermReference(groups_back, matches)
    wyner_ziv = []
    for _ in range(num_payloads):
        frame, position = decode_bytes(payload, position, len(payload))
        wyner_ziv.append(frame)
    if without_key and position < len(payload):
        raise BitstreamError(f"{len(payload) - position} bytes are left over in a group without key frame")
    return GopRecord(num_frames, payload[position:], tracks, tuple(wyner_ziv), digest, long_term, deviations)


def gop_bits(record: GopRecord) -> GopBits:
    """Account for the bits of a GOP record in a stream.

    Parameters
    ----------
    record : GopRecord
        The group of pictures.

    Returns
    -------
    GopBits
        Bits per part.
    """
    prefixes = tuple(8 * len(encode_varint(len(payload))) for payload in record.wyner_ziv)
    payloads = tuple(8 * len(payload) for payload in record.wyner_ziv)
    key, tracks = 8 * len(record.key), 8 * record.tracks_bytes
    total = 8 * framed_size(len(encode_gop(record)))
    header = total - key - tracks - sum(payloads) - sum(prefixes)
    return GopBits(header, key, tracks, payloads, prefixes)
