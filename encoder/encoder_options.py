"""Options of `dvc-encode`, and the encoder session that they describe."""

import argparse
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

from dvc import cli, config
from dvc.errors import ConfigError
from encoder.rate_limits import TOLERANCE, WINDOW_S

PROG = "dvc-encode"
EXAMPLES = """\
  dvc-encode street.mkv street.dvc                    the best codec at the usual quality
  dvc-encode street.mkv street.dvc --qp 24            finer; each 6 about halve the error
  dvc-encode video.mp4 out.dvc --gop 10 --points 100 --lost-tracks 0.4 --luma-only --frames 101
  dvc-encode street.mkv street.dvc --no-feedback      a small file, without a feedback channel
  dvc-encode video.mp4 out.dvc --codec 2d             every second frame predicted by block motion
  dvc-encode raw.yuv out.dvc --size 176x144 --frame-rate 15 --key-qp lossless
  dvc-encode rtsp://camera/main day-%04d.dvc --segment 60    a file a minute; Ctrl-C finishes the last
  ffmpeg -i in.ts -pix_fmt yuv420p -f yuv4mpegpipe - | dvc-encode - out.dvc --input-format y4m
  dvc-encode street.mkv --serve 127.0.0.1:5000        wait for `dvc-decode --connect 127.0.0.1:5000 OUT`
  dvc-encode /dev/video0 --serve 0.0.0.0:5000 --tls-cert cert.pem --leave-out    through a network
"""

KEY_FRAMES = ("predicted", "intra")

Value = Callable[[config.CodecVariant], object]
"""A setting of a variant."""


def _of_groups(value: Callable[[config.GroupPreset], object]) -> Value:
    """Return a setting that depends on references and key frames, as text."""

    def _text(variant: config.CodecVariant) -> str:
        usual, keys, intra = (
            str(value(groups)).removesuffix(".0")
            for groups in (variant.groups(), variant.groups("keys"), variant.groups(intra_period=0))
        )
        exceptions = [f"{keys} if only key frames are references"] * (keys != usual)
        exceptions += [f"{intra} with --key-frames intra"] * (intra != usual)
        return f"{usual} ({', '.join(exceptions)})" if exceptions else usual

    return _text


RULE_FIELDS = {
    "longest_track": "longest_track_px",
    "lost_tracks": "lost_share",
    "min_gop": "min_length",
    "scene_change": "cut_share",
}
"""Fields of the rule that ends a GOP by its tracks, by option."""


def _of_rule(option: str) -> Value:
    return _of_groups(lambda groups: getattr(groups.key_frames, RULE_FIELDS[option]))


class _TrackOption(NamedTuple):
    """An option of codecs that send points of the geometry; the variant sets its default."""

    name: str
    read: Callable[[str], object]
    metavar: str
    default: Value
    text: str
    tracked: bool = True  # requires a codec with an encoder that tracks points


_POINTS, _LENGTH = cli.integer(1, config.MAX_POINTS), cli.integer(1, config.MAX_GOP_LENGTH)
_TRACK_OPTIONS = (
    _TrackOption("--points", _POINTS, "N", lambda variant: variant.tracks.num_points,
        "most tracks of a GOP, or corners of a frame", tracked=False),
    _TrackOption("--subpixel", cli.integer(0, 3), "BITS", lambda variant: variant.tracks.subpixel_bits,
        "track to 1/2, 1/4 or 1/8 of a pixel, or to whole ones (0)", tracked=False),
    _TrackOption("--longest-track", float, "PX", _of_rule("longest_track"),
        "end a GOP when a point has moved this distance"),
    _TrackOption("--lost-tracks", float, "SHARE", _of_rule("lost_tracks"),
        "end a GOP when this share of the points is lost"),
    _TrackOption("--min-gop", _LENGTH, "N", _of_rule("min_gop"),
        "least frames of a GOP, unless the scene changes"),
    _TrackOption("--scene-change", float, "SHARE", _of_rule("scene_change"),
        "points lost from one frame to the next that make both key frames, the second an IDR picture"),
    _TrackOption("--tracks-bpp", float, "BITS", lambda _: config.MAX_TRACKS_BPP,
        "most bits of tracks per pixel of the frames between the ends of a group: the best are kept"),
    _TrackOption("--new-tracks", cli.integer(0, config.MAX_POINTS), "N", lambda _: config.MAX_NEW_TRACKS,
        "most new tracks: points that are followed back from the closing key frame of a GOP"),
)  # fmt: skip


def _with_points(tracked: bool) -> list[str]:
    """List the codecs that send points, or only those with an encoder that tracks them."""
    kinds = ("encoder",) if tracked else ("encoder", "decoder")
    return [name for name, variant in config.VARIANTS.items() if variant.tracks.kind in kinds]


_LIMITS = ("--bitrate", "--max-bits-per-frame")
CONSTRAINTS = (
    cli.Constraint("--segment", ("OUTPUT",)),
    *(
        cli.Constraint(option, ("--serve",))
        for option in ("--token-file", "--insecure", "--tls-cert", "--tls-key", "--queue", "--leave-out")
    ),
    cli.Constraint("--tls-key", ("--tls-cert",)),
    cli.Constraint("--no-feedback", excludes=("--serve",), why="a decoder that is served sends requests"),
    cli.Constraint(
        "--no-feedback",
        excludes=tuple(f"--coder {name}" for name in config.CODERS if name != config.DEFAULT_CODER),
        why="no bit planes are coded",
    ),
    *(
        cli.Constraint(
            option, ("--serve", "--no-feedback"), why="a file with all planes has no rate until it is decoded"
        )
        for option in _LIMITS
    ),
    *(
        cli.Constraint(option, excludes=("--key-qp", "--wz-q"), why="it adapts the quality")
        for option in _LIMITS
    ),
    cli.Constraint("--bitrate", excludes=("--qp",), why="it adapts the quality"),
    cli.Constraint("--qp", excludes=("--wz-q",), why="both set the quality"),
    cli.Constraint("--intra-period", excludes=("--key-frames intra",)),
    *(
        cli.Constraint(option.name, tuple(f"--codec {name}" for name in _with_points(option.tracked)))
        for option in _TRACK_OPTIONS
    ),
)
"""Options that require or exclude other ones."""


def parser() -> argparse.ArgumentParser:
    """Build the parser."""
    top = cli.ArgumentParser(PROG, "Encode a video for distributed decoding.", EXAMPLES)
    top.add_argument(
        "input",
        metavar="INPUT",
        help="any video that FFmpeg reads, raw 4:2:0, or a folder of images; - for standard input; a camera"
        " (/dev/video0) or an address (rtsp://...)",
    )
    top.add_argument(
        "output",
        metavar="OUTPUT",
        nargs="?",
        help="stream to write (.dvc), complete or not at all: without --no-feedback it holds all planes, a"
        " few percent of the raw video, and `dvc-decode --punctured` keeps the bits that a decoder needs; a"
        " kill leaves OUTPUT.part, for `dvc-decode --unfinished`",
    )
    coding = top.add_argument_group("coding")
    for add in (_add_coding, _add_quality, _add_delivery):
        add(coding)
    tracks = top.add_argument_group(f"points and tracks ({', '.join(_with_points(tracked=False))})")
    for name, read, metavar, default, text, tracked in _TRACK_OPTIONS:
        usual = _defaults(default, _with_points(tracked))
        tracks.add_argument(name, type=read, metavar=metavar, help=f"{text}; {usual}")
    _add_source(top.add_argument_group("input"))
    top.add_argument_group("long recordings").add_argument(
        "--segment",
        type=cli.parse_positive,
        metavar="SECONDS",
        help="write one complete stream for each segment of this length: OUTPUT is a pattern such as"
        " day-%%04d.dvc, and numbers continue after those that exist; the unfinished segment has .part after"
        " its name, and its finished groups of pictures are on the disk",
    )
    _add_live(top.add_argument_group("live"))
    top.add_argument(
        "--json", metavar="FILE", help="write counts, bits and processor times (-: standard output)"
    )
    top.add_argument("--quiet", action="store_true", help="no progress bar")
    return top


def _defaults(value: Value, codecs: Iterable[str]) -> str:
    """Return the text of the default of an option, for each codec if they differ."""
    names: dict[object, list[str]] = {}
    for codec in codecs:
        names.setdefault(value(config.VARIANTS[codec]), []).append(codec)
    if len(names) == 1:
        return f"default: {next(iter(names))}"
    return "default: " + "; ".join(f"{default} with {' and '.join(some)}" for default, some in names.items())


def _add_coding(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--codec",
        choices=config.VARIANTS,
        default=config.DEFAULT_CODEC,
        help="prediction of frames: "
        + "; ".join(f"{name}: {variant.summary}" for name, variant in config.VARIANTS.items())
        + "; default: %(default)s",
    )
    cli.add_integer(
        group,
        "--gop",
        (1, config.MAX_GOP_LENGTH),
        f"frames of a GOP, the most with {', '.join(_with_points(tracked=True))}; a key frame ends it; "
        + _defaults(_of_groups(lambda groups: groups.length), config.VARIANTS),
    )
    group.add_argument(
        "--references",
        choices=config.REFERENCES,
        help="references of predicted frames: the key frames; also the middle frame, which is decoded first,"
        " and further middle frames; or all decoded frames of the GOP; "
        + _defaults(lambda variant: variant.references, config.VARIANTS),
    )
    group.add_argument(
        "--key-frames",
        choices=KEY_FRAMES,
        help="H.264 pictures that are predicted from earlier ones, or intra pictures; "
        + _defaults(lambda variant: KEY_FRAMES[not variant.intra_period], config.VARIANTS)
        + ", intra with --wz-q",
    )
    cli.add_integer(
        group,
        "--intra-period",
        (1, config.MAX_INTRA_PERIOD),
        "most frames from one IDR picture to the next if key frames are predicted: decoding can begin at"
        f" an IDR picture, and damage ends there; default: {config.INTRA_PERIOD}",
        metavar="N",
    )


def _add_quality(group: argparse._ArgumentGroup) -> None:
    quality = (
        "quality on H.264's scale, 1 (fine) to 51 (coarse): sets key frames, steps and requested planes for"
        f" the least rate; default: {config.DEFAULT_QP}"
    )
    cli.add_integer(group, "--qp", (1, config.MAX_QP), quality, metavar="QP")
    matrix = (
        "instead of --qp, a DISCOVER quantisation matrix, 1 (coarse) to 8 (fine); all planes are requested"
    )
    cli.add_integer(group, "--wz-q", (1, 8), matrix, metavar="Q")
    group.add_argument(
        "--key-qp",
        type=_parse_key_qp,
        metavar="QP",
        help="1 to 51, lossless, or auto: the QP that suits --qp or --wz-q; default: auto",
    )


def _add_delivery(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--coder",
        choices=config.CODERS,
        default=config.DEFAULT_CODER,
        help="codes of the bit planes: parities of ranges that the decoder chooses, or punctured turbo codes"
        " as in the thesis; default: %(default)s",
    )
    group.add_argument("--luma-only", action="store_true", help="code no chroma")
    group.add_argument(
        "--noise-model",
        choices=config.NOISE_MODELS,
        default=config.WynerZivConfig.noise_model,
        help="correlation noise model of the decoder; default: %(default)s",
    )
    group.add_argument(
        "--no-feedback",
        action="store_true",
        help="send only key frames and tracks, for a camera without a feedback channel: the decoder predicts"
        " the other frames; with 3d-te key frames are as close as prediction needs",
    )
    group.add_argument(
        "--bitrate",
        type=cli.parse_bits,
        metavar="BITS",
        help="instead of --qp, with --no-feedback or --serve: bits per second of video, such as 300k or 1.5M;"
        f" groups of pictures that last {WINDOW_S:g} s keep it within {100 * TOLERANCE:g} percent if some"
        " quality does; requests of a decoder are forecast from earlier ones, and errors corrected later",
    )
    group.add_argument(
        "--max-bits-per-frame",
        type=cli.parse_bits,
        metavar="BITS",
        help="with --no-feedback or --serve: larger key frames are coded again, coarser; the limit also holds"
        " for the mean of the bits that a decoder may request for the frames between two key frames",
    )
    cli.add_integer(group, "--seed", (0, 2**31 - 1), "seed of everything random", default=0, metavar="S")


def _add_source(group: argparse._ArgumentGroup) -> None:
    cli.add_integer(group, "--start", (0, 10**9), "first frame to code", default=0, metavar="K")
    cli.add_integer(group, "--frames", (1, 10**9), "number of frames to code; default: all")
    group.add_argument(
        "--size", type=cli.parse_size, metavar="WxH", help="picture size of raw files and raw standard input"
    )
    group.add_argument(
        "--input-format",
        metavar="FORMAT",
        help="format of INPUT, as FFmpeg names it, if it cannot be detected: y4m, mjpeg, v4l2, ...; raw:"
        " planar 4:2:0, the default for a pipe if --size is given",
    )
    group.add_argument(
        "--listen",
        action="store_true",
        help="INPUT is an address of this machine (rtsp, rtmp, http, tcp) that the source connects to",
    )
    group.add_argument(
        "--frame-rate",
        type=cli.parse_frame_rate,
        metavar="R",
        help="frames per second, such as 30 or 30000/1001; required for raw files; overrides the rate and the"
        " time stamps of other files",
    )


def _add_live(group: argparse._ArgumentGroup) -> None:
    text = (
        "answer one decoder over TCP instead of writing a file (no HOST: on this machine only; 0.0.0.0: on"
        " all its networks, with TLS; port 0: any free one)"
    )
    cli.add_live(group, "--serve", text)
    cli.add_integer(
        group,
        "--queue",
        (1, 10**6),
        "longest queue of frames of a camera, a pipe or an address for a slower decoder (default: 64, fewer"
        " if they are larger than 1920x1080, but at least a GOP)",
        metavar="FRAMES",
    )
    group.add_argument(
        "--tls-cert",
        metavar="FILE",
        help="use TLS with this certificate (PEM: the chain, and the key unless --tls-key is given)",
    )
    group.add_argument("--tls-key", metavar="FILE", help="key of the certificate")
    group.add_argument(
        "--leave-out",
        action="store_true",
        help="when the queue is full, leave out frames by whole groups, and count them; default: the source"
        " waits",
    )


def check(arguments: argparse.Namespace) -> None:
    """Refuse options that contradict each other, before anything is opened."""
    from encoder.segments import CONVERSION, segment_names

    if (arguments.output is None) == (arguments.serve is None):
        raise ConfigError("give either OUTPUT or --serve HOST:PORT")
    cli.check_constraints(arguments, CONSTRAINTS)
    if arguments.segment is not None:
        segment_names(arguments.output)
    elif arguments.output is not None and CONVERSION.search(Path(arguments.output).name):
        raise ConfigError(f"an output such as {arguments.output} requires --segment")


def _parse_key_qp(text: str) -> dict[str, Any] | None:
    """Read the quality of key frames as fields of their configuration; None: the one that suits the rest."""
    if text == "auto":
        return None
    if text in ("lossless", "0"):
        return {"lossless": True}
    if text.isdecimal() and int(text) <= config.MAX_QP:
        return {"qp": int(text)}
    raise argparse.ArgumentTypeError(f"expected 1 to {config.MAX_QP}, lossless or auto, got {text!r}")
