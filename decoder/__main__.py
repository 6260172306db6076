"""Command `dvc-decode`: decode a stream, or the pictures of a live encoder."""

import argparse
import os
import socket
import sys
from collections.abc import Iterable
from contextlib import ExitStack, closing, nullcontext, suppress
from dataclasses import asdict
from typing import TYPE_CHECKING

from decoder import options
from dvc import cli
from dvc.config import MAPPERS
from dvc.errors import BitstreamError, ConfigError, DvcError, FeedbackError, PartialOutputError
from dvc.files import PARTIAL_SUFFIX

if TYPE_CHECKING:
    from decoder.group_tasks import DecodedGroup, Losses
    from decoder.live import LinkReport
    from decoder.view.decoding_view import DecodingView, ViewServer
    from dvc.config import CodecConfig


def _decode(arguments: argparse.Namespace) -> int:
    options.check(arguments)
    page: ViewServer | None = None
    if arguments.view:
        from decoder.view import decoding_view

        page = decoding_view.ViewServer(arguments.view_port or 0)
        _say(f"watch at {page.address}")
    with page or nullcontext():
        video = arguments.files[-1]
        try:
            (_decode_live if arguments.connect else _decode_file)(arguments, page)
        except BitstreamError as err:
            if arguments.connect:
                raise
            raise BitstreamError(f"{arguments.files[0]}: {err}") from err
        except PartialOutputError:  # counts, not an error of the map
            try:
                _map_scene(arguments, video + PARTIAL_SUFFIX)
            except DvcError as err:
                _say(f"no map: {err}")
            raise
        _map_scene(arguments, video)
        if page is not None:
            _say(f"all is written; {page.address} stays until Ctrl-C")
            with suppress(KeyboardInterrupt):
                page.wait()
    return 0


def _map_scene(arguments: argparse.Namespace, video: str) -> None:
    """Map the decoded frames, if requested."""
    if arguments.scene is None:
        return
    from sfm.output.scene_folder import map_to_folder

    def _report(message: str) -> None:
        if not arguments.quiet:
            _say(message)

    mapper = arguments.mapper or MAPPERS[0]
    _report(map_to_folder(video, arguments.scene, mapper, _report).summary)


def _decode_file(arguments: argparse.Namespace, page: "ViewServer | None") -> None:
    from decoder.group_tasks import Losses
    from dvc.stream import Form, open_stream

    path = arguments.files[0]
    with open_stream(path, unfinished=arguments.unfinished) as reader:
        config = options.with_choices(reader.config, arguments)
        if config != reader.config and reader.form == Form.PUNCTURED:
            made = options.choices(reader.config)
            raise ConfigError(f"a punctured stream can only be decoded as it was made, with {made}")
        if arguments.punctured and reader.form == Form.NO_FEEDBACK:
            raise ConfigError(
                "--punctured requires a stream with more bits than needed, not one without feedback"
            )
        frames = arguments.frames
        selected = None if frames is None else options.selected_frames(frames, reader.index.num_frames)
        losses = Losses(selected) if arguments.salvage else None
        limits = options.limits(arguments)
        with ExitStack() as stack:
            if arguments.dask is None:
                from decoder.session import decode_stream

                groups = decode_stream(config, reader, arguments.jobs, selected, limits, losses)
            else:
                from decoder.cluster import decode_on_cluster
                from dvc.dask_cluster import connected
                from dvc.versions import codec_digest

                client = stack.enter_context(connected(arguments.dask, codec_digest()))
                on_cluster = decode_on_cluster(config, reader, client, selected, limits, losses)
                groups = stack.enter_context(closing(on_cluster))
            num_frames = (reader.num_frames or None) if selected is None else len(selected)
            view = None if page is None else page.show(config, path, num_frames)
            form = Form.NO_FEEDBACK if reader.form == Form.NO_FEEDBACK else Form.PUNCTURED
            outputs = _Outputs(config, arguments, stack, selected=selected, form=form, view=view)
            failure = outputs.write(groups, num_frames, losses)
        if failure is not None:
            raise failure
        if reader.missing is not None:
            _say(f"{path}: unfinished: {reader.missing}")


def _decode_live(arguments: argparse.Namespace, page: "ViewServer | None") -> None:
    from decoder.live import LiveSource
    from decoder.session import decode_live
    from dvc.feedback import Dialler, parse_address

    dialler = Dialler(*parse_address(arguments.connect), options.protection(arguments), arguments.timeout)
    stop, stopping = socket.socketpair()  # readable at an interrupt or SIGTERM
    with (
        stop,
        stopping,
        cli.stopping_at_signals(lambda: stopping.sendall(b"x")),
        closing(LiveSource(dialler, arguments.patience, _say, stop)) as source,
    ):
        try:
            config = options.with_choices(source.config, arguments)
            with ExitStack() as stack:
                groups = decode_live(config, source, arguments.jobs, stop, options.limits(arguments))
                view = None
                if page is not None:
                    view = page.show(config, arguments.connect, None, lambda: source.num_asked)
                _Outputs(config, arguments, stack, link=source.report, view=view).write(groups)
        except (DvcError, KeyboardInterrupt) as err:
            with suppress(FeedbackError):  # the encoder may have gone, too
                source.abort(cli.one_line(err) or "interrupted")
            raise


def _say(text: str) -> None:
    sys.stderr.write(f"{options.PROG}: {cli.one_line(text)}\n")


class _Outputs:
    """Videos, punctured stream, page and report of a run; complete or none, unless the run is live."""

    def __init__(
        self,
        config: "CodecConfig",
        arguments: argparse.Namespace,
        stack: ExitStack,
        *,
        selected: range | None = None,
        form: str = "punctured",
        link: "LinkReport | None" = None,
        view: "DecodingView | None" = None,
    ) -> None:
        from decoder.report import DecodeReport
        from dvc.files import atomic_output
        from dvc.stream import Form, StreamWriter
        from dvc.video import create_video, open_video

        self._arguments, self._link, self._view = arguments, link, view
        video, is_live, reference = config.video, link is not None, None
        self._frame_rate = float(video.frame_rate)
        if arguments.reference:
            start = arguments.reference_start + (0 if selected is None else selected.start)
            original = open_video(
                arguments.reference, size=arguments.size, frame_rate=video.frame_rate, start=start
            )
            reference = stack.enter_context(original)
        self._report = DecodeReport(config, reference, selected, kept=arguments.json is not None)
        self._stream = None
        if selected is None and (arguments.punctured or arguments.json):  # reports give its size
            temporary = stack.enter_context(atomic_output(arguments.punctured or os.devnull, kept=is_live))
            self._file = stack.enter_context(temporary.open("wb"))
            self._stream = StreamWriter(self._file, config, Form(form))
        self._videos = []
        for path, predicted in ((arguments.files[-1], False), (arguments.side_information_video, True)):
            if path:
                size, luma_only = (video.width, video.height), video.luma_only or predicted
                writer = create_video(path, size, video.frame_rate, luma_only=luma_only, kept=is_live)
                self._videos.append((stack.enter_context(writer), predicted))

    def write(
        self, groups: "Iterable[DecodedGroup]", num_frames: int | None = None, losses: "Losses | None" = None
    ) -> DvcError | None:
        """Write all groups, and show the progress; return an error that lists lost frames, if any are."""
        num_written = num_bits = 0
        rate = ""
        with cli.progress_bar("decoding", num_frames, self._arguments.quiet) as progress:
            try:
                for group in groups:
                    bits = self._write_group(group)
                    num_written += len(bits)
                    num_bits += sum(bits)
                    if num_written:
                        rate = f"{1e-3 * num_bits * self._frame_rate / num_written:.4g} kbit/s"
                    progress(len(bits), rate)
            except (DvcError, KeyboardInterrupt) as err:
                if num_written == 0 or self._link is None:
                    raise
                with suppress(DvcError):
                    self._write_report("" if self._arguments.json == "-" else PARTIAL_SUFFIX)
                kept = f"frames kept: {num_written}, as {self._arguments.files[-1]}{PARTIAL_SUFFIX}"
                raise PartialOutputError(f"{str(err) or 'interrupted'} ({kept})") from err
        failure = None if losses is None else losses.error(num_written)
        if failure is not None and num_written == 0:
            raise failure
        if self._stream is not None:
            self._stream.close()
        for writer, _ in self._videos:
            writer.close()
        self._write_report()
        return failure

    def _write_group(self, group: "DecodedGroup") -> list[int]:
        """Write the selected frames of a group; return the bits of each."""
        from dvc.video import Frame

        pictures = self._report.add(group)
        if self._stream is not None:
            self._stream.write_gop(group.record)
            self._file.flush()  # finished groups survive a kill of this process
        for picture in pictures:
            for writer, predicted in self._videos:
                luma = picture.predicted if predicted else None
                writer.write(picture.frame if luma is None else Frame(luma), picture.time_s)
            if self._view is not None:
                self._view.add(picture, group.first_index)
        return [sum(picture.report["bits"].values()) for picture in pictures]

    def _write_report(self, suffix: str = "") -> None:
        if self._arguments.json:
            stream_bytes = 0 if self._stream is None else self._stream.num_bytes
            link = {} if self._link is None else asdict(self._link)
            cli.write_json(self._arguments.json + suffix, self._report.to_dict(stream_bytes) | link)


main = cli.command(options.PROG, options.parser, _decode, extra="decode")

if __name__ == "__main__":
    sys.exit(main())
