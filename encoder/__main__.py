"""Command `dvc-encode`: code a video into a stream, or serve it to a decoder that requests parity."""

import argparse
import sys
from contextlib import ExitStack, nullcontext
from dataclasses import asdict
from typing import TYPE_CHECKING

from dvc import cli
from dvc.files import PARTIAL_SUFFIX
from encoder import encoder_options as options

if TYPE_CHECKING:
    from dvc.video import VideoInfo, VideoReader
    from encoder.encoder_session import EncoderSession, Progress
    from encoder.frame_queue import FrameQueue, PacedFrames
    from encoder.segments import InputFrames, Segment

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
        total = arguments.frames if reader.info.num_frames is None else reader.info.num_frames
        with cli.progress_bar("encoding", total, arguments.quiet) as progress:
            _run(reader, arguments, progress)
    return 0


def _run(reader: "VideoReader", arguments: argparse.Namespace, progress: "Progress") -> None:
    """Encode the frames of a reader, and report; a signal may end a live source or a recording."""
    import cv2

    from dvc.memory import resident_bytes
    from encoder.encoder_report import memory_report
    from encoder.encoder_session import EncoderSession  # noqa: F401  # loaded before the first frame
    from encoder.frame_queue import PacedFrames
    from encoder.segments import InputFrames

    cv2.setNumThreads(1)  # only the time of this thread is counted
    live, segmented = reader.info.live, arguments.segment is not None
    segments: list[Segment] = []
    extra: dict[str, object] = {}
    frames = PacedFrames(reader, reader.info.frame_rate)
    baseline_bytes = resident_bytes()
    session = options.session(arguments, reader.info)
    queue = options.queue(frames, arguments, live, session.config)
    source = InputFrames(queue or frames)
    try:
        if arguments.serve is not None:
            extra = _serve(session, source, arguments, progress, queue)
        else:
            with source.stopping_at_signals() if live or segmented else nullcontext():
                if segmented:
                    _write_segments(source, reader.info, arguments, progress, segments)
                else:
                    _write(session, source, arguments.output, progress, live)
    finally:
        if queue is not None and not queue.close():
            reader.leave_open()
        if live:
            extra = _pace(reader, frames) | extra
    has_output = bool(segments) or not segmented
    if arguments.json is not None and has_output:
        memory = {"memory": memory_report(baseline_bytes)}
        cli.write_json(arguments.json, {**_report(session, segments), **memory, **extra})
    source.raise_end(kept=live and arguments.serve is None and has_output)


def _pace(reader: "VideoReader", frames: "PacedFrames") -> dict[str, object]:
    """Report the lag of the encoder behind a live source, and the lead of its time stamps."""
    lead_s = reader.clock.lead_s
    if frames.behind_s > MIN_REPORTED_LAG_S:
        _log(f"fell up to {frames.behind_s:.1f} s behind the source; one that cannot wait loses frames")
    if lead_s is not None and lead_s > MIN_REPORTED_LAG_S:
        _log(
            f"time stamps ran up to {lead_s:.1f} s ahead of the frames: the source lost some, or sends fewer"
            f" than {float(reader.info.frame_rate):g} per second"
        )
    return {"behind_s": round(frames.behind_s, 3), "lead_s": None if lead_s is None else round(lead_s, 3)}


def _log(text: str) -> None:
    sys.stderr.write(f"{options.PROG}: {cli.one_line(text)}\n")
    sys.stderr.flush()


def _write(
    session: "EncoderSession", source: "InputFrames", output: str, progress: "Progress", live: bool
) -> None:
    """Write a stream; earlier frames of a live source that fails are kept, as it cannot be read again."""
    from dvc.files import SyncedFile, atomic_output

    with atomic_output(output, visible=True) as temporary, SyncedFile(temporary, waits=live) as file:
        session.write(source, file, progress)
        if not live:
            source.raise_failure()
        if session.statistics.num_frames == 0:
            source.raise_end()


def _write_segments(
    source: "InputFrames",
    info: "VideoInfo",
    arguments: argparse.Namespace,
    progress: "Progress",
    finished: "list[Segment]",
) -> None:
    from encoder.segments import MAX_SEGMENT_FRAMES, segment_names, write_segments
    from encoder.time_stamps import CodingClock

    names, clock = segment_names(arguments.output), CodingClock(info.frame_rate)
    for path in names.existing().values():
        if path.suffix == PARTIAL_SUFFIX:
            _log(f"{path} remains from an earlier recording: `dvc-decode --unfinished` reads it")
    length = max(1, round(min(arguments.segment * info.frame_rate, MAX_SEGMENT_FRAMES)))
    finished += write_segments(
        source, names, length, lambda: options.session(arguments, info, clock), progress
    )


def _serve(
    session: "EncoderSession",
    source: "InputFrames",
    arguments: argparse.Namespace,
    progress: "Progress",
    queue: "FrameQueue | None",
) -> dict[str, object]:
    """Serve a decoder, also after an interrupt, which ends the frames; return its lag and the lost links."""
    from dvc.feedback import listen, parse_address
    from encoder.acceptor import PeerAcceptor
    from encoder.frame_queue import LeftOut
    from encoder.live_encoder import DecoderPace, serve

    def _has_frames() -> bool:
        return queue is None or source.stopped or queue.holds(session.config.gop.length)

    left_out = queue.left_out if queue is not None else LeftOut()
    pace = DecoderPace(session.config.video.frame_rate, _log, left_out)
    protection = options.protection(arguments)
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
        with source.stopping_at_signals():
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
    from encoder.encoder_report import EncoderStatistics
    from encoder.rate_limiter import summed_up

    statistics = session.statistics
    report: dict[str, object] = {}
    limits = {} if session.limiter is None else session.limiter.report()
    if segments:
        limits = summed_up([segment.limits for segment in segments])
        statistics = EncoderStatistics.total(segment.statistics for segment in segments)
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
