"""Options of `dvc-decode`: how they are read, checked, and turned into what decoding needs."""

import argparse
import re
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

from dvc import cli
from dvc.config import FALLBACKS, MAPPERS, SFM_BACKENDS, GeometryConfig, SideInformationConfig
from dvc.errors import ConfigError
from dvc.extensions import SIDE_INFORMATION, installed
from dvc.limits import MAX_MEMORY_MIB

if TYPE_CHECKING:
    from dvc.config import CodecConfig
    from dvc.feedback import Protection
    from dvc.limits import Limits

Section = TypeVar("Section", GeometryConfig, SideInformationConfig)
PROG = "dvc-decode"
EXAMPLES = """\
  dvc-decode street.dvc street.mkv --jobs 2                     lossless video of the decoded frames
  dvc-decode street.dvc out.y4m --reference street.mkv --json -  PSNR and bits of every frame
  dvc-decode street.dvc out.mkv --punctured small.dvc           also write the stream of the needed bits
  dvc-decode street.dvc part.mkv --frames 40:48                 frames 40 to 47, no more groups than they need
  dvc-decode day-0003.dvc.part day.mkv --unfinished             the finished part of an interrupted recording
  dvc-decode damaged.dvc saved.mkv --salvage                    all undamaged frames; lost frames are listed
  dvc-decode street.dvc street.mkv --scene map                  and the map: cameras, depth, points, a page
  dvc-decode street.dvc street.mkv --view                       a page to watch the decoding
  dvc-decode recording day.mkv --dask tcp://127.0.0.1:8786      all segments in a folder, on a Dask cluster
  dvc-decode --connect 127.0.0.1:5000 out.mkv                   decode live from `dvc-encode --serve`
"""
CONSTRAINTS = (
    *(
        cli.Constraint(name, needs=("--connect",))
        for name in ("--token-file", "--insecure", "--tls-ca", "--fingerprint")
    ),
    cli.Constraint("--frames", excludes=("--connect", "--punctured"), why="it selects a part of a file"),
    *(
        cli.Constraint(name, excludes=("--connect",), why="a live run keeps its decoded frames")
        for name in ("--unfinished", "--salvage")
    ),
    cli.Constraint("--dask", excludes=("--connect",), why="an encoder serves one decoder"),
    cli.Constraint("--view-port", needs=("--view",)),
    cli.Constraint("--mapper", needs=("--scene",)),
)


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = cli.ArgumentParser(PROG, "Decode a stream of dvc-encode.", EXAMPLES)
    files = (
        "stream (.dvc), or folder of a recording's segments, and video to write (.y4m, .mkv, .mp4); with"
        " --connect only the video"
    )
    parser.add_argument("files", metavar="INPUT OUTPUT", nargs="+", help=files)
    live = parser.add_argument_group("live")
    cli.add_live(live, "--connect", "decode live from `dvc-encode --serve HOST:PORT`")
    authority = "use TLS; the certificate of the encoder is signed by one of these (PEM)"
    live.add_argument("--tls-ca", metavar="FILE", help=authority)
    fingerprint = "use TLS; the certificate of the encoder has this fingerprint"
    live.add_argument("--fingerprint", metavar="SHA256", help=fingerprint)
    add = parser.add_argument_group("prediction, instead of the settings of the stream").add_argument
    methods = dict.fromkeys(["mci", "blocks", "mesh", "depth", "fused", *installed(SIDE_INFORMATION)])
    method = f"predict with METHOD ({', '.join(methods)}) instead of that of the stream"
    add("--side-information", metavar="METHOD", help=method)
    backend = "backend of the scene reconstruction, instead of that of the stream"
    add("--sfm", choices=SFM_BACKENDS, help=backend)
    regularity = "smooth the camera's path between key frames, by tracks (0: not at all)"
    add("--path-regularity", type=float, metavar="W", help=regularity)
    corrections = "move predicted pixels as neighbouring tracks agree, instead of as the stream specifies"
    add("--track-corrections", action=argparse.BooleanOptionalAction, help=corrections)
    fallback = (
        "prediction from points besides and without a model of the scene, instead of that of the stream"
    )
    add("--fallback", choices=FALLBACKS, help=fallback)
    _add_outputs(parser)
    frames = (
        "decode frames A to B-1, counted from 0, and only the groups of pictures that they need (files"
        " only); A: means to the end, :B from the beginning"
    )
    parser.add_argument("--frames", type=_frame_slice, metavar="A:B", help=frames)
    where = parser.add_mutually_exclusive_group()
    cli.add_integer(where, "--jobs", (1, 256), "processes that decode at the same time", default=1)
    dask = "decode on the workers of a Dask cluster, such as tcp://127.0.0.1:8786 (files only)"
    where.add_argument("--dask", metavar="ADDRESS", help=dask)
    salvage = (
        "keep the frames of a damaged stream that are whole, and name those that are lost: a damaged key"
        " frame costs all frames up to the next IDR picture (exit status 2 all the same; files only:"
        " what a live run has decoded when it ends early stays as OUTPUT.part, with exit status 3)"
    )
    parser.add_argument("--salvage", action="store_true", help=salvage)
    unfinished = (
        "decode the finished groups of pictures of a stream that lacks its end (a .part that is still"
        " being written, or was left by a power cut) and name the missing part (exit status 0; files only)"
    )
    parser.add_argument("--unfinished", action="store_true", help=unfinished)
    allowed = (
        "refuse streams with more than N frames, and end a live run before there are more"
        " (default: a million, and no more than fit the size of the stream, some thousand pixels a byte; any"
        " number in live runs)"
    )
    cli.add_integer(parser, "--max-frames", (1, 10**9), allowed)
    memory = "refuse streams with headers that demand more memory than this, in MiB"
    cli.add_integer(parser, "--max-memory", (1, 2**24), memory, default=MAX_MEMORY_MIB, metavar="MIB")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    return parser


def _frame_slice(text: str) -> slice:
    match = re.fullmatch(r"([0-9]{0,9}):([0-9]{0,9})", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"expected A:B, A: or :B, whole numbers from 0 on, got {text!r}")
    first, end = (int(number) if number else None for number in match.groups())
    return slice(first, end)


def _add_outputs(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("further outputs, and the original to compare with")
    add = group.add_argument
    punctured = "write the stream of the needed bits only (.dvc); its size is the rate"
    add("--punctured", metavar="FILE", help=punctured)
    predictions = (
        "write the predictions before anything of a frame is decoded, luma only (.y4m, .mkv);"
        " key frames as they are"
    )
    add("--side-information-video", metavar="FILE", help=predictions)
    scene = (
        "map the scene out of the decoded frames into a new folder: cameras, depth, points, and a page"
        " to fly through it (docs/scene.md); of a live run that ends early, out of its part; OUTPUT must"
        " be .y4m or .mkv"
    )
    add("--scene", metavar="DIR", help=scene)
    view = (
        "serve a page to this machine that shows frames, predictions, depth, the camera's path and bits"
        " while they are decoded, and after that until Ctrl-C"
    )
    add("--view", action="store_true", help=view)
    port = "port of the page of --view (0: any that is free); default: 0"
    cli.add_integer(group, "--view-port", (0, 65535), port, metavar="PORT")
    mapper = "mapper that estimates the cameras of --scene; default: native"
    add("--mapper", choices=MAPPERS, help=mapper)
    add("--reference", metavar="ORIGINAL", help="the original video; used only for PSNR")
    first = "frame of ORIGINAL that was coded first"
    cli.add_integer(group, "--reference-start", (0, 10**9), first, default=0, metavar="K")
    add("--size", type=cli.parse_size, metavar="WxH", help="picture size of a raw ORIGINAL")
    report = "write bits, PSNR and times of every frame and totals (-: standard output)"
    add("--json", metavar="FILE", help=report)


def check(arguments: argparse.Namespace) -> None:
    """Refuse contradictory options before any file is opened."""
    if len(arguments.files) != (1 if arguments.connect else 2):
        names = "OUTPUT" if arguments.connect else "INPUT and OUTPUT"
        raise ConfigError(f"expected {names}, got {len(arguments.files)} file names")
    cli.check_constraints(arguments, CONSTRAINTS)
    *inputs, video = arguments.files
    if arguments.scene is not None:
        from dvc.files import check_folder

        if not video.endswith((".y4m", ".mkv")):
            raise ConfigError(f"--scene reads OUTPUT again: it must be .y4m or .mkv, got {video}")
        check_folder(arguments.scene)
    outputs = [video, arguments.punctured, arguments.side_information_video, arguments.json]
    inputs += [arguments.reference] if arguments.reference else []
    cli.check_outputs(inputs, [name for name in outputs if name not in (None, "-")])


def selected_frames(frames: slice, num_frames: int) -> range:
    """Return the display positions that `--frames` selects."""
    selected = range(num_frames)[frames]
    if not selected:
        given = "".join("" if number is None else str(number) for number in (frames.start, ":", frames.stop))
        raise ConfigError(f"--frames {given} holds no frame; the stream has {num_frames}, counted from 0")
    return selected


def protection(arguments: argparse.Namespace) -> "Protection":
    """Return the protection of the connection."""
    from dvc.feedback import Protection, read_token
    from dvc.feedback.protection import decoder_context, parse_fingerprint

    token = b"" if arguments.token_file is None else read_token(arguments.token_file)
    fingerprint = None if arguments.fingerprint is None else parse_fingerprint(arguments.fingerprint)
    has_tls = arguments.tls_ca is not None or fingerprint is not None
    tls = decoder_context(arguments.tls_ca) if has_tls else None
    return Protection(tls, token, fingerprint, arguments.insecure)


def limits(arguments: argparse.Namespace) -> "Limits":
    """Return the resource limits."""
    from dvc.limits import Limits

    return Limits(arguments.max_frames, arguments.max_memory)


def with_choices(config: "CodecConfig", arguments: argparse.Namespace) -> "CodecConfig":
    """Replace settings of the stream by those of the command line."""
    method = arguments.side_information
    if method is not None:
        from decoder.side_information.methods import METHODS

        if method not in METHODS:
            raise ConfigError(f"--side-information: {METHODS.missing(repr(method))}")
    prediction = {"method": method}
    prediction |= {name: getattr(arguments, name) for name in ("track_corrections", "fallback")}
    geometry = {"backend": arguments.sfm, "path_regularity": arguments.path_regularity}

    def _replaced(section: Section, values: dict[str, Any]) -> Section:
        return replace(section, **{name: value for name, value in values.items() if value is not None})

    return replace(
        config,
        side_information=_replaced(config.side_information, prediction),
        geometry=_replaced(config.geometry, geometry),
    )


def choices(config: "CodecConfig") -> str:
    """Format the settings that a punctured stream was made with."""
    prediction, geometry = config.side_information, config.geometry
    corrections = "--track-corrections" if prediction.track_corrections else "--no-track-corrections"
    return (
        f"{prediction.method} (--sfm {geometry.backend} --path-regularity {geometry.path_regularity:g}"
        f" {corrections} --fallback {prediction.fallback})"
    )
