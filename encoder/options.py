"""The options of `dvc-encode`: defaults are those of the codec's variant, and a session comes out of them."""

import argparse
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from dvc import cli
from dvc.config import (
    CODERS,
    DEFAULT_CODEC,
    DEFAULT_CODER,
    DEFAULT_QP,
    INTRA_PERIOD,
    MAX_GOP_LENGTH,
    MAX_INTRA_PERIOD,
    MAX_NEW_TRACKS,
    MAX_POINTS,
    MAX_QP,
    MAX_TRACKS_BPP,
    NOISE_MODELS,
    REFERENCES,
    VARIANTS,
    CodecConfig,
    CodecVariant,
    CoderConfig,
    Delivery,
    DiscoverMatrix,
    GroupPreset,
    KeyFrameRule,
    Live,
    NoFeedback,
    ParityBuffer,
    Qp,
    Quality,
    VideoConfig,
    WynerZivConfig,
    codec_config,
)
from dvc.errors import ConfigError
from encoder.rate_limits import TOLERANCE, WINDOW_S, RateLimits

if TYPE_CHECKING:
    from dvc.feedback import Protection
    from dvc.video import Frame, VideoInfo
    from encoder.frame_queue import FrameQueue
    from encoder.session import EncoderSession
    from encoder.time_stamps import CodingClock

PROG = "dvc-encode"
EXAMPLES = """\
  dvc-encode street.mkv street.dvc                    the best codec at the usual quality
  dvc-encode street.mkv street.dvc --qp 24            finer; each 6 about halve the error
  dvc-encode video.mp4 out.dvc --gop 10 --points 100 --lost-tracks 0.4 --luma-only --frames 101
  dvc-encode street.mkv street.dvc --no-feedback      a small file, where there is no feedback channel
  dvc-encode video.mp4 out.dvc --codec 2d             every second frame predicted by block motion
  dvc-encode raw.yuv out.dvc --size 176x144 --frame-rate 15 --key-qp lossless
  dvc-encode rtsp://camera/main day-%04d.dvc --segment 60    a file a minute; Ctrl-C finishes the last
  ffmpeg -i in.ts -pix_fmt yuv420p -f yuv4mpegpipe - | dvc-encode - out.dvc --input-format y4m
  dvc-encode street.mkv --serve 127.0.0.1:5000        wait for `dvc-decode --connect 127.0.0.1:5000 OUT`
  dvc-encode /dev/video0 --serve 0.0.0.0:5000 --tls-cert cert.pem --leave-out    through a network
"""

KEY_FRAMES = ("predicted", "intra")

Value = Callable[[CodecVariant], object]
"""A setting of a variant."""


class _TrackOption(NamedTuple):
    """An option for codecs that send points of the geometry; where it is not given the variant decides."""

    name: str
    read: Callable[[str], object]
    metavar: str
    text: str
    default: Value
    of_rule: str = ""  # field of the rule by which tracks set key frames
    tracked: bool = True  # only for codecs whose encoder tracks points


def _of_groups(value: Callable[[GroupPreset], object]) -> Value:
    """Return a setting that depends on references and key frames."""

    def _shown(variant: CodecVariant) -> str:
        usual, keys, intra = (
            str(value(groups)).removesuffix(".0")
            for groups in (variant.groups(), variant.groups("keys"), variant.groups(intra_period=0))
        )
        others = [f"{keys} if only key frames are references"] * (keys != usual)
        others += [f"{intra} with --key-frames intra"] * (intra != usual)
        return f"{usual} ({', '.join(others)})" if others else usual

    return _shown


def _rule_option(
    name: str, field: str, read: Callable[[str], object], metavar: str, text: str
) -> _TrackOption:
    return _TrackOption(
        name, read, metavar, text, _of_groups(lambda groups: getattr(groups.key_frames, field)), field
    )


_TRACK_OPTIONS = (
    _TrackOption(
        "points",
        cli.integer(1, MAX_POINTS),
        "N",
        "most tracks of a GOP, or corners of a frame",
        lambda variant: variant.tracks.num_points,
        tracked=False,
    ),
    _TrackOption(
        "subpixel",
        cli.integer(0, 3),
        "BITS",
        "track to 1/2, 1/4 or 1/8 of a pixel, or to whole ones (0)",
        lambda variant: variant.tracks.subpixel_bits,
        tracked=False,
    ),
    _rule_option("longest-track", "longest_track_px", float, "PX", "end a GOP when a point has moved so far"),
    _rule_option(
        "lost-tracks", "lost_share", float, "SHARE", "end a GOP when this share of the points is lost"
    ),
    _rule_option(
        "min-gop",
        "min_length",
        cli.integer(1, MAX_GOP_LENGTH),
        "N",
        "least frames of a GOP, but where the scene changes",
    ),
    _rule_option(
        "scene-change",
        "cut_share",
        float,
        "SHARE",
        "points lost from one frame to the next that make both key frames, the second an IDR picture",
    ),
    _TrackOption(
        "tracks-bpp",
        float,
        "BITS",
        "most bits of tracks per pixel of the frames between the ends of a group: the best are kept",
        lambda _: MAX_TRACKS_BPP,
    ),
    _TrackOption(
        "new-tracks",
        cli.integer(0, MAX_POINTS),
        "N",
        "most new tracks: points that are followed back from the closing key frame of a GOP",
        lambda _: MAX_NEW_TRACKS,
    ),
)


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
        help="stream to write (.dvc), complete or not at all: unless --no-feedback, it holds all planes, a"
        " few percent of the raw video, and `dvc-decode --punctured` keeps what is needed of it; a kill"
        " leaves OUTPUT.part, for `dvc-decode --unfinished`",
    )
    _add_coding(top.add_argument_group("coding"))
    _add_tracks(top.add_argument_group(f"points and tracks ({', '.join(_with_points(tracked=False))})"))
    _add_source(top.add_argument_group("input"))
    top.add_argument_group("long recordings").add_argument(
        "--segment",
        type=cli.parse_positive,
        metavar="SECONDS",
        help="write a stream for every so many seconds of video, each complete by itself: OUTPUT is a pattern"
        " such as day-%%04d.dvc, numbers go on after those that exist; the one in the making has .part after"
        " its name, and what is finished of it is on the disk",
    )
    _add_live(top.add_argument_group("live"))
    top.add_argument(
        "--json", metavar="FILE", help="write counts, bits and processor times (-: standard output)"
    )
    top.add_argument("--quiet", action="store_true", help="no progress bar")
    return top


def _with_points(tracked: bool) -> list[str]:
    """List the codecs that send points, or only those whose encoder tracks them."""
    kinds = ("encoder",) if tracked else ("encoder", "decoder")
    return [name for name, variant in VARIANTS.items() if variant.tracks.kind in kinds]


def _defaults(value: Value, codecs: Iterable[str]) -> str:
    """Tell the default of an option, codec by codec where they differ."""
    names: dict[object, list[str]] = {}
    for codec in codecs:
        names.setdefault(value(VARIANTS[codec]), []).append(codec)
    if len(names) == 1:
        return f"default: {next(iter(names))}"
    return "default: " + "; ".join(f"{default} with {' and '.join(of)}" for default, of in names.items())


def _add_coding(group: argparse._ArgumentGroup) -> None:
    add = group.add_argument
    add(
        "--codec",
        choices=VARIANTS,
        default=DEFAULT_CODEC,
        help="what predicts frames: "
        + "; ".join(f"{name}: {variant.summary}" for name, variant in VARIANTS.items())
        + "; default: %(default)s",
    )
    _add_groups(group)
    _add_quality(group)
    add(
        "--coder",
        choices=CODERS,
        default=DEFAULT_CODER,
        help="codes of the bit planes, where a decoder asks: parities of ranges that it chooses, or punctured"
        " turbo codes as in the thesis; default: %(default)s",
    )
    add("--luma-only", action="store_true", help="code no chroma")
    add(
        "--noise-model",
        choices=NOISE_MODELS,
        default=WynerZivConfig.noise_model,
        help="correlation noise model of the decoder; default: %(default)s",
    )
    _add_delivery(group)
    cli.add_integer(group, "--seed", (0, 2**31 - 1), "seed of everything random", default=0, metavar="S")


def _add_groups(group: argparse._ArgumentGroup) -> None:
    cli.add_integer(
        group,
        "--gop",
        (1, MAX_GOP_LENGTH),
        f"frames of a GOP, with {', '.join(_with_points(tracked=True))} the most; a key frame ends it; "
        + _defaults(_of_groups(lambda groups: groups.length), VARIANTS),
    )
    group.add_argument(
        "--references",
        choices=REFERENCES,
        help="what frames are predicted from: the key frames; the middle one too, decoded first, and so on;"
        " or all frames of the GOP that are decoded; "
        + _defaults(lambda variant: variant.references, VARIANTS),
    )
    group.add_argument(
        "--key-frames",
        choices=KEY_FRAMES,
        help="H.264 pictures that are predicted from earlier ones, or intra pictures, each of which stands"
        " alone; "
        + _defaults(lambda variant: KEY_FRAMES[not variant.intra_period], VARIANTS)
        + ", intra with --wz-q",
    )
    cli.add_integer(
        group,
        "--intra-period",
        (1, MAX_INTRA_PERIOD),
        "most frames from one IDR picture to the next if key frames are predicted: decoding can begin at any,"
        f" and damage ends there; default: {INTRA_PERIOD}",
        metavar="N",
    )


def _add_quality(group: argparse._ArgumentGroup) -> None:
    quality = (
        "quality on H.264's scale, 1 (fine) to 51 (coarse): key frames, steps and what is asked for,"
        f" set together for the least rate; default: {DEFAULT_QP}"
    )
    cli.add_integer(group, "--qp", (1, MAX_QP), quality, metavar="QP")
    matrix = (
        "in place of --qp, a DISCOVER quantisation matrix, 1 (coarse) to 8 (fine); all planes are asked for"
    )
    cli.add_integer(group, "--wz-q", (1, 8), matrix, metavar="Q")
    group.add_argument(
        "--key-qp",
        default="auto",
        metavar="QP",
        help="1 to 51, lossless, or auto: whatever suits --qp or --wz-q; default: %(default)s",
    )


def _add_delivery(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--no-feedback",
        action="store_true",
        help="for a camera without a feedback channel: frames between key frames are predicted, and nothing"
        " is sent of them; with 3d-te key frames lie as close as prediction needs",
    )
    group.add_argument(
        "--bitrate",
        type=cli.parse_bits,
        metavar="BITS",
        help="in place of --qp, with --no-feedback or --serve: bits a second of video, such as 300k or 1.5M;"
        f" groups of pictures that last {WINDOW_S:g} s take as much within {100 * TOLERANCE:g} percent where"
        " quality can do that; what a decoder asks for is expected by what it did, and made up for later",
    )
    group.add_argument(
        "--max-bits-per-frame",
        type=cli.parse_bits,
        metavar="BITS",
        help="with --no-feedback or --serve: key frames that take more are coded again, coarser; of the"
        " others between two of them a decoder may ask for so much on the mean",
    )


def _add_tracks(group: argparse._ArgumentGroup) -> None:
    for option in _TRACK_OPTIONS:
        default = _defaults(option.default, _with_points(option.tracked))
        group.add_argument(
            f"--{option.name}", type=option.read, metavar=option.metavar, help=f"{option.text}; {default}"
        )


def _add_source(group: argparse._ArgumentGroup) -> None:
    cli.add_integer(group, "--start", (0, 10**9), "first frame to code", default=0, metavar="K")
    cli.add_integer(group, "--frames", (1, 10**9), "number of frames to code; default: all")
    group.add_argument(
        "--size", type=cli.parse_size, metavar="WxH", help="picture size of raw files and raw standard input"
    )
    group.add_argument(
        "--input-format",
        metavar="FORMAT",
        help="what INPUT is, in FFmpeg's words, where that cannot be told from it: y4m, mjpeg, v4l2, ...;"
        " raw: planar 4:2:0, which a pipe is taken for where --size is given",
    )
    group.add_argument(
        "--listen",
        action="store_true",
        help="INPUT is an address of this machine (rtsp, rtmp, http, tcp), to which the source connects",
    )
    group.add_argument(
        "--frame-rate",
        type=cli.parse_frame_rate,
        metavar="R",
        help="frames per second, such as 30 or 30000/1001; needed for raw files; in place of the rate and the"
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
    """Refuse outputs that make no sense, before anything is opened."""
    if (arguments.output is None) == (arguments.serve is None):
        raise ConfigError("give either OUTPUT or --serve HOST:PORT")
    cli.check_live(arguments, "--serve", "--token-file", "--insecure", "--tls-cert", "--tls-key")
    if arguments.segment is not None:
        if arguments.serve is not None:
            raise ConfigError("--segment is for files, not for --serve")
        from encoder.segments import segment_names

        segment_names(arguments.output)
    elif arguments.output is not None and "%" in arguments.output:
        from encoder.segments import CONVERSION

        if CONVERSION.search(Path(arguments.output).name):
            raise ConfigError(f"names such as {arguments.output} are for --segment")


def protection(arguments: argparse.Namespace) -> "Protection":
    """Return the protection of the connection."""
    from dvc.feedback import Protection, read_token
    from dvc.feedback.protection import encoder_context

    if arguments.tls_key is not None and arguments.tls_cert is None:
        raise ConfigError("--tls-key requires --tls-cert")
    token = b"" if arguments.token_file is None else read_token(arguments.token_file)
    tls = None if arguments.tls_cert is None else encoder_context(arguments.tls_cert, arguments.tls_key)
    return Protection(tls, token, insecure=arguments.insecure)


def queue(
    frames: "Iterable[Frame]", arguments: argparse.Namespace, live: bool, config: "CodecConfig"
) -> "FrameQueue | None":
    """Return the queue of a live source for a slower decoder; a file waits by itself."""
    from encoder.frame_queue import FrameQueue, default_frames

    if arguments.serve is None or not live:
        for option, value in (("--leave-out", arguments.leave_out), ("--queue", arguments.queue)):
            if value:
                raise ConfigError(f"{option} requires --serve and a camera, a pipe or an address as INPUT")
        return None
    length, video = config.gop.length, config.video
    max_frames = arguments.queue or default_frames(video.width * video.height, length)
    if arguments.leave_out and max_frames < length:
        raise ConfigError(f"--leave-out requires a queue that holds a group: --queue {length} or more")
    return FrameQueue(frames, max_frames, length if arguments.leave_out else 0)


def session(
    arguments: argparse.Namespace, info: "VideoInfo", clock: "CodingClock | None" = None
) -> "EncoderSession":
    """Set up an encoder as the arguments say."""
    from encoder.point_tracker import PointTrackerSettings
    from encoder.session import EncoderSession

    for option in _TRACK_OPTIONS:
        codecs = _with_points(option.tracked)
        if _value(arguments, option) is not None and arguments.codec not in codecs:
            raise ConfigError(f"--{option.name} is for {' and '.join(codecs)}, not {arguments.codec}")
    bits_per_pixel = MAX_TRACKS_BPP if arguments.tracks_bpp is None else arguments.tracks_bpp
    if not bits_per_pixel > 0:
        raise ConfigError(f"--tracks-bpp must be above 0, got {bits_per_pixel}")
    tracking = PointTrackerSettings(**_given(max_new_tracks=arguments.new_tracks))
    delivery = _delivery(arguments)
    config = _configuration(arguments, info)
    limits = RateLimits(arguments.bitrate, arguments.max_bits_per_frame)
    rule = _rule(arguments, config)
    return EncoderSession(config, delivery, rule, bits_per_pixel, tracking, clock, limits)


def _quality(arguments: argparse.Namespace) -> Quality:
    limited = arguments.bitrate is not None or arguments.max_bits_per_frame is not None
    if limited and arguments.key_qp != "auto":
        raise ConfigError("--bitrate and --max-bits-per-frame choose the QP of key frames: no --key-qp")
    for option, value in (("--qp", arguments.qp), ("--wz-q", arguments.wz_q)):
        if arguments.bitrate is not None and value is not None:
            raise ConfigError(f"--bitrate chooses the quality: give it or {option}")
    if arguments.wz_q is None:
        return Qp(**_given(qp=arguments.qp))
    if arguments.qp is not None:
        raise ConfigError("--qp and --wz-q are two ways to set the quality: give one")
    return DiscoverMatrix(arguments.wz_q)


def _delivery(arguments: argparse.Namespace) -> Delivery:
    if arguments.no_feedback:
        if arguments.serve is not None:
            raise ConfigError("--no-feedback and --serve exclude each other: a decoder that is served asks")
        return NoFeedback()
    return ParityBuffer() if arguments.serve is None else Live()


def _configuration(arguments: argparse.Namespace, info: "VideoInfo") -> CodecConfig:
    """Put options in the place of what codec and quality mean together."""
    rate, quality = info.frame_rate, _quality(arguments)
    return codec_config(
        VideoConfig(info.width, info.height, rate.numerator, rate.denominator, arguments.luma_only),
        arguments.codec,
        quality,
        gop=_given(length=arguments.gop, references=arguments.references),
        key=_key(arguments) | _given(intra_period=_intra_period(arguments)),
        wyner_ziv={"noise_model": arguments.noise_model},
        coder=_coder(arguments),
        tracks=_given(num_points=arguments.points, subpixel_bits=arguments.subpixel),
        seed=arguments.seed,
    )


def _intra_period(arguments: argparse.Namespace) -> int | None:
    period: int | None = arguments.intra_period
    if period is not None and arguments.key_frames == "intra":
        raise ConfigError("--intra-period is for --key-frames predicted")
    if arguments.key_frames == "intra":
        return 0
    return INTRA_PERIOD if period is None and arguments.key_frames == "predicted" else period


def _coder(arguments: argparse.Namespace) -> CoderConfig:
    if arguments.no_feedback and arguments.coder != DEFAULT_CODER:
        raise ConfigError("--coder is not for --no-feedback: nothing is coded by it")
    return CODERS[arguments.coder]()


def _key(arguments: argparse.Namespace) -> dict[str, Any]:
    if arguments.key_qp == "auto":
        return {}
    if arguments.key_qp in ("lossless", "0"):
        return {"lossless": True}
    if arguments.key_qp.isdecimal():
        return {"qp": int(arguments.key_qp)}
    raise ConfigError(f"--key-qp must be 1 to 51, lossless or auto, got {arguments.key_qp!r}")


def _rule(arguments: argparse.Namespace, config: CodecConfig) -> KeyFrameRule:
    given = _given(
        **{option.of_rule: _value(arguments, option) for option in _TRACK_OPTIONS if option.of_rule}
    )
    groups = VARIANTS[arguments.codec].groups(config.gop.references, config.key.intra_period)
    return replace(groups.key_frames, **given)


def _value(arguments: argparse.Namespace, option: _TrackOption) -> object:
    return getattr(arguments, option.name.replace("-", "_"))


def _given(**options: Any) -> dict[str, Any]:
    return {name: value for name, value in options.items() if value is not None}
