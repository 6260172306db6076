"""Measure key frames: bytes against a plain x264 file, and processor time per frame.

Usage: ``python -m benchmarks.keyframes VIDEO [NUM_FRAMES]``
"""

import io
import sys
import time
from collections.abc import Callable
from statistics import mean
from typing import TypeVar

from dvc.keyframes import KeyFrameDecoder, KeyFrameEncoder, Qp
from dvc.metrics import psnr_db
from dvc.video import Frame, open_video
from dvc.video.pixels import picture_from_frame

Result = TypeVar("Result")


def plain_file_bytes(frames: list[Frame], qp: Qp, pixel_format: str) -> int:
    """Return the size of a plain all-intra H.264 file with the same settings, one thread."""
    import av

    file = io.BytesIO()
    with av.open(file, "w", format="h264") as container:
        options = {
            "preset": "medium",
            "qp": "0" if qp == "lossless" else str(qp),
            "x264-params": "keyint=1:psy=0:ipratio=1:threads=1",
        }
        stream = container.add_stream("libx264", rate=25, options=options)
        stream.width, stream.height, stream.pix_fmt = frames[0].width, frames[0].height, pixel_format
        for index, frame in enumerate(frames):
            picture = picture_from_frame(frame, pixel_format)
            picture.pts = index
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))
    return len(file.getvalue())


def timed(function: Callable[[], Result]) -> tuple[Result, float]:
    """Return a result and the processor time that it took, in seconds."""
    start_s = time.process_time()
    result = function()
    return result, time.process_time() - start_s


def measure(frames: list[Frame], qp: Qp, luma_only: bool) -> None:
    """Print one row."""
    width, height = frames[0].width, frames[0].height
    encoder = KeyFrameEncoder(width, height, qp, luma_only=luma_only)
    encoder.encode(frames[0])  # the first picture pays for setting up
    coded, encode_s = timed(lambda: [encoder.encode(frame) for frame in frames])
    decoder = KeyFrameDecoder(width, height, encoder.parameter_sets, luma_only=luma_only)
    decoded, decode_s = timed(lambda: [decoder.decode(data) for data in coded])
    plain = plain_file_bytes(frames, qp, "gray" if luma_only else "yuv420p")
    own = len(encoder.parameter_sets) + sum(map(len, coded))
    quality_db = mean(psnr_db(a.luma, b.luma) for a, b in zip(decoded, frames, strict=True))
    print(
        f"{qp!s:>8}  {'luma' if luma_only else 'colour':6}  "
        f"{own / len(frames):9.1f}  {plain / len(frames):9.1f}  "
        f"{own / plain:6.4f}  {quality_db:7.3f}  {1000 * encode_s / len(frames):9.2f}  "
        f"{1000 * decode_s / len(frames):9.2f}"
    )


def main() -> int:
    """Measure one video at the quantization parameters of the codec's presets."""
    if len(sys.argv) not in {2, 3}:
        print(__doc__, file=sys.stderr)
        return 2
    num_frames = int(sys.argv[2]) if len(sys.argv) == 3 else 50
    with open_video(sys.argv[1], num_frames=num_frames) as reader:
        frames = list(reader)
    print(f"{sys.argv[1]}: {len(frames)} frames of {frames[0].width}x{frames[0].height}")
    print("      qp  planes  bytes/frm  x264 file   ratio  psnr_db  encode_ms  decode_ms")
    qps: tuple[Qp, ...] = (25, 29, 34, 40, "lossless")
    for qp in qps:
        for luma_only in (True, False):
            measure(frames, qp, luma_only)
    return 0


if __name__ == "__main__":
    sys.exit(main())
