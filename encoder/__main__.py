"""Command `dvc-encode`: code a video into a stream, or serve it to a decoder that asks for parity."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from dvc import cli
from dvc.config import CodecConfig
from dvc.errors import ConfigError
from encoder import options

if TYPE_CHECKING:
    from dvc.video import VideoReader
    from encoder.report import EncoderStatistics
    from encoder.session import EncoderSession, Progress


KERNELS = Path(__file__).with_name("kernels.txt")


def _encode(arguments: argparse.Namespace) -> int:
    from dvc.compile_ahead import compiling_ahead
    from dvc.video import open_video

    if (arguments.output is None) == (arguments.serve is None):
        raise ConfigError("give either OUTPUT or --serve HOST:PORT")
    outputs = [name for name in (arguments.output, arguments.json) if name not in (None, "-")]
    cli.check_outputs([arguments.input], outputs)
    ahead = compiling_ahead(KERNELS)
    video = open_video(
        arguments.input,
        size=arguments.size,
        frame_rate=arguments.frame_rate,
        start=arguments.start,
        num_frames=arguments.frames,
    )
    with ahead, video as reader:
        for notice in reader.info.notices:
            sys.stderr.write(f"{options.PROG}: {cli.one_line(notice)}\n")
        session = options.session(arguments, reader.info)
        total = arguments.frames if reader.info.num_frames is None else reader.info.num_frames
        with cli.progress_bar("encoding", total, arguments.quiet) as progress:
            if arguments.serve is None:
                _write(session, reader, arguments, progress)
            else:
                _serve(session, reader, arguments, progress)
    if arguments.json is not None:
        cli.write_json(arguments.json, _report(session.statistics, session.config))
    return 0


def _write(
    session: "EncoderSession", reader: "VideoReader", arguments: argparse.Namespace, progress: "Progress"
) -> None:
    from dvc.files import atomic_output

    with atomic_output(arguments.output) as temporary, temporary.open("wb") as file:
        session.write(reader, file, progress)


def _serve(
    session: "EncoderSession", reader: "VideoReader", arguments: argparse.Namespace, progress: "Progress"
) -> None:
    from dvc.feedback import KEEP_ALIVE, listen, parse_address
    from encoder.live import serve

    with listen(*parse_address(arguments.serve)) as listener:
        sys.stderr.write(f"{options.PROG}: waiting for a decoder on {listener.name}\n")
        sys.stderr.flush()
        connection = listener.accept(silence_timeout_s=arguments.timeout)
    with connection, connection.kept_alive(KEEP_ALIVE):
        serve(session, reader, connection, progress)


def _report(statistics: "EncoderStatistics", config: CodecConfig) -> dict[str, object]:
    from dataclasses import asdict

    return {"frames": statistics.num_frames, **asdict(statistics), "config": config.to_dict()}


main = cli.command(options.PROG, options.parser, _encode)

if __name__ == "__main__":
    sys.exit(main())
