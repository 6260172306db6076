"""Outputs of a decoding run: videos, punctured stream, report; complete or none, unless the run was live."""

import os
from collections.abc import Iterable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict

from decoder.group_tasks import DecodedGroup, Losses
from decoder.live import LinkReport
from decoder.report import DecodedPicture, DecodeReport
from decoder.view.decoding_view import DecodingView
from dvc import cli
from dvc.config import CodecConfig
from dvc.errors import DvcError, PartialOutputError
from dvc.files import PARTIAL_SUFFIX, atomic_output
from dvc.stream import Form, StreamWriter
from dvc.video import Frame, create_video


class Sink:
    """An output of decoded groups."""

    def write(self, group: DecodedGroup, pictures: Sequence[DecodedPicture]) -> None:
        """Write a group, with its selected frames."""

    def close(self) -> None:
        """Complete the output."""

    def abort(self) -> None:
        """Complete the output of a live run that ended early."""


class VideoSink(Sink):
    """A video of the frames, or of the predicted luma of Wyner-Ziv frames."""

    def __init__(
        self, stack: ExitStack, path: str, config: CodecConfig, *, predicted: bool = False, kept: bool
    ) -> None:
        video, self._predicted = config.video, predicted
        size, luma_only = (video.width, video.height), video.luma_only or predicted
        writer = create_video(path, size, video.frame_rate, luma_only=luma_only, kept=kept)
        self._writer = stack.enter_context(writer)

    def write(self, group: DecodedGroup, pictures: Sequence[DecodedPicture]) -> None:
        """Write the frames."""
        for picture in pictures:
            luma = picture.predicted if self._predicted else None
            self._writer.write(picture.frame if luma is None else Frame(luma), picture.time_s)

    def close(self) -> None:
        """Complete the video."""
        self._writer.close()


class StreamSink(Sink):
    """The punctured stream; without a path only its size counts."""

    def __init__(
        self, stack: ExitStack, path: str | None, config: CodecConfig, form: Form, *, kept: bool
    ) -> None:
        temporary = stack.enter_context(atomic_output(path or os.devnull, kept=kept))
        self._file = stack.enter_context(temporary.open("wb"))
        self._writer = StreamWriter(self._file, config, form)

    @property
    def num_bytes(self) -> int:
        """Size so far."""
        return self._writer.num_bytes

    def write(self, group: DecodedGroup, pictures: Sequence[DecodedPicture]) -> None:
        """Write the record of a group."""
        self._writer.write_gop(group.record)
        self._file.flush()  # finished groups survive a kill of this process

    def close(self) -> None:
        """Complete the stream."""
        self._writer.close()


class JsonSink(Sink):
    """The report, with the lost connections of a live run, which is written at the end."""

    def __init__(
        self, path: str, report: DecodeReport, stream: StreamSink | None, link: LinkReport | None
    ) -> None:
        self._path, self._report, self._stream, self._link = path, report, stream, link

    def close(self) -> None:
        """Write the report."""
        self._write("")

    def abort(self) -> None:
        """Report the finished part."""
        with suppress(DvcError):
            self._write("" if self._path == "-" else PARTIAL_SUFFIX)

    def _write(self, suffix: str) -> None:
        stream_bytes = 0 if self._stream is None else self._stream.num_bytes
        link = {} if self._link is None else asdict(self._link)
        cli.write_json(self._path + suffix, self._report.to_dict(stream_bytes) | link)


class ViewSink(Sink):
    """The page of `--view`."""

    def __init__(self, view: DecodingView) -> None:
        self._view = view

    def write(self, group: DecodedGroup, pictures: Sequence[DecodedPicture]) -> None:
        """Show the frames."""
        for picture in pictures:
            self._view.add(picture, group.first_index)


def write_groups(
    groups: Iterable[DecodedGroup],
    report: DecodeReport,
    sinks: Sequence[Sink],
    *,
    frame_rate: float,
    num_frames: int | None = None,
    losses: Losses | None = None,
    partial: str | None = None,
    quiet: bool = False,
) -> DvcError | None:
    """Write all groups, and show the progress; return an error that lists lost frames, if any are.

    `partial` is the file of a live run, which cannot be repeated: its finished part is kept.
    """
    num_written = num_bits = 0
    rate = ""
    with cli.progress_bar("decoding", num_frames, quiet) as progress:
        try:
            for group in groups:
                pictures = report.add(group)
                for sink in sinks:
                    sink.write(group, pictures)
                num_written += len(pictures)
                num_bits += sum(sum(picture.report["bits"].values()) for picture in pictures)
                if num_written:
                    rate = f"{1e-3 * num_bits * frame_rate / num_written:.4g} kbit/s"
                progress(len(pictures), rate)
        except (DvcError, KeyboardInterrupt) as err:
            if num_written == 0 or partial is None:
                raise
            for sink in sinks:
                sink.abort()
            kept = f"frames kept: {num_written}, as {partial}"
            raise PartialOutputError(f"{str(err) or 'interrupted'} ({kept})") from err
    failure = None if losses is None else losses.error(num_written)
    if failure is not None and num_written == 0:
        raise failure
    for sink in sinks:
        sink.close()
    return failure
