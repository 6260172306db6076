"""Command `dvc-decode`: decode a stream, or what an encoder serves."""

import argparse
import re
import socket
import sys
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING

from dvc import cli
from dvc.config import FALLBACKS, SFM_BACKENDS
from dvc.errors import (
    BitstreamError,
    ConfigError,
    DvcError,
    FeedbackError,
    PartialOutputError,
    PeerClosedError,
)
from dvc.limits import MAX_MEMORY_MIB

if TYPE_CHECKING:
    from decoder.live import LiveSource
    from decoder.output import DecodedOutput
    from decoder.session import Reader
    from decoder.tasks import DecodedGroup
    from dvc.config import CodecConfig
    from dvc.feedback import Protection
    from dvc.limits import Limits

PROG = "dvc-decode"
EXAMPLES = """\
  dvc-decode street.dvc street.mkv --jobs 2                     lossless video of the decoded frames
  dvc-decode street.dvc out.y4m --reference street.mkv --json -  PSNR and bits of every frame
  dvc-decode street.dvc out.mkv --punctured small.dvc           also write the stream that was really needed
  dvc-decode street.dvc part.mkv --frames 40:48                 frames 40 to 47, no more groups than they need
  dvc-decode day-0003.dvc.part day.mkv --unfinished             what a recording holds that was cut off
  dvc-decode street.dvc street.mkv --scene map                  and the map: cameras, depth, points, a page
  dvc-decode recording day.mkv --dask tcp://127.0.0.1:8786      all segments in a folder, on a Dask cluster
  dvc-decode --connect 127.0.0.1:5000 out.mkv                   decode live from `dvc-encode --serve`
"""


def _parser() -> argparse.ArgumentParser:
    parser = cli.ArgumentParser(PROG, "Decode a stream of dvc-encode.", EXAMPLES)
    parser.add_argument(
        "files",
        metavar="INPUT OUTPUT",
        nargs="+",
        help="stream (.dvc), or folder of a recording's segments, and video to write (.y4m, .mkv, .mp4); with"
        " --connect the video alone",
    )
    live = parser.add_argument_group("live")
    cli.add_live(live, "--connect", "decode live from `dvc-encode --serve HOST:PORT`")
    live.add_argument(
        "--tls-ca",
        metavar="FILE",
        help="talk over TLS, to an encoder whose certificate one of these (PEM) has signed",
    )
    live.add_argument(
        "--fingerprint", metavar="SHA256", help="talk over TLS, to the encoder whose certificate has this one"
    )
    _add_prediction(parser)
    _add_outputs(parser)
    parser.add_argument(
        "--frames",
        type=_frame_slice,
        metavar="A:B",
        help="decode frames A to B-1, counted from 0, and only the groups of pictures that they need (files"
        " only); A: means to the end, :B from the beginning",
    )
    where = parser.add_mutually_exclusive_group()
    cli.add_integer(where, "--jobs", (1, 256), "processes that decode at the same time", default=1)
    where.add_argument(
        "--dask",
        metavar="ADDRESS",
        help="decode on the workers of a Dask cluster, such as tcp://127.0.0.1:8786 (files only)",
    )
    _add_endings(parser)
    _add_limits(parser)
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    return parser


def _add_endings(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--salvage",
        action="store_true",
        help="keep the frames before the damage of a damaged stream (exit status 2 all the same; files only:"
        " what a live run has decoded when it ends early stays as OUTPUT.part, with exit status 3)",
    )
    parser.add_argument(
        "--unfinished",
        action="store_true",
        help="decode the finished groups of pictures of a stream that lacks its end (a .part that is still"
        " being written, or that a power cut left) and say what is missing (exit status 0; files only)",
    )


def _add_limits(parser: argparse.ArgumentParser) -> None:
    allowed = (
        "refuse streams with more than N frames, and end a live run before there are more"
        " (default: a million, and no more than fit the size of the stream, some thousand pixels a byte; any"
        " number in live runs)"
    )
    cli.add_integer(parser, "--max-frames", (1, 10**9), allowed)
    cli.add_integer(
        parser,
        "--max-memory",
        (1, 2**24),
        "refuse streams whose decoding may take more than this, by their header, in MiB",
        default=MAX_MEMORY_MIB,
        metavar="MIB",
    )


def _frame_slice(text: str) -> slice:
    match = re.fullmatch(r"([0-9]{0,9}):([0-9]{0,9})", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"expected A:B, A: or :B, whole numbers from 0 on, got {text!r}")
    first, end = (int(number) if number else None for number in match.groups())
    return slice(first, end)


def _add_prediction(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument_group("prediction, instead of as the stream says").add_argument
    add(
        "--side-information",
        metavar="METHOD",
        help="predict with METHOD (mci, blocks, mesh, depth, fused) instead of what the stream names",
    )
    add(
        "--sfm",
        choices=SFM_BACKENDS,
        help="whose estimators reconstruct the scene, instead of what the stream names",
    )
    add(
        "--path-regularity",
        type=float,
        metavar="W",
        help="smooth the camera's path between key frames, by tracks (0: not), instead of as the stream says",
    )
    add(
        "--track-corrections",
        action=argparse.BooleanOptionalAction,
        help="move what is predicted to where neighbouring tracks agree that it is, instead of as the stream"
        " says",
    )
    add(
        "--fallback",
        choices=FALLBACKS,
        help="what serves with points beside a model of the scene, and without one, instead of what the"
        " stream names",
    )


def _add_outputs(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("further outputs, and the original to compare with")
    add = group.add_argument
    add(
        "--punctured",
        metavar="FILE",
        help="write the stream that was really needed (.dvc); its size is the rate",
    )
    add(
        "--side-information-video",
        metavar="FILE",
        help="write what each frame was predicted as before any of it was decoded, luma only (.y4m, .mkv);"
        " key frames as they are",
    )
    add(
        "--scene",
        metavar="DIR",
        help="map the scene out of the decoded frames into a new folder: cameras, depth, points, and a page"
        " to fly through it (docs/scene.md); of a live run that ends early, out of what there is; OUTPUT must"
        " be .y4m or .mkv",
    )
    mapper = "whose mapper finds the cameras of --scene; default: native"
    add("--mapper", choices=SFM_BACKENDS, help=mapper)
    add("--reference", metavar="ORIGINAL", help="the original video; used for nothing but PSNR")
    first = "frame of ORIGINAL that was coded first"
    cli.add_integer(group, "--reference-start", (0, 10**9), first, default=0, metavar="K")
    add("--size", type=cli.parse_size, metavar="WxH", help="picture size of a raw ORIGINAL")
    add(
        "--json",
        metavar="FILE",
        help="write bits, PSNR and times of every frame and totals (-: standard output)",
    )


def _decode(arguments: argparse.Namespace) -> int:
    wanted = 1 if arguments.connect else 2
    if len(arguments.files) != wanted:
        names = "OUTPUT" if arguments.connect else "INPUT and OUTPUT"
        raise ConfigError(f"expected {names}, got {len(arguments.files)} file names")
    if arguments.frames is not None and (arguments.connect or arguments.punctured):
        other = "--connect" if arguments.connect else "--punctured"
        raise ConfigError(f"--frames and {other} exclude each other: {other} is for whole sequences")
    for option in ("unfinished", "salvage"):
        if arguments.connect and getattr(arguments, option):
            raise ConfigError(f"--{option} is for files, not for --connect, which keeps what was decoded")
    if arguments.connect and arguments.dask:
        raise ConfigError("--dask is for files, not for --connect, whose encoder waits for one decoder")
    _check_scene(arguments)
    outputs = [arguments.files[-1], arguments.punctured, arguments.side_information_video, arguments.json]
    inputs = [*arguments.files[:-1], *([arguments.reference] if arguments.reference else [])]
    cli.check_outputs(inputs, [name for name in outputs if name not in (None, "-")])
    try:
        status = _decode_live(arguments) if arguments.connect else _decode_file(arguments)
    except PartialOutputError:
        if arguments.scene is not None:
            _map_partial(arguments)
        raise
    if arguments.scene is not None:
        _map_scene(arguments, arguments.files[-1])
    return status


def _check_scene(arguments: argparse.Namespace) -> None:
    """Refuse a map that cannot be written, before any work."""
    if arguments.scene is None:
        if arguments.mapper is not None:
            raise ConfigError("--mapper is for --scene")
        return
    from dvc.files import check_folder

    video = arguments.files[-1]
    if not video.endswith((".y4m", ".mkv")):
        raise ConfigError(f"--scene reads OUTPUT again: it must be .y4m or .mkv, got {video}")
    check_folder(arguments.scene)


def _map_partial(arguments: argparse.Namespace) -> None:
    """Map what a live run has decoded that broke off; why it did is what its end tells, not a failed map."""
    from dvc.files import PARTIAL_SUFFIX

    try:
        _map_scene(arguments, arguments.files[-1] + PARTIAL_SUFFIX)
    except DvcError as err:
        _say(f"no map: {err}")


def _map_scene(arguments: argparse.Namespace, video: str) -> None:
    """Map what was decoded."""
    from sfm.output.map_folder import map_to_folder

    def _report(message: str) -> None:
        if not arguments.quiet:
            _say(message)

    mapper = arguments.mapper or SFM_BACKENDS[0]
    _report(map_to_folder(video, arguments.scene, mapper, _report).summary)


def _decode_file(arguments: argparse.Namespace) -> int:
    from dvc.stream import Form, open_stream

    path = arguments.files[0]
    with _naming(path), open_stream(path, unfinished=arguments.unfinished) as reader:
        config = _with_choices(reader.config, arguments)
        if config != reader.config and reader.form == Form.PUNCTURED:
            raise ConfigError(
                f"a punctured stream can only be decoded as it was made, with {_choices(reader.config)}"
            )
        if arguments.punctured and reader.form == Form.NO_FEEDBACK:
            raise ConfigError(
                "--punctured is for streams that hold more than is needed, not for no-feedback streams"
            )
        wanted = None if arguments.frames is None else _wanted(arguments.frames, reader.index.num_frames)
        with ExitStack() as stack:
            groups = _decoded(config, reader, wanted, arguments, stack)
            form = Form.NO_FEEDBACK if reader.form == Form.NO_FEEDBACK else Form.PUNCTURED
            output = _output(config, arguments, stack, wanted, form)
            num_frames = len(wanted) if wanted is not None else reader.num_frames or None
            failure = output.consume(groups, arguments.quiet, arguments.salvage, num_frames)
        if failure is not None:
            raise failure
        if reader.missing is not None:
            _say(f"{path}: unfinished: {reader.missing}")
    return 0


def _decoded(
    config: "CodecConfig",
    reader: "Reader",
    wanted: range | None,
    arguments: argparse.Namespace,
    stack: ExitStack,
) -> "Iterator[DecodedGroup]":
    """Decode on this machine, or on a cluster."""
    limits = _limits(arguments)
    if arguments.dask is None:
        from decoder.session import decode_stream

        return decode_stream(config, reader, arguments.jobs, wanted, limits)
    from decoder.cluster import decode_on_cluster
    from dvc.cluster import connected
    from dvc.versions import codec_digest

    client = stack.enter_context(connected(arguments.dask, codec_digest()))
    return stack.enter_context(closing(decode_on_cluster(config, reader, client, wanted, limits)))


def _wanted(frames: slice, num_frames: int) -> range:
    wanted = range(num_frames)[frames]
    if not wanted:
        given = "".join("" if number is None else str(number) for number in (frames.start, ":", frames.stop))
        raise ConfigError(f"--frames {given} holds no frame; the stream has {num_frames}, from 0 on")
    return wanted


@contextmanager
def _naming(path: str) -> Iterator[None]:
    """Put the name of the stream before what is wrong with it."""
    try:
        yield
    except BitstreamError as err:
        raise BitstreamError(f"{path}: {err}") from err


def _decode_live(arguments: argparse.Namespace) -> int:
    from decoder.live import LiveSource
    from decoder.session import decode_live
    from dvc.feedback import dial, parse_address

    protection = _protection(arguments)
    host, port = parse_address(arguments.connect)
    try:
        link = dial(host, port, arguments.timeout, protection, arguments.patience)
    except PeerClosedError as err:
        hint = "; it may want a token, or TLS" if protection.is_none else ""
        raise FeedbackError(f"{err}{hint}") from err
    with link:
        link.keep_alive()
        source = LiveSource(link)
        first = source.endpoint.first_frame
        if first:
            _say(f"begins with frame {first}: frames 0 to {first - 1} were sent to another decoder, or none")
        try:
            config = _with_choices(source.config, arguments)
            with _stopped_by_signals() as stop, ExitStack() as stack:
                groups = decode_live(config, source, arguments.jobs, stop, _limits(arguments))
                output = _output(config, arguments, stack, live=source)
                output.consume(groups, arguments.quiet)
        except (DvcError, KeyboardInterrupt) as err:
            with suppress(FeedbackError):  # it may have gone itself
                source.give_up(cli.one_line(err) or "interrupted")
            raise
        link.deliver()
    return 0


def _say(text: str) -> None:
    sys.stderr.write(f"{PROG}: {cli.one_line(text)}\n")


def _protection(arguments: argparse.Namespace) -> "Protection":
    """Tell whom to talk to."""
    from dvc.feedback import Protection, parse_address, read_token
    from dvc.feedback.tls import decoder_context, parse_fingerprint

    token = None if arguments.token_file is None else read_token(arguments.token_file)
    fingerprint = None if arguments.fingerprint is None else parse_fingerprint(arguments.fingerprint)
    wanted = arguments.tls_ca is not None or fingerprint is not None
    tls = decoder_context(arguments.tls_ca) if wanted else None
    host, _ = parse_address(arguments.connect)
    return Protection(False, token, tls, host, fingerprint, arguments.insecure)


def _limits(arguments: argparse.Namespace) -> "Limits":
    from dvc.limits import Limits

    return Limits(arguments.max_frames, arguments.max_memory)


@contextmanager
def _stopped_by_signals() -> Iterator[socket.socket]:
    """Give what can be read after an interrupt or SIGTERM."""
    stop, stopping = socket.socketpair()
    with stop, stopping, cli.stopping_at_signals(lambda: stopping.sendall(b"x")):
        yield stop


def _with_choices(config: "CodecConfig", arguments: argparse.Namespace) -> "CodecConfig":
    """Put the decoder's own choices in place of what the stream names."""
    method = arguments.side_information
    if method is not None:
        from decoder.side_information.methods import METHODS

        if method not in METHODS:
            raise ConfigError(f"--side-information must be one of {', '.join(METHODS)}, got {method!r}")
        config = replace(config, side_information=replace(config.side_information, method=method))
    if arguments.track_corrections is not None:
        prediction = replace(config.side_information, track_corrections=arguments.track_corrections)
        config = replace(config, side_information=prediction)
    if arguments.fallback is not None:
        prediction = replace(config.side_information, fallback=arguments.fallback)
        config = replace(config, side_information=prediction)
    if arguments.sfm is not None:
        config = replace(config, geometry=replace(config.geometry, backend=arguments.sfm))
    if arguments.path_regularity is not None:
        geometry = replace(config.geometry, path_regularity=arguments.path_regularity)
        config = replace(config, geometry=geometry)
    return config


def _choices(config: "CodecConfig") -> str:
    """Write the choices that a punctured stream was made with."""
    prediction, geometry = config.side_information, config.geometry
    corrections = "--track-corrections" if prediction.track_corrections else "--no-track-corrections"
    return (
        f"{prediction.method} (--sfm {geometry.backend} --path-regularity {geometry.path_regularity:g}"
        f" {corrections} --fallback {prediction.fallback})"
    )


def _output(
    config: "CodecConfig",
    arguments: argparse.Namespace,
    stack: ExitStack,
    wanted: range | None = None,
    form: str = "punctured",
    *,
    live: "LiveSource | None" = None,
) -> "DecodedOutput":
    from decoder.output import DecodedOutput
    from dvc.stream import Form
    from dvc.video import open_video

    reference = None
    if arguments.reference:
        video = config.video
        rate = Fraction(video.frame_rate_num, video.frame_rate_den)
        start = arguments.reference_start + (0 if wanted is None else wanted.start)
        start += 0 if live is None else live.endpoint.first_frame
        original = open_video(arguments.reference, size=arguments.size, frame_rate=rate, start=start)
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
    )


main = cli.command(PROG, _parser, _decode, extra="decode")

if __name__ == "__main__":
    sys.exit(main())
