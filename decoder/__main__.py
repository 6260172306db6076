"""Command `dvc-decode`: decode a stream, or what an encoder serves."""

import argparse
import socket
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, nullcontext, suppress
from typing import TYPE_CHECKING

from decoder import options
from dvc import cli
from dvc.config import MAPPERS
from dvc.errors import (
    BitstreamError,
    ConfigError,
    DvcError,
    FeedbackError,
    PartialOutputError,
)

if TYPE_CHECKING:
    from decoder.group_tasks import DecodedGroup, Losses
    from decoder.live import LiveSource
    from decoder.output import DecodedOutput
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
        wanted = None if frames is None else options.frame_range(frames, reader.index.num_frames)
        with ExitStack() as stack:
            losses = Losses(wanted) if arguments.salvage else None
            groups = _decoded(config, reader, wanted, losses, arguments, stack)
            form = Form.NO_FEEDBACK if reader.form == Form.NO_FEEDBACK else Form.PUNCTURED
            num_frames = len(wanted) if wanted is not None else reader.num_frames or None
            view = None if page is None else page.show(facts_of(config, path, num_frames))
            output = _output(config, arguments, stack, wanted, form, view=view)
            failure = output.consume(groups, arguments.quiet, losses, num_frames)
        if failure is not None:
            raise failure
        if reader.missing is not None:
            _say(f"{path}: unfinished: {reader.missing}")
    return 0


def _decoded(
    config: "CodecConfig",
    reader: "Reader",
    wanted: range | None,
    losses: "Losses | None",
    arguments: argparse.Namespace,
    stack: ExitStack,
) -> "Iterator[DecodedGroup]":
    """Decode on this machine, or on a cluster."""
    limits = options.limits(arguments)
    if arguments.dask is None:
        from decoder.session import decode_stream

        return decode_stream(config, reader, arguments.jobs, wanted, limits, losses)
    from decoder.cluster import decode_on_cluster
    from dvc.dask_cluster import connected
    from dvc.versions import codec_digest

    client = stack.enter_context(connected(arguments.dask, codec_digest()))
    return stack.enter_context(closing(decode_on_cluster(config, reader, client, wanted, limits, losses)))


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
                output = _output(config, arguments, stack, live=source, view=view)
                output.consume(groups, arguments.quiet)
        except (DvcError, KeyboardInterrupt) as err:
            with suppress(FeedbackError):  # the encoder may have gone, too
                source.abort(cli.one_line(err) or "interrupted")
            raise
    return 0


def _say(text: str) -> None:
    sys.stderr.write(f"{options.PROG}: {cli.one_line(text)}\n")


@contextmanager
def _stopped_by_signals() -> Iterator[socket.socket]:
    """Give what can be read after an interrupt or SIGTERM."""
    stop, stopping = socket.socketpair()
    with stop, stopping, cli.stopping_at_signals(lambda: stopping.sendall(b"x")):
        yield stop


def _output(
    config: "CodecConfig",
    arguments: argparse.Namespace,
    stack: ExitStack,
    wanted: range | None = None,
    form: str = "punctured",
    *,
    live: "LiveSource | None" = None,
    view: "DecodingView | None" = None,
) -> "DecodedOutput":
    from decoder.output import DecodedOutput
    from dvc.stream import Form
    from dvc.video import open_video

    reference = None
    if arguments.reference:
        start = arguments.reference_start + (0 if wanted is None else wanted.start)
        original = open_video(
            arguments.reference, size=arguments.size, frame_rate=config.video.frame_rate, start=start
        )
        reference = stack.enter_context(original)
    return DecodedOutput(
        config,
        stack,
        video=arguments.files[-1],
        side_information=arguments.side_information_video,
        punctured=arguments.punctured,
        report=arguments.json,
        reference=reference,
        wanted=wanted,
        form=Form(form),
        live=live,
        view=view,
    )


main = cli.command(options.PROG, options.parser, _decode, extra="decode")

if __name__ == "__main__":
    sys.exit(main())
