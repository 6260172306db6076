"""Command `dvc-decode`: decode a stream, or the pictures of a live encoder."""

import argparse
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, nullcontext, suppress
from functools import partial
from typing import TYPE_CHECKING

from decoder import options
from dvc import cli
from dvc.config import MAPPERS
from dvc.errors import BitstreamError, ConfigError, DvcError, FeedbackError, PartialOutputError

if TYPE_CHECKING:
    from decoder.group_tasks import DecodedGroup, Losses
    from decoder.live import LinkReport
    from decoder.session import Reader
    from decoder.view.decoding_view import DecodingView
    from decoder.view.server import ViewServer
    from dvc.config import CodecConfig


def _decode(arguments: argparse.Namespace) -> int:
    options.check(arguments)
    with _page(arguments) as page:
        try:
            status = _decode_live(arguments, page) if arguments.connect else _decode_file(arguments, page)
        except PartialOutputError:
            if arguments.scene is not None:
                _map_partial(arguments)
            raise
        if arguments.scene is not None:
            _map_scene(arguments, arguments.files[-1])
        if page is not None:
            _say(f"all is written; {page.address} stays until Ctrl-C")
            with suppress(KeyboardInterrupt):
                page.wait()
    return status


def _page(arguments: argparse.Namespace) -> AbstractContextManager["ViewServer | None"]:
    """Serve a page, if requested."""
    if not arguments.view:
        return nullcontext()
    from decoder.view.server import ViewServer

    server = ViewServer(arguments.view_port or 0)
    _say(f"watch at {server.address}")
    return server


def _map_partial(arguments: argparse.Namespace) -> None:
    """Map the decoded part of a live run that broke off; its own error counts, not that of the map."""
    from dvc.files import PARTIAL_SUFFIX

    try:
        _map_scene(arguments, arguments.files[-1] + PARTIAL_SUFFIX)
    except DvcError as err:
        _say(f"no map: {err}")


def _map_scene(arguments: argparse.Namespace, video: str) -> None:
    """Map the decoded frames."""
    from sfm.output.scene_folder import map_to_folder

    def _report(message: str) -> None:
        if not arguments.quiet:
            _say(message)

    mapper = arguments.mapper or MAPPERS[0]
    _report(map_to_folder(video, arguments.scene, mapper, _report).summary)


def _decode_file(arguments: argparse.Namespace, page: "ViewServer | None") -> int:
    from decoder.group_tasks import Losses
    from decoder.view.decoding_view import facts_of
    from dvc.stream import Form, open_stream

    path = arguments.files[0]
    with _naming(path), open_stream(path, unfinished=arguments.unfinished) as reader:
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
        form = Form.NO_FEEDBACK if reader.form == Form.NO_FEEDBACK else Form.PUNCTURED
        num_frames = (reader.num_frames or None) if selected is None else len(selected)
        with ExitStack() as stack:
            groups = _decoded(config, reader, selected, losses, arguments, stack)
            view = None if page is None else page.show(facts_of(config, path, num_frames))
            write = _writer(config, arguments, stack, selected=selected, form=form, view=view)
            failure = write(groups, num_frames=num_frames, losses=losses)
        if failure is not None:
            raise failure
        if reader.missing is not None:
            _say(f"{path}: unfinished: {reader.missing}")
    return 0


def _decoded(
    config: "CodecConfig",
    reader: "Reader",
    selected: range | None,
    losses: "Losses | None",
    arguments: argparse.Namespace,
    stack: ExitStack,
) -> "Iterator[DecodedGroup]":
    """Decode on this machine, or on a cluster."""
    limits = options.limits(arguments)
    if arguments.dask is None:
        from decoder.session import decode_stream

        return decode_stream(config, reader, arguments.jobs, selected, limits, losses)
    from decoder.cluster import decode_on_cluster
    from dvc.dask_cluster import connected
    from dvc.versions import codec_digest

    client = stack.enter_context(connected(arguments.dask, codec_digest()))
    return stack.enter_context(closing(decode_on_cluster(config, reader, client, selected, limits, losses)))


@contextmanager
def _naming(path: str) -> Iterator[None]:
    """Prefix errors with the name of the stream."""
    try:
        yield
    except BitstreamError as err:
        raise BitstreamError(f"{path}: {err}") from err


def _decode_live(arguments: argparse.Namespace, page: "ViewServer | None") -> int:
    from decoder.live import LiveSource
    from decoder.session import decode_live
    from decoder.view.decoding_view import facts_of
    from dvc.feedback import Dialler, parse_address

    address = parse_address(arguments.connect)
    dialler = Dialler(*address, options.protection(arguments), arguments.timeout)
    with (
        _stopped_by_signals() as stop,
        closing(LiveSource(dialler, arguments.patience, _say, stop)) as source,
    ):
        try:
            config = options.with_choices(source.config, arguments)
            with ExitStack() as stack:
                groups = decode_live(config, source, arguments.jobs, stop, options.limits(arguments))
                view = None
                if page is not None:
                    view = page.show(facts_of(config, arguments.connect, None), lambda: source.num_asked)
                _writer(config, arguments, stack, link=source.report, view=view)(groups)
        except (DvcError, KeyboardInterrupt) as err:
            with suppress(FeedbackError):  # the encoder may have gone, too
                source.abort(cli.one_line(err) or "interrupted")
            raise
    return 0


def _say(text: str) -> None:
    sys.stderr.write(f"{options.PROG}: {cli.one_line(text)}\n")


@contextmanager
def _stopped_by_signals() -> Iterator[socket.socket]:
    """Yield a socket that becomes readable at an interrupt or SIGTERM."""
    stop, stopping = socket.socketpair()
    with stop, stopping, cli.stopping_at_signals(lambda: stopping.sendall(b"x")):
        yield stop


def _writer(
    config: "CodecConfig",
    arguments: argparse.Namespace,
    stack: ExitStack,
    *,
    selected: range | None = None,
    form: str = "punctured",
    link: "LinkReport | None" = None,
    view: "DecodingView | None" = None,
) -> "Callable[..., DvcError | None]":
    """Open the outputs; return the function that writes decoded groups to them."""
    from decoder.output import JsonSink, Sink, StreamSink, VideoSink, ViewSink, write_groups
    from decoder.report import DecodeReport
    from dvc.files import PARTIAL_SUFFIX
    from dvc.stream import Form
    from dvc.video import open_video

    video, rate, kept = arguments.files[-1], config.video.frame_rate, link is not None
    reference = None
    if arguments.reference:
        start = arguments.reference_start + (0 if selected is None else selected.start)
        original = open_video(arguments.reference, size=arguments.size, frame_rate=rate, start=start)
        reference = stack.enter_context(original)
    report = DecodeReport(config, reference, selected, kept=arguments.json is not None)
    sinks: list[Sink] = []
    stream = None
    if selected is None and (arguments.punctured or arguments.json):  # reports give its size
        stream = StreamSink(stack, arguments.punctured, config, Form(form), kept=kept)
        sinks.append(stream)
    sinks.append(VideoSink(stack, video, config, kept=kept))
    if arguments.side_information_video:
        sinks.append(VideoSink(stack, arguments.side_information_video, config, predicted=True, kept=kept))
    if view is not None:
        sinks.append(ViewSink(view))
    if arguments.json:
        sinks.append(JsonSink(arguments.json, report, stream, link))
    return partial(
        write_groups,
        report=report,
        sinks=sinks,
        frame_rate=float(rate),
        partial=f"{video}{PARTIAL_SUFFIX}" if kept else None,
        quiet=arguments.quiet,
    )


main = cli.command(options.PROG, options.parser, _decode, extra="decode")

if __name__ == "__main__":
    sys.exit(main())
