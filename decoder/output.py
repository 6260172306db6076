"""Output of a decoding run: videos, punctured stream, report; complete or none, unless the run was live."""

import os
from collections.abc import Iterable
from contextlib import ExitStack, suppress
from dataclasses import asdict
from typing import Any, BinaryIO

from decoder.decoded_pictures import pictures_of
from decoder.group_tasks import DecodedGroup, Losses
from decoder.live import LiveSource
from decoder.report import DecodeReport
from decoder.view.decoding_view import DecodingView
from dvc import cli
from dvc.config import CodecConfig
from dvc.errors import DvcError, PartialOutputError
from dvc.files import PARTIAL_SUFFIX, atomic_output
from dvc.stream import Form, StreamWriter
from dvc.video import Frame, VideoReader, VideoWriter, create_video


class DecodedOutput:
    """Writes decoded groups of pictures."""

    def __init__(
        self,
        config: CodecConfig,
        stack: ExitStack,
        *,
        video: str,
        side_information: str | None = None,
        punctured: str | None = None,
        report: str | None = None,
        reference: VideoReader | None = None,
        wanted: range | None = None,
        form: Form = Form.PUNCTURED,
        live: LiveSource | None = None,
        view: DecodingView | None = None,
    ) -> None:
        kept = live is not None
        self._view = view
        self._live = live  # a live run cannot be repeated: its finished part is kept
        self._path = video
        self._wanted = wanted
        self._config = config
        self._num_frames = self._num_coded = self._num_bits = 0
        self._frame_rate = config.video.frame_rate_num / config.video.frame_rate_den
        self._rate = ""
        self._report_path = report
        self._report = DecodeReport(config, reference, wanted, kept=report is not None)
        self._stream: StreamWriter | None = None
        if punctured is not None or report is not None:  # reports give the size of the punctured stream
            self._file = _stream_file(punctured, stack, kept=kept)
            self._stream = StreamWriter(self._file, config, form)
        self._video = _video_writer(config, video, config.video.luma_only, stack, kept=kept)
        self._side_information: VideoWriter | None = None
        if side_information is not None:
            self._side_information = _video_writer(config, side_information, True, stack, kept=kept)

    def consume(
        self,
        groups: Iterable[DecodedGroup],
        quiet: bool,
        losses: Losses | None = None,
        num_frames: int | None = None,
    ) -> DvcError | None:
        """Write all groups; show the progress, as a share of the frames if known, and the rate so far."""
        with cli.progress_bar("decoding", num_frames, quiet) as progress:
            try:
                for group in groups:
                    self._add(group, progress)
            except (DvcError, KeyboardInterrupt) as err:
                if self._num_frames == 0:
                    raise
                if self._live is not None:
                    self._report_partial()
                    reason = str(err) or "interrupted"
                    kept = f"frames kept: {self._num_frames}, as {self._path}{PARTIAL_SUFFIX}"
                    raise PartialOutputError(f"{reason} ({kept})") from err
                raise
        failure = None if losses is None else losses.error(self._num_frames)
        if failure is not None and self._num_frames == 0:
            raise failure
        self._finish()
        return failure

    def _report_partial(self) -> None:
        """Report the finished part of a live run that broke off."""
        if self._report_path is not None:
            to_file = "" if self._report_path == "-" else PARTIAL_SUFFIX
            with suppress(DvcError):
                cli.write_json(self._report_path + to_file, self._to_dict())

    def _add(self, group: DecodedGroup, progress: cli.Advance) -> None:
        rows = self._report.add(group)
        for picture in pictures_of(group, self._config.video, rows):
            self._video.write(picture.frame, picture.time_s)
            if self._side_information is not None:
                shown = picture.frame if picture.predicted is None else Frame(picture.predicted)
                self._side_information.write(shown, picture.time_s)
            if self._view is not None:
                self._view.add(picture, group.first_index)
            self._num_frames += 1
            progress(1, self._rate)
        if self._wanted is not None:
            return
        if self._stream is not None:
            self._stream.write_gop(group.record)
            self._file.flush()  # finished groups survive a kill of this process
        self._num_coded += len(group.frames)
        self._num_bits += sum(sum(row["bits"].values()) for row in rows)
        self._rate = f"{1e-3 * self._num_bits * self._frame_rate / self._num_coded:.4g} kbit/s"

    def _finish(self) -> None:
        if self._stream is not None:
            self._stream.close()
        self._video.close()
        if self._side_information is not None:
            self._side_information.close()
        if self._report_path is not None:
            cli.write_json(self._report_path, self._to_dict())

    def _to_dict(self) -> dict[str, Any]:
        """Return the report, with the lost connections of a live run."""
        assert self._stream is not None
        report = self._report.to_dict(self._stream.num_bytes)
        if self._live is None:
            return report
        return {**report, **asdict(self._live.report)}


def _video_writer(
    config: CodecConfig, path: str, luma_only: bool, stack: ExitStack, *, kept: bool
) -> VideoWriter:
    video = config.video
    rate = video.frame_rate
    size = video.width, video.height
    return stack.enter_context(create_video(path, size, rate, luma_only=luma_only, kept=kept))


def _stream_file(path: str | None, stack: ExitStack, *, kept: bool) -> BinaryIO:
    temporary = stack.enter_context(atomic_output(path or os.devnull, kept=kept))
    return stack.enter_context(temporary.open("wb"))
