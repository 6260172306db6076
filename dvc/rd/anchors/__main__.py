"""Command ``python -m dvc.rd.anchors``: write a file of a standard codec, and measure it."""

import argparse
import sys
from pathlib import Path

from dvc import cli
from dvc.config import MAX_QP
from dvc.rd.anchors.codecs import ANCHOR_CODECS

PROG = "dvc.rd.anchors"
EXAMPLES = """\
  python -m dvc.rd.anchors encode box.mkv box.264 --codec x264-medium --qp 28 --frames 51 --json -
  python -m dvc.rd.anchors decode box.264 --reference box.mkv --json -
"""


def _parser() -> argparse.ArgumentParser:
    parser = cli.ArgumentParser(PROG, "Write files of standard codecs, and measure them.", EXAMPLES)
    commands = parser.add_subparsers(dest="command", required=True, metavar="{encode,decode}")
    encode = commands.add_parser(
        "encode", prog=f"{PROG} encode", description="Write a file.", help="write a file"
    )
    encode.add_argument("input", metavar="INPUT", help="any video that dvc-encode reads but raw ones")
    encode.add_argument("output", metavar="OUTPUT", help="file to write: .264, .265 or .obu")
    encode.add_argument("--codec", choices=ANCHOR_CODECS, required=True)
    encode.add_argument(
        "--qp",
        type=cli.integer(1, MAX_QP),
        required=True,
        metavar="QP",
        help="on the scale of H.264, 1 to 51",
    )
    encode.add_argument("--start", type=cli.integer(0, 10**9), default=0, metavar="K", help="first frame")
    encode.add_argument("--frames", type=cli.integer(1, 10**9), metavar="N", help="default: all")
    decode = commands.add_parser(
        "decode", prog=f"{PROG} decode", description="Measure a file.", help="measure a file"
    )
    decode.add_argument("input", metavar="FILE", type=Path, help="what `encode` wrote")
    decode.add_argument("--reference", required=True, metavar="ORIGINAL", help="what `encode` read")
    decode.add_argument(
        "--reference-start", type=cli.integer(0, 10**9), default=0, metavar="K", help="what --start was"
    )
    decode.add_argument("--zero-motion", action="store_true", help="refuse motion vectors that are not zero")
    decode.add_argument("--video", type=Path, metavar="OUT", help="write the luma: .y4m or .mkv")
    for command in (encode, decode):
        command.add_argument(
            "--luma-only", action="store_true", help="leave chroma out; x264-ippp-zero codes nothing else"
        )
        command.add_argument("--json", metavar="FILE", help="write what was found (-: standard output)")
        command.add_argument("--quiet", action="store_true", help="accepted like by the other commands")
    return parser


def _encode(arguments: argparse.Namespace) -> int:
    from dvc.rd.anchors.encoding import encode_file

    cli.check_outputs([arguments.input], [arguments.output, *_json_files(arguments)])
    coded = encode_file(
        arguments.input,
        arguments.output,
        ANCHOR_CODECS[arguments.codec],
        arguments.qp,
        arguments.start,
        arguments.frames,
        luma_only=arguments.luma_only,
    )
    if arguments.json:
        cli.write_json(arguments.json, coded)
    return 0


def _decode(arguments: argparse.Namespace) -> int:
    from dvc.rd.anchors.decoding import measure_file

    outputs = [arguments.video] if arguments.video else []
    cli.check_outputs([arguments.input, arguments.reference], [*outputs, *_json_files(arguments)])
    measured = measure_file(
        arguments.input,
        arguments.reference,
        arguments.reference_start,
        zero_motion=arguments.zero_motion,
        luma_only=arguments.luma_only,
        video=arguments.video,
    )
    if arguments.json:
        cli.write_json(arguments.json, measured)
    return 0


def _json_files(arguments: argparse.Namespace) -> list[str]:
    return [] if arguments.json in (None, "", "-") else [arguments.json]


def _work(arguments: argparse.Namespace) -> int:
    return (_encode if arguments.command == "encode" else _decode)(arguments)


main = cli.command(PROG, _parser, _work, has_subcommands=True)

if __name__ == "__main__":
    sys.exit(main())
