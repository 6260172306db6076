"""Groups of pictures (GOPs): Wyner-Ziv frames, the closing key frame, time stamps; writing of streams."""

from dataclasses import dataclass
from fractions import Fraction
from itertools import accumulate, pairwise
from typing import BinaryIO, NamedTuple, Self

from dvc.bits import decode_bytes, decode_varint, encode_varint
from dvc.config import MAX_GOP_LENGTH, CodecConfig, VideoConfig
from dvc.errors import BitstreamError
from dvc.limits import MAX_TICKS_PER_SECOND
from dvc.stream.records import (
    FORMAT_VERSION,
    MAGIC,
    MAX_GOPS,
    MAX_RECORD_BYTES,
    Form,
    IndexEntry,
    RecordType,
    StreamIndex,
    encode_configuration,
    encode_end,
    frame_record,
    framed_size,
)

MAX_DEVIATION_TICKS = 2**33 - 1
DIGEST_BYTES = 4
_DEVIATIONS = 8 * MAX_GOP_LENGTH  # added to the first field, which is less than that otherwise


class Deviations(NamedTuple):
    """Deviations from the constant frame rate of the frames of a group of pictures, not all of them 0."""

    ticks_per_second: int
    ticks: tuple[int, ...]  # deviation of each frame, in display order

    def of_last(self) -> "Deviations | None":
        """Return the deviation of the last frame, None if it is 0."""
        return Deviations(self.ticks_per_second, self.ticks[-1:]) if self.ticks[-1] else None


def encode_deviations(deviations: Deviations) -> bytes:
    """Write the ticks of a second, the first deviation, and differences; inverse of `decode_deviations`."""
    differences = (after - before for before, after in pairwise((0, *deviations.ticks)))
    numbers = (2 * value if value >= 0 else -2 * value - 1 for value in differences)
    return b"".join(map(encode_varint, (deviations.ticks_per_second, *numbers)))


def decode_deviations(payload: bytes, position: int, num_frames: int) -> tuple[Deviations, int]:
    """Read the deviations of a number of frames; inverse of `encode_deviations`."""
    ticks_per_second, position = decode_varint(payload, position)
    if not 1 <= ticks_per_second <= MAX_TICKS_PER_SECOND:
        raise BitstreamError(f"{ticks_per_second} ticks a second, 1 to {MAX_TICKS_PER_SECOND} are allowed")
    differences = []
    for _ in range(num_frames):
        number, position = decode_varint(payload, position)
        differences.append(-(number + 1 >> 1) if number & 1 else number >> 1)
    ticks = tuple(accumulate(differences))
    if not any(ticks):
        raise BitstreamError("time stamps are announced, but equal those of the constant frame rate")
    if max(map(abs, ticks)) > MAX_DEVIATION_TICKS:
        raise BitstreamError(f"a time stamp is more than {MAX_DEVIATION_TICKS} ticks off")
    return Deviations(ticks_per_second, ticks), position


def frame_times_s(
    video: VideoConfig, first_index: int, num_frames: int, deviations: Deviations | None
) -> list[Fraction]:
    """Return the display times of frames."""
    interval_s = Fraction(video.frame_rate_den, video.frame_rate_num)
    indices = range(first_index, first_index + num_frames)
    if deviations is None:
        return [index * interval_s for index in indices]
    ticks_per_second, ticks = deviations
    return [
        Fraction(planned_tick(index, interval_s * ticks_per_second) + late, ticks_per_second)
        for index, late in zip(indices, ticks, strict=True)
    ]


def planned_tick(index: int, ticks_per_frame: Fraction) -> int:
    """Return the tick closest to a frame at the constant frame rate; deviations are relative to it."""
    ticks, num_frames = ticks_per_frame.as_integer_ratio()
    return (2 * index * ticks + num_frames) // (2 * num_frames)


def check_times(times_s: list[Fraction], before_s: Fraction | None) -> None:
    """Refuse display times that do not increase."""
    times_s = times_s if before_s is None else [before_s, *times_s]
    if any(after <= before for before, after in pairwise(times_s)):
        raise BitstreamError("a time stamp is not later than that of the previous frame")


def following(before: Deviations | None, deviations: Deviations | None, num_frames: int) -> Deviations | None:
    """Return the deviations of frames of a segment, relative to the segment before."""
    if before is None:
        return deviations
    ticks_per_second, ticks = deviations or Deviations(before.ticks_per_second, (0,) * num_frames)
    delay = round(Fraction(before.ticks[-1] * ticks_per_second, before.ticks_per_second))
    ticks = tuple(min(max(value + delay, -MAX_DEVIATION_TICKS), MAX_DEVIATION_TICKS) for value in ticks)
    return Deviations(ticks_per_second, ticks) if any(ticks) else None


@dataclass(frozen=True)
class GopRecord:
    """Data that one group of pictures adds to a stream."""

    num_frames: int  # Wyner-Ziv frames and the key frame that closes the group; 1 for the first key frame
    key: bytes  # the key frame
    predicted: bool = False  # whether the key frame is predicted from earlier ones; else it is an IDR picture
    tracks: bytes = b""  # point tracks; empty in codecs without geometry
    wyner_ziv: tuple[bytes, ...] = ()  # payload of each Wyner-Ziv frame, in order of display
    digest: int | None = None  # CRC-32 of the decoded Wyner-Ziv frames; punctured form only
    deviations: Deviations | None = None  # only if frames are not at the constant frame rate

    def __post_init__(self) -> None:
        if not 1 <= self.num_frames <= MAX_GOP_LENGTH:
            raise ValueError(f"`num_frames` must be from 1 to {MAX_GOP_LENGTH}, got {self.num_frames}")
        if len(self.wyner_ziv) != self.num_frames - 1:
            raise ValueError(
                f"`wyner_ziv` must have {self.num_frames - 1} payloads, got {len(self.wyner_ziv)}"
            )
        if self.deviations is not None and len(self.deviations.ticks) != self.num_frames:
            raise ValueError(
                f"`deviations` must be of {self.num_frames} frames, got {len(self.deviations.ticks)}"
            )


@dataclass(frozen=True)
class GopBits:
    """Bits of a GOP record by their use; they add up to all bits."""

    # type, lengths and CRC-32 of the record, number of frames, length of the tracks, digest, time stamps
    header: int
    key: int  # payload of the key frame
    tracks: int  # payload of the tracks
    wyner_ziv: tuple[int, ...]  # payload of each Wyner-Ziv frame
    wyner_ziv_header: tuple[int, ...]  # length of each of these payloads

    @property
    def total(self) -> int:
        """Size of the record in bits."""
        return self.header + self.key + self.tracks + sum(self.wyner_ziv) + sum(self.wyner_ziv_header)


def encode_gop(record: GopRecord) -> bytes:
    """Write the payload of a GOP record; inverse of `decode_gop`.

    The first integer is four times the number of frames, plus two if the key frame is predicted, plus one if
    tracks follow, plus 2048 if time stamps follow; it also gives the number of Wyner-Ziv payloads. The key
    frame is the rest, so that it needs no length.

    Parameters
    ----------
    record : GopRecord
        The group of pictures.

    Returns
    -------
    bytes
        The payload.
    """
    first = record.num_frames << 2 | record.predicted << 1 | bool(record.tracks)
    first += _DEVIATIONS * (record.deviations is not None)
    parts = [encode_varint(first)]
    if record.digest is not None:
        parts.append(record.digest.to_bytes(DIGEST_BYTES, "little"))
    if record.deviations is not None:
        parts.append(encode_deviations(record.deviations))
    if record.tracks:
        parts += [encode_varint(len(record.tracks)), record.tracks]
    for payload in record.wyner_ziv:
        parts += [encode_varint(len(payload)), payload]
    parts.append(record.key)
    return b"".join(parts)


def decode_head(payload: bytes) -> tuple[int, bool, bool, bool, int]:
    """Return number of frames; flags of tracks, a predicted key frame, time stamps; position after these."""
    value, position = decode_varint(payload, 0)
    has_deviations = value >= _DEVIATIONS
    value -= _DEVIATIONS * has_deviations
    num_frames = value >> 2
    if not 1 <= num_frames <= MAX_GOP_LENGTH:
        raise BitstreamError(f"{num_frames} frames, from 1 to {MAX_GOP_LENGTH} are allowed")
    return num_frames, bool(value & 1), bool(value & 2), has_deviations, position


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
    num_frames, has_tracks, predicted, has_deviations, position = decode_head(payload)
    tracks, digest, deviations = b"", None, None
    if with_digest and num_frames > 1:
        if len(payload) < position + DIGEST_BYTES:
            raise BitstreamError("the record ends within the digest")
        digest = int.from_bytes(payload[position : position + DIGEST_BYTES], "little")
        position += DIGEST_BYTES
    if has_deviations:
        deviations, position = decode_deviations(payload, position, num_frames)
    if has_tracks:
        tracks, position = decode_bytes(payload, position)
        if not tracks:
            raise BitstreamError("tracks are announced, but empty")
    wyner_ziv = []
    for _ in range(num_frames - 1):
        frame, position = decode_bytes(payload, position)
        wyner_ziv.append(frame)
    return GopRecord(num_frames, payload[position:], predicted, tracks, tuple(wyner_ziv), digest, deviations)


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
    key, tracks = 8 * len(record.key), 8 * len(record.tracks)
    total = 8 * framed_size(len(encode_gop(record)))
    header = total - key - tracks - sum(payloads) - sum(prefixes)
    return GopBits(header, key, tracks, payloads, prefixes)


class StreamWriter:
    """Writes a stream; the counterpart of `StreamReader`.

    As a context manager it writes the end record if the block succeeds. The file stays open.

    Parameters
    ----------
    file : binary file
        File to write to; it need not be seekable.
    config : CodecConfig
        The codec configuration.
    form : Form or str
        ``"buffered"``, ``"punctured"`` or ``"no-feedback"``.
    """

    def __init__(self, file: BinaryIO, config: CodecConfig, form: Form | str) -> None:
        self.config = config
        self.form = Form(form)
        self.num_bytes = 0
        self.num_frames = 0
        self._file = file
        self._entries: list[IndexEntry] = []
        self._closed = False
        head = MAGIC + bytes([FORMAT_VERSION])
        self._write(head + frame_record(RecordType.CONFIGURATION, encode_configuration(config, self.form)))

    def _write(self, data: bytes) -> None:
        self._file.write(data)
        self.num_bytes += len(data)

    def write_gop(self, record: GopRecord) -> None:
        """Append the next group of pictures in order of display; the first adds one frame, a key frame.

        One that does not fit the configuration is a `ValueError`, one that is too large a `BitstreamError`.
        """
        if self._closed:
            raise ValueError("the stream is closed")
        limit = self.config.gop.length if self._entries else 1
        if record.num_frames > limit:
            raise ValueError(f"`record` must add {limit} frames or fewer, got {record.num_frames}")
        has_digest = self.form is Form.PUNCTURED and bool(record.wyner_ziv)
        if (record.digest is not None) != has_digest:
            raise ValueError("`record` must have a digest in punctured streams if it has Wyner-Ziv frames")
        if len(self._entries) == MAX_GOPS:
            raise BitstreamError(f"a stream has at most {MAX_GOPS} groups of pictures")
        payload = encode_gop(record)
        if len(payload) > MAX_RECORD_BYTES:
            raise BitstreamError(
                f"group of pictures {len(self._entries)} takes {len(payload)} bytes, "
                f"at most {MAX_RECORD_BYTES} fit; use a shorter GOP or smaller frames"
            )
        framed = frame_record(RecordType.GOP, payload)
        self._entries.append(IndexEntry(self.num_bytes, len(framed), record.num_frames))
        self._write(framed)
        self.num_frames += record.num_frames

    def close(self) -> None:
        """Write the end record; the file stays open. Does nothing the second time."""
        if self._closed:
            return
        self._closed = True
        index = StreamIndex(self.num_frames, tuple(self._entries))
        self._write(frame_record(RecordType.END, encode_end(index, self.form)))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.close()
