"""The decoder of figure 5.1: stream or connection in; decoded groups of pictures, and what they cost, out."""

from collections.abc import Iterator

from decoder.live import LiveSource
from decoder.parallel import decode_groups, decoding_process
from decoder.side_information.protocol import ReferenceFrame
from decoder.tasks import DecodedGroup, GroupTask, naming_group
from dvc.config import CodecConfig, encode_config
from dvc.errors import BitstreamError
from dvc.keyframes import KeyFrameDecoder
from dvc.stream import Form, GopRecord, StreamReader
from dvc.video import Frame


def decode_stream(
    config: CodecConfig, reader: StreamReader, jobs: int = 1, frames: range | None = None
) -> Iterator[DecodedGroup]:
    """Decode a stream group by group; the same bytes for any number of jobs.

    Parameters
    ----------
    config : CodecConfig
        The stream's configuration, or that with the decoder's own choice of side information.
    reader : StreamReader
        The stream, buffered or punctured.
    jobs : int, optional
        Processes that decode groups at the same time.
    frames : range, optional
        Display positions of the frames that are wanted, all by default; other groups are skipped.

    Returns
    -------
    iterator of DecodedGroup
        In display order; it raises `BitstreamError` where the stream is damaged, after all groups before.

    Raises
    ------
    BitstreamError
        If the stream cannot be decoded on any processor alike.
    """
    if reader.version == 1 and reader.form is Form.PUNCTURED and config.codec != "2d":
        raise BitstreamError(
            "a punctured stream of format version 1 with 3D side information decodes only on processors like"
            " that it was made with; decode the buffered stream, or encode the video again"
        )
    return decode_groups(stream_tasks(config, reader, frames), jobs)


def stream_tasks(
    config: CodecConfig, reader: StreamReader, frames: range | None = None
) -> Iterator[GroupTask]:
    """Read a stream group by group, and decode its key frames.

    Parameters
    ----------
    config : CodecConfig
        The stream's configuration, or that with the decoder's own choice of side information.
    reader : StreamReader
        The stream.
    frames : range, optional
        Display positions of the frames that are wanted, all by default; other groups are skipped.

    Yields
    ------
    GroupTask
        What may be decoded anywhere.
    """
    first_group = first_index = 0
    if frames is not None:
        first_group = max(reader.index.gop_of(frames.start) - 1, 0)  # for its key frame
        first_index = reader.index.first_frame(first_group)
        reader.seek_gop(first_group)
    keys = _KeyFrames(config, first_index)
    packed = encode_config(config)
    for number, record in enumerate(reader, first_group):
        first_index, references, key = keys.add(number, record)
        after = first_index + record.num_frames
        if frames is None or after > frames.start:
            yield GroupTask(packed, number, first_index, references, key, record, reader.form)
        if frames is not None and after >= frames.stop:
            return


def decode_live(config: CodecConfig, source: LiveSource) -> Iterator[DecodedGroup]:
    """Decode what an encoder at the other end of a connection sends, asking for parity as it is needed.

    Parameters
    ----------
    config : CodecConfig
        The sequence's configuration, or that with the decoder's own choice of side information.
    source : LiveSource
        The encoder.

    Yields
    ------
    DecodedGroup
        In display order.

    Raises
    ------
    BitstreamError, FeedbackError
        If the encoder sends what cannot be decoded.
    """
    keys = _KeyFrames(config)
    packed = encode_config(config)
    with decoding_process() as process:
        for gop in source.groups():
            task = GroupTask(packed, gop.number, *keys.add(gop.number, gop.record), gop.record, None)
            yield process.decode(task, source.answer)


class _KeyFrames:
    """Decodes the key frames, and knows between which two a group lies."""

    def __init__(self, config: CodecConfig, next_index: int = 0) -> None:
        video = config.video
        self._decoder = KeyFrameDecoder(
            video.width, video.height, luma_only=video.luma_only, parameter_sets=config.key.parameter_sets
        )
        self._next_index = next_index
        self._previous: ReferenceFrame | None = None

    def add(
        self, number: int, record: GopRecord
    ) -> tuple[int, tuple[ReferenceFrame, ReferenceFrame] | None, Frame]:
        """Decode the next group's key frame; return first index, references (None: not needed), key frame."""
        with naming_group(number, "key frame: "):
            key = self._decoder.decode(record.key)
        first_index = self._next_index
        self._next_index += record.num_frames
        current = ReferenceFrame(self._next_index - 1, key)
        around = None if self._previous is None else (self._previous, current)
        if record.num_frames == 1 and record.tracks:
            raise BitstreamError(f"group of pictures {number}: tracks, but no Wyner-Ziv frames")
        self._previous = current
        return first_index, around if record.num_frames > 1 else None, key
