"""Command `dvc-encode`: code a video into a stream, or serve it to a decoder that asks for parity."""

import argparse
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from dvc import cli
from dvc.config import (
    CODECS,
    MAX_POINTS,
    NOISE_MODELS,
    REFERENCES,
    TURBO_FAMILIES,
    CodecConfig,
    GopConfig,
    KeyFrameConfig,
    TracksConfig,
    TurboConfig,
    VideoConfig,
    WynerZivConfig,
    gop_for,
    key_qp_for,
    side_information_for,
    tracks_for,
)
from dvc.errors import ConfigError

if TYPE_CHECKING:
    from dvc.video import VideoInfo, VideoReader
    from encoder.block_matching import PointTrackerSettings
    from encoder.groups import KeyFrameRule
    from encoder.report import EncoderStatistics
    from encoder.session import EncoderSession, Progress

PROG = "dvc-encode"
EXAMPLES = """\
  dvc-encode street.mkv street.dvc --wz-q 4           every second frame Wyner-Ziv coded, quantiser preset 4
  dvc-encode video.mp4 out.dvc --gop 4 --references hierarchical --luma-only --frames 101
  dvc-encode video.mp4 out.dvc --codec 3d-te --gop 10 --points 100 --lost-tracks 0.4
  dvc-encode raw.yuv out.dvc --size 176x144 --frame-rate 15 --key-qp lossless
  dvc-encode street.mkv --serve 127.0.0.1:5000        wait for `dvc-decode --connect 127.0.0.1:5000 OUT`
"""


def _parser() -> argparse.ArgumentParser:
    parser = cli.ArgumentParser(PROG, "Encode a video for distributed decoding.", EXAMPLES)
    parser.add_argument(
        "input", metavar="INPUT", help="any video that FFmpeg reads, raw 4:2:0, or a folder of images"
    )
    parser.add_argument("output", metavar="OUTPUT", nargs="?", help="stream to write (.dvc)")
    _add_coding(parser.add_argument_group("coding"))
    _add_tracks(parser.add_argument_group("points and tracks (3d-td, 3d-te)"))
    _add_source(parser.add_argument_group("input"))
    _add_live(parser.add_argument_group("live"))
    parser.add_argument(
        "--json", metavar="FILE", help="write counts, bits and processor times (-: standard output)"
    )
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    return parser


def _add_coding(coding: argparse._ArgumentGroup) -> None:
    coding.add_argument(
        "--codec",
        choices=CODECS,
        default="2d",
        help="2d: predict by block motion; 3d: by a reconstruction of the scene; 3d-td: helped by corners of"
        " every frame; 3d-te: by tracks of points, which choose the key frames, too; default: %(default)s",
    )
    coding.add_argument(
        "--gop",
        type=cli.integer(1, 256),
        metavar="N",
        help="frames from one key frame to the next, with 3d-te the most of them; default: 2; 10 with 3d-td;"
        " 16 with 3d-te, 8 if only key frames are references",
    )
    coding.add_argument(
        "--references",
        choices=REFERENCES,
        help="what frames are predicted from: the key frames; the middle one too, decoded first, and so on;"
        " or all frames of the GOP that are decoded; default: keys; hierarchical with 3d-te and 3d-td",
    )
    coding.add_argument(
        "--wz-q",
        type=cli.integer(1, 8),
        default=4,
        metavar="Q",
        help="quantiser preset of the Wyner-Ziv frames, 1 (coarse) to 8 (fine); default: %(default)s",
    )
    coding.add_argument(
        "--key-qp",
        default="auto",
        metavar="QP",
        help="1 to 51, lossless, or auto: whatever suits preset Q; default: %(default)s",
    )
    coding.add_argument("--luma-only", action="store_true", help="code no chroma")
    coding.add_argument(
        "--turbo",
        choices=TURBO_FAMILIES,
        default="adaptive",
        help="family of turbo codes; default: %(default)s",
    )
    coding.add_argument(
        "--noise-model",
        choices=NOISE_MODELS,
        default="local",
        help="correlation noise model of the decoder; default: %(default)s",
    )
    coding.add_argument(
        "--seed",
        type=cli.integer(0, 2**31 - 1),
        default=0,
        metavar="S",
        help="seed of everything random; default: %(default)s",
    )


def _add_tracks(tracks: argparse._ArgumentGroup) -> None:
    tracks.add_argument(
        "--points",
        type=cli.integer(1, MAX_POINTS),
        metavar="N",
        help="most tracks of a GOP, or corners of a frame; default: 128, 176 with 3d-td",
    )
    tracks.add_argument(
        "--subpixel",
        type=cli.integer(0, 3),
        metavar="BITS",
        help="track to 1/2, 1/4 or 1/8 of a pixel, or to whole ones (0); default: 1 with 3d-te, 0 with 3d-td",
    )
    tracks.add_argument(
        "--longest-track",
        type=float,
        metavar="PX",
        help="set a key frame when a point has moved so far; default: 64, 40 if only key frames are"
        " references",
    )
    tracks.add_argument(
        "--lost-tracks",
        type=float,
        metavar="SHARE",
        help="set a key frame when this share of the points is lost; default: 0.6, 0.5 if only key frames are"
        " references",
    )
    tracks.add_argument(
        "--min-gop",
        type=cli.integer(1, 256),
        metavar="N",
        help="least frames from one key frame to the next, but where the scene changes; default: 2",
    )
    tracks.add_argument(
        "--key-frames",
        choices=("tracks", "rate"),
        help="end a GOP where tracks are long or lost, or where the estimated rate becomes least;"
        " default: tracks",
    )
    tracks.add_argument(
        "--scene-change",
        type=float,
        metavar="SHARE",
        help="points lost from one frame to the next that make both key frames; default: 0.9",
    )
    tracks.add_argument(
        "--tracks-bpp",
        type=float,
        metavar="BITS",
        help="most bits of tracks per pixel of the Wyner-Ziv frames: the best are kept; default: 0.01",
    )
    tracks.add_argument(
        "--births",
        type=cli.integer(0, MAX_POINTS),
        metavar="N",
        help="most points that are followed back from the closing key frame of a GOP; default: 48",
    )


def _add_source(source: argparse._ArgumentGroup) -> None:
    source.add_argument(
        "--start",
        type=cli.integer(0, 10**9),
        default=0,
        metavar="K",
        help="first frame to code; default: %(default)s",
    )
    source.add_argument(
        "--frames", type=cli.integer(1, 10**9), metavar="N", help="number of frames to code; default: all"
    )
    source.add_argument("--size", type=cli.parse_size, metavar="WxH", help="picture size of raw files")
    source.add_argument(
        "--frame-rate",
        type=cli.parse_frame_rate,
        metavar="R",
        help="frames per second, such as 30 or 30000/1001; needed for raw files",
    )


def _add_live(live: argparse._ArgumentGroup) -> None:
    live.add_argument(
        "--serve",
        metavar="HOST:PORT",
        help="answer one decoder over TCP instead of writing a file (port 0: any free one)",
    )
    live.add_argument(
        "--timeout",
        type=cli.integer(1, 86400),
        default=30,
        metavar="S",
        help="patience with a silent decoder, in seconds; default: %(default)s",
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments; those of the process by default.

    Returns
    -------
    int
        Exit status: 0, or 2 for bad input.
    """
    arguments = _parser().parse_args(argv)
    return cli.run(PROG, lambda: _encode(arguments))


def _encode(arguments: argparse.Namespace) -> int:
    from dvc.video import open_video
    from encoder.session import EncoderSession

    if (arguments.output is None) == (arguments.serve is None):
        raise ConfigError("give either OUTPUT or --serve HOST:PORT")
    outputs = [name for name in (arguments.output, arguments.json) if name not in (None, "-")]
    cli.check_outputs([arguments.input], outputs)
    with open_video(
        arguments.input,
        size=arguments.size,
        frame_rate=arguments.frame_rate,
        start=arguments.start,
        num_frames=arguments.frames,
    ) as reader:
        for notice in reader.info.notices:
            sys.stderr.write(f"{PROG}: {cli.one_line(notice)}\n")
        session = EncoderSession(
            _configure(arguments, reader.info), _rule(arguments), _tracks_bpp(arguments), _births(arguments)
        )
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
        sys.stderr.write(f"{PROG}: waiting for a decoder on {listener.name}\n")
        sys.stderr.flush()
        connection = listener.accept(silence_timeout_s=arguments.timeout)
    with connection, connection.kept_alive(KEEP_ALIVE):
        serve(session, reader, connection, progress)


def _configure(arguments: argparse.Namespace, info: "VideoInfo") -> CodecConfig:
    from dataclasses import replace

    if arguments.key_qp in ("lossless", "0"):
        key = KeyFrameConfig(lossless=True)
    elif arguments.key_qp == "auto":
        key = KeyFrameConfig(key_qp_for(arguments.wz_q))
    elif arguments.key_qp.isdecimal():
        key = KeyFrameConfig(int(arguments.key_qp))
    else:
        raise ConfigError(f"--key-qp must be 1 to 51, lossless or auto, got {arguments.key_qp!r}")
    rate = info.frame_rate
    return CodecConfig(
        codec=arguments.codec,
        video=VideoConfig(info.width, info.height, rate.numerator, rate.denominator, arguments.luma_only),
        gop=_gop(arguments),
        key=key,
        wyner_ziv=replace(WynerZivConfig.preset(arguments.wz_q), noise_model=arguments.noise_model),
        turbo=TurboConfig(family=arguments.turbo, interleaver_seed=arguments.seed),
        side_information=side_information_for(arguments.codec),
        tracks=_tracks(arguments),
        seed=arguments.seed,
    )


def _gop(arguments: argparse.Namespace) -> GopConfig:
    return gop_for(arguments.codec, arguments.gop, arguments.references)


def _tracks(arguments: argparse.Namespace) -> TracksConfig:
    from dataclasses import replace

    tracks = tracks_for(arguments.codec)
    given = {"num_points": arguments.points, "subpixel_bits": arguments.subpixel}
    given = {name: value for name, value in given.items() if value is not None}
    if given and tracks.kind == "none":
        raise ConfigError(f"--points and --subpixel are for 3d-td and 3d-te, not {arguments.codec}")
    return replace(tracks, **given)


def _rule(arguments: argparse.Namespace) -> "KeyFrameRule":
    from dataclasses import replace

    from encoder.groups import KeyFrameRule

    given = {
        "longest_track_px": arguments.longest_track,
        "lost_share": arguments.lost_tracks,
        "min_length": arguments.min_gop,
        "choice": arguments.key_frames,
        "cut_share": arguments.scene_change,
    }
    given = {name: value for name, value in given.items() if value is not None}
    if given and arguments.codec != "3d-te":
        raise ConfigError("options that choose key frames, as --longest-track or --key-frames, are for 3d-te")
    if arguments.key_frames == "rate" and not {"longest_track_px", "lost_share"}.isdisjoint(given):
        raise ConfigError("--longest-track and --lost-tracks are bounds of --key-frames tracks")
    return replace(KeyFrameRule.for_references(_gop(arguments).references), **given)


def _tracks_bpp(arguments: argparse.Namespace) -> float:
    from encoder.track_budget import MAX_TRACKS_BPP

    given: float | None = arguments.tracks_bpp
    if given is None:
        return MAX_TRACKS_BPP
    if arguments.codec != "3d-te":
        raise ConfigError("--tracks-bpp is for 3d-te")
    if not given > 0:
        raise ConfigError(f"--tracks-bpp must be above 0, got {given}")
    return given


def _births(arguments: argparse.Namespace) -> "PointTrackerSettings":
    from encoder.block_matching import PointTrackerSettings

    if arguments.births is None:
        return PointTrackerSettings()
    if arguments.codec != "3d-te":
        raise ConfigError("--births is for 3d-te")
    return PointTrackerSettings(max_births=arguments.births)


def _report(statistics: "EncoderStatistics", config: CodecConfig) -> dict[str, object]:
    from dataclasses import asdict

    return {"frames": statistics.num_frames, **asdict(statistics), "config": config.to_dict()}


if __name__ == "__main__":
    sys.exit(main())
