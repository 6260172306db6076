"""Command `dvc-encode`: code a video into a stream, or serve it to a decoder that requests parity."""

import argparse
import sys
from contextlib import ExitStack, nullcontext
from dataclasses import asdict, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from dvc import cli, config
from dvc.errors import ConfigError
from dvc.files import PARTIAL_SUFFIX
from encoder import encoder_options as options

if TYPE_CHECKING:
    from dvc.video import VideoInfo, VideoReader
    from encoder.encoder_session import CodingClock, EncoderSession, Progress
    from encoder.frame_queue import FrameQueue, InputFrames, PacedFrames
    from encoder.segments import Segment

MIN_REPORTED_LAG_S = 1.0
"""Shortest lag that is logged."""


def _encode(arguments: argparse.Namespace) -> int:
    from dvc.video import open_video

    options.check(arguments)
    outputs = [name for name in (arguments.output, arguments.json) if name not in (None, "-")]
    cli.check_outputs([arguments.input], outputs)
    video = open_video(
        arguments.input,
        size=arguments.size,
        frame_rate=arguments.frame_rate,
        start=arguments.start,
        num_frames=arguments.frames,
        input_format=arguments.input_format,
        timeout_s=arguments.timeout,
        listen=arguments.listen,
    )
    with video as reader:
        for notice in reader.info.notices:
            _log(notice)
        for option in ("--leave-out", "--queue"):
            if not reader.info.live and cli.is_given(arguments, option):
                raise ConfigError(f"{option} requires a camera, a pipe or an address as INPUT")
        total = arguments.frames if reader.info.num_frames is None else reader.info.num_frames
        with cli.progress_bar("encoding", total, arguments.quiet) as progress:
            _run(reader, arguments, progress)
    return 0


def new_session(
    arguments: argparse.Namespace, info: "VideoInfo", clock: "CodingClock | None" = None
) -> "EncoderSession":
    """Set up an encoder for a video; the arguments have been checked."""
    from encoder.encoder_session import EncoderSession
    from encoder.point_tracker import PointTrackerSettings
    from encoder.rate_limits import RateLimits

    bits_per_pixel = config.MAX_TRACKS_BPP if arguments.tracks_bpp is None else arguments.tracks_bpp
    if not bits_per_pixel > 0:
        raise ConfigError(f"--tracks-bpp must be above 0, got {bits_per_pixel}")
    delivery: config.Delivery = config.ParityBuffer() if arguments.serve is None else config.Live()
    rate, period = info.frame_rate, arguments.intra_period
    if arguments.key_frames is not None and period is None:
        period = 0 if arguments.key_frames == "intra" else config.INTRA_PERIOD
    quality: config.Quality = config.Qp(**_given(qp=arguments.qp))
    codec = config.codec_config(
        config.VideoConfig(info.width, info.height, rate.numerator, rate.denominator, arguments.luma_only),
        arguments.codec,
        quality if arguments.wz_q is None else config.DiscoverMatrix(arguments.wz_q),
        gop=_given(length=arguments.gop, references=arguments.references),
        key=(arguments.key_qp or {}) | _given(intra_period=period),
        wyner_ziv={"noise_model": arguments.noise_model},
        coder=config.CODERS[arguments.coder](),
        tracks=_given(num_points=arguments.points, subpixel_bits=arguments.subpixel),
        seed=arguments.seed,
    )
    groups = config.VARIANTS[arguments.codec].groups(codec.gop.references, codec.key.intra_period)
    rule = {field: getattr(arguments, option) for option, field in options.RULE_FIELDS.items()}
    limits = _given(bits_per_s=arguments.bitrate, bits_per_frame=arguments.max_bits_per_frame)
    return EncoderSession(
        codec,
        config.NoFeedback() if arguments.no_feedback else delivery,
        replace(groups.key_frames, **_given(**rule)),
        bits_per_pixel,
        PointTrackerSettings(**_given(max_new_tracks=arguments.new_tracks)),
        clock,
        RateLimits(**limits) if limits else None,
    )


def _given(**values: Any) -> dict[str, Any]:
    return {name: value for name, value in values.items() if value is not None}


def _run(reader: "VideoReader", arguments: argparse.Namespace, progress: "Progress") -> None:
    """Encode the frames of a reader, and report; a signal may end a live source or a recording."""
    import cv2

    from dvc.files import SyncedFile, atomic_output
    from dvc.memory import resident_bytes
    from encoder.encoder_report import memory_report
    from encoder.encoder_session import CodingClock  # the encoder is loaded before the first frame
    from encoder.frame_queue import InputFrames, PacedFrames
    from encoder.segments import MAX_SEGMENT_FRAMES, segment_names, write_segments

    cv2.setNumThreads(1)  # only the time of this thread is counted
    live, segmented = reader.info.live, arguments.segment is not None
    segments: list[Segment] = []
    extra: dict[str, object] = {}
    baseline_bytes = 0 if arguments.json is None else resident_bytes()
    session = new_session(arguments, reader.info)
    paced = PacedFrames(reader, reader.info.frame_rate)
    queue = _queue(paced, arguments, session.config) if live and arguments.serve is not None else None
    source = InputFrames(queue or paced)
    try:
        if arguments.serve is not None:
            extra = _serve(session, source, arguments, progress, queue)
        else:
            with cli.stopping_at_signals(source.stop) if live or segmented else nullcontext():
                if segmented:
                    names, clock = segment_names(arguments.output), CodingClock(reader.info.frame_rate)
                    for path in (path for path in names.existing().values() if path.suffix == PARTIAL_SUFFIX):
                        _log(f"{path} remains from an earlier recording: `dvc-decode --unfinished` reads it")
                    length = min(arguments.segment * reader.info.frame_rate, MAX_SEGMENT_FRAMES)
                    new = partial(new_session, arguments, reader.info, clock)
                    segments += write_segments(source, names, max(1, round(length)), new, progress)
                else:
                    # Earlier frames of a live source that fails are kept, as it cannot be read again.
                    with (
                        atomic_output(arguments.output, visible=True) as temporary,
                        SyncedFile(temporary, waits=live) as file,
                    ):
                        session.write(source, file, progress)
                        if (source.failure is not None and not live) or session.statistics.num_frames == 0:
                            source.raise_end()
    finally:
        if queue is not None and not queue.close():
            reader.leave_open()
        if live:
            extra = _pace(reader, paced.behind_s) | extra
    has_output = bool(segments) or not segmented
    if arguments.json is not None and has_output:
        memory = {"memory": memory_report(baseline_bytes)}
        cli.write_json(arguments.json, {**_report(session, segments), **memory, **extra})
    source.raise_end(kept=live and arguments.serve is None and has_output)


def _queue(frames: "PacedFrames", arguments: argparse.Namespace, codec: config.CodecConfig) -> "FrameQueue":
    """Return the queue of a live source for a slower decoder; a file waits by itself."""
    from encoder.frame_queue import FrameQueue

    group_length = codec.gop.length
    # by default about two seconds, and at most 64 frames of 1920x1080, 200 MB
    default = min(64, (1 << 27) // (codec.video.width * codec.video.height))
    max_frames = arguments.queue or max(group_length, default)
    if arguments.leave_out and max_frames < group_length:
        raise ConfigError(f"--leave-out requires a queue that holds a group: --queue {group_length} or more")
    return FrameQueue(frames, max_frames, group_length if arguments.leave_out else 0)


def _pace(reader: "VideoReader", behind_s: float) -> dict[str, object]:
    """Report the lag of the encoder behind a live source, and the lead of its time stamps."""
    lead_s = reader.clock.lead_s
    if behind_s > MIN_REPORTED_LAG_S:
        _log(f"fell up to {behind_s:.1f} s behind the source; one that cannot wait loses frames")
    if lead_s is not None and lead_s > MIN_REPORTED_LAG_S:
        _log(
            f"time stamps ran up to {lead_s:.1f} s ahead of the frames: the source lost some, or sends fewer"
            f" than {float(reader.info.frame_rate):g} per second"
        )
    return {"behind_s": round(behind_s, 3), "lead_s": None if lead_s is None else round(lead_s, 3)}


def _log(text: str) -> None:
    sys.stderr.write(f"{options.PROG}: {cli.one_line(text)}\n")
    sys.stderr.flush()


def _serve(
    session: "EncoderSession",
    source: "InputFrames",
    arguments: argparse.Namespace,
    progress: "Progress",
    queue: "FrameQueue | None",
) -> dict[str, object]:
    """Serve a decoder, also after an interrupt, which ends the frames; return its lag and the lost links."""
    from dvc.feedback import Protection, listen, parse_address, read_token
    from dvc.feedback.protection import encoder_context
    from encoder.acceptor import PeerAcceptor
    from encoder.frame_queue import LeftOut
    from encoder.live_encoder import DecoderPace, serve

    def _has_frames() -> bool:
        return queue is None or source.stopped or queue.holds(session.config.gop.length)

    left_out = queue.left_out if queue is not None else LeftOut()
    pace = DecoderPace(session.config.video.frame_rate, _log, left_out)
    token = b"" if arguments.token_file is None else read_token(arguments.token_file)
    tls = None if arguments.tls_cert is None else encoder_context(arguments.tls_cert, arguments.tls_key)
    protection = Protection(tls, token, insecure=arguments.insecure)
    with ExitStack() as stack:
        listener = stack.enter_context(listen(*parse_address(arguments.serve)))
        protection.check_exposure(listener.host)
        if protection.insecure and protection.tls is None:
            _log("the connection is not protected: anyone may connect, and read and change the data")
        _log(f"waiting for a decoder on {listener.name}")
        acceptor = PeerAcceptor(
            listener, session.config, protection, arguments.timeout, arguments.patience, _log
        )
        peer = stack.enter_context(acceptor).next_peer()
        assert peer is not None
        with cli.stopping_at_signals(source.stop):
            link = serve(session, source, acceptor, peer, progress, pace, arguments.patience, _has_frames)
    if left_out.frames:
        _log(f"left out {left_out.frames} frames in {left_out.gaps} gap(s): the decoder is too slow")
    return {
        "decoder_behind_s": round(pace.behind_s, 3),
        "most_frames_open": pace.most_frames_open,
        "left_out": asdict(left_out),
        **link,
    }


def _report(session: "EncoderSession", segments: "list[Segment]") -> dict[str, object]:
    from encoder.encoder_report import added_up
    from encoder.rate_limiter import summed_up

    statistics = session.statistics
    limits = {} if session.limiter is None else session.limiter.report()
    report: dict[str, object] = {}
    if segments:
        limits = summed_up([segment.limits for segment in segments])
        statistics = added_up([segment.statistics for segment in segments])
        report["segments"] = [
            {
                "name": segment.path.name,
                "frames": segment.statistics.num_frames,
                "stream_bytes": segment.statistics.stream_bytes,
            }
            for segment in segments
        ]
    return {
        "frames": statistics.num_frames,
        **statistics.to_dict(),
        "operations_per_pixel": statistics.operations_per_pixel(session.config),
        **({"limits": limits} if limits else {}),
        "config": session.config.to_dict(),
        **report,
    }


main = cli.command(options.PROG, options.parser, _encode)

if __name__ == "__main__":
    sys.exit(main())
