"""Command ``python -m dvc.rd.anchors``: write a file of a standard codec, and measure it."""

import argparse
import sys
from pathlib import Path

from dvc import cli, subcommands
from dvc.config import MAX_QP
from dvc.rd.anchors import ANCHOR_CODECS
from dvc.subcommands import Subcommand

PROG = "dvc.rd.anchors"
EXAMPLES = """\
  python -m dvc.rd.anchors encode box.mkv box.264 --codec x264-medium --qp 28 --frames 51 --json -
  python -m dvc.rd.anchors decode box.264 --reference box.mkv --json -
"""


def _add_encode(encode: argparse.ArgumentParser) -> None:
    add = encode.add_argument
    add("input", metavar="INPUT", help="any video that dvc-encode reads, except raw ones")
    add("output", metavar="OUTPUT", help="file to write: .264, .265 or .obu")
    add("--codec", choices=ANCHOR_CODECS, required=True)
    add("--qp", type=cli.integer(1, MAX_QP), required=True, metavar="QP", help="1 to 51, H.264's scale")
    add("--start", type=cli.integer(0, 10**9), default=0, metavar="K", help="first frame")
    add("--frames", type=cli.integer(1, 10**9), metavar="N", help="default: all")
    _add_common(encode)


def _add_decode(decode: argparse.ArgumentParser) -> None:
    add = decode.add_argument
    add("input", metavar="FILE", type=Path, help="file that `encode` wrote")
    add("--reference", required=True, metavar="ORIGINAL", help="input of `encode`")
    add(
        "--reference-start",
        type=cli.integer(0, 10**9),
        default=0,
        metavar="K",
        help="--start of `encode`",
    )
    add("--video", type=Path, metavar="OUT", help="write the luma: .y4m or .mkv")
    _add_common(decode)


def _add_common(command: argparse.ArgumentParser) -> None:
    command.add_argument("--luma-only", action="store_true", help="leave chroma out")
    command.add_argument("--json", metavar="FILE", help="write the results (-: standard output)")
    command.add_argument("--quiet", action="store_true", help="accepted as by the other commands")


def _encode(arguments: argparse.Namespace) -> int:
    from dvc.rd.anchors.anchor_files import encode_file

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
    from dvc.rd.anchors.anchor_files import measure_file

    outputs = [arguments.video] if arguments.video else []
    cli.check_outputs([arguments.input, arguments.reference], [*outputs, *_json_files(arguments)])
    measured = measure_file(
        arguments.input,
        arguments.reference,
        arguments.reference_start,
        luma_only=arguments.luma_only,
        video=arguments.video,
    )
    if arguments.json:
        cli.write_json(arguments.json, measured)
    return 0


def _json_files(arguments: argparse.Namespace) -> list[str]:
    return [] if arguments.json in (None, "", "-") else [arguments.json]


_SUBCOMMANDS = {
    "encode": Subcommand("write a file", "Write a file.", _add_encode, _encode),
    "decode": Subcommand("measure a file", "Measure a file.", _add_decode, _decode),
}

main = subcommands.command(PROG, "Write files of standard codecs, and measure them.", EXAMPLES, _SUBCOMMANDS)

if __name__ == "__main__":
    sys.exit(main())
