"""Settings of libx264 for key pictures: rate that better prediction saves, and its time.

``python -m benchmarks.searches.key_pictures [CLIP ...] [--every 8 4] [--qp 24 30 36] [--axes AXIS ...]``
codes every N-th frame of each clip, the first picture intra and the rest predicted, with every combination
of the axes. An axis holds alternatives, such as ``subme=5/subme=6``, of one or several parameters:
``me=hex/me=umh:merange=24``. A row has the processor time of a picture and the change of rate (Bjontegaard,
PSNR of luma) against preset medium with ``me=hex:ref=1``: the mean, and that of each clip and distance.
Settings that another beats in both are shown only with ``--all``. The first line has the time of x264
superfast for all frames.
"""

import argparse
import time
from collections.abc import Sequence
from fractions import Fraction
from itertools import islice, product
from typing import Final, NamedTuple

import numpy as np

from benchmarks.results.harness import clip_source
from dvc.metrics import bd_rate, psnr_db
from dvc.rd.anchors import ANCHOR_CODECS
from dvc.rd.anchors.anchor_files import without_overhead
from dvc.video import Frame, open_video
from dvc.video.pixels import frame_from_picture, picture_from_frame

CLIPS = ("box", "desk", "tree", "stone", "river", "cube")
REFERENCE = "me=hex:ref=1"
AXES = (
    "weightp=1:dct-decimate=0",
    "me=dia/me=hex/me=umh:merange=16/me=umh:merange=24",
    "subme=2/subme=5/subme=6/subme=8",
    "trellis=0:deadzone-inter=18:deadzone-intra=9/trellis=1/trellis=2",
    "ref=1/ref=2",
)
I_QP: Final = -3
"""QP of the intra picture, relative to the other pictures."""
# With a rate factor and `qcomp` 1 the QP is constant, too, and search begins at vectors of small pictures.
_FIXED = {"psy": "0", "mbtree": "0", "bframes": "0", "rc-lookahead": "0", "sync-lookahead": "0"}
_FIXED |= {"sliced-threads": "0", "threads": "1", "scenecut": "0", "keyint": "infinite", "weightp": "0"}
_FIXED |= {"qcomp": "1", "ipratio": "1", "qpmin": "0", "aq-mode": "1", "aq-strength": "0.0001"}


class Coded(NamedTuple):
    """Result of some pictures."""

    num_bits: int
    psnr_db: float  # luma PSNR, mean over pictures
    cpu_ms: float  # time of a picture


def parameters_of(setting: str, qp: int) -> dict[str, str]:
    """Return all parameters of a setting, its preset among them."""
    own = dict(one.split("=") for one in setting.split(":"))
    return {"preset": "medium", **_FIXED, "crf": str(qp), "zones": f"0,0,q={qp + I_QP}", **own}


def coded(frames: Sequence[Frame], parameters: dict[str, str], *, colour: bool = False) -> Coded:
    """Code pictures, the first of them intra, and decode them."""
    import av

    pixel_format = "yuv420p" if colour else "gray"
    pictures = [picture_from_frame(frame, pixel_format) for frame in frames]
    encoder = av.CodecContext.create("libx264", "w")
    encoder.width, encoder.height, encoder.pix_fmt = frames[0].width, frames[0].height, pixel_format
    encoder.framerate, encoder.time_base, encoder.thread_count = Fraction(25), Fraction(1, 25), 1
    own = dict(parameters)
    preset = own.pop("preset")
    joined = ":".join(f"{name}={value}" for name, value in own.items())
    encoder.options = {"preset": preset, "tune": "zerolatency", "x264-params": joined}
    encoder.open()
    started = time.process_time()
    packets = []
    for number, picture in enumerate(pictures):
        picture.pts = number
        packets += encoder.encode(picture)
    cpu_s = time.process_time() - started
    decoder = av.CodecContext.create("h264", "r")
    decoder.thread_count = 1
    found = [frame_from_picture(one) for packet in (*packets, None) for one in decoder.decode(packet)]
    num_bytes = sum(len(without_overhead(bytes(packet), "h264")) for packet in packets)
    psnrs_db = [psnr_db(frame.luma, one.luma) for frame, one in zip(frames, found, strict=True)]
    return Coded(8 * num_bytes, float(np.mean(psnrs_db)), 1000.0 * cpu_s / len(frames))


class Tried(NamedTuple):
    """Effect of a setting on each clip and distance."""

    setting: str
    rates_percent: dict[str, float]  # by clip and distance, against the reference
    cpu_ms: float  # time of a picture, mean

    @property
    def rate_percent(self) -> float:
        """The mean."""
        return float(np.mean([*self.rates_percent.values()]))


def tried(setting: str, found: dict[str, list[Coded]], reference: dict[str, list[Coded]]) -> Tried:
    """Compare the curves of a setting and of the reference for each clip and distance."""
    rates = {}
    for place, own in found.items():
        usual = reference[place]
        curves = [values for points in (usual, own) for values in list(zip(*points, strict=True))[:2]]
        rates[place] = bd_rate(*curves).value
    return Tried(setting, rates, float(np.mean([one.cpu_ms for own in found.values() for one in own])))


def front(settings: Sequence[Tried]) -> list[Tried]:
    """Return those that no other beats in rate and time, the fastest first."""
    best: list[Tried] = []
    for one in sorted(settings, key=lambda one: (one.cpu_ms, one.rate_percent)):
        if not best or one.rate_percent < best[-1].rate_percent:
            best.append(one)
    return best


def main(words: Sequence[str] | None = None) -> None:
    """Print a row for each setting on the front."""
    parser = argparse.ArgumentParser("python -m benchmarks.searches.key_pictures", description=__doc__)
    parser.add_argument("clips", nargs="*", default=CLIPS, metavar="CLIP")
    parser.add_argument("--axes", nargs="+", default=AXES, metavar="AXIS")
    parser.add_argument("--every", nargs="+", type=int, default=[8, 4])
    parser.add_argument("--qp", nargs="+", type=int, default=[24, 30, 36], help="two or more, for the curves")
    parser.add_argument("--frames", type=int, default=65)
    parser.add_argument("--colour", action="store_true")
    parser.add_argument("--all", action="store_true")
    arguments = parser.parse_args(words)
    if len(set(arguments.qp)) < 2:
        parser.error("--qp: a curve needs two of them")
    clips: dict[str, list[Frame]] = {}
    for clip in arguments.clips:
        with open_video(clip_source(clip).path) as video:
            clips[clip] = list(islice(video, arguments.frames))
    codec = ANCHOR_CODECS["x264-superfast"]
    for clip, frames in clips.items():
        parameters = ({"preset": codec.preset, **codec.encoder_parameters(qp)} for qp in arguments.qp)
        times = ", ".join(f"{coded(frames, own, colour=arguments.colour).cpu_ms:.2f}" for own in parameters)
        print(f"{codec.label}, all frames of {clip}: {times} ms each", flush=True)
    places = {
        f"{clip}/{every}": frames[::every] for clip, frames in clips.items() for every in arguments.every
    }

    def points_of(setting: str) -> dict[str, list[Coded]]:
        parameters = [parameters_of(setting, qp) for qp in arguments.qp]
        return {
            place: [coded(frames, own, colour=arguments.colour) for own in parameters]
            for place, frames in places.items()
        }

    reference = points_of(REFERENCE)
    settings = (":".join(parts) for parts in product(*(axis.split("/") for axis in arguments.axes)))
    rows = [tried(setting, points_of(setting), reference) for setting in settings]
    rows.append(tried(REFERENCE, reference, reference))
    for row in sorted(rows, key=lambda row: row.cpu_ms) if arguments.all else front(rows):
        by_place = " ".join(f"{place} {rate:+.1f}" for place, rate in row.rates_percent.items())
        print(f"{row.cpu_ms:6.2f} ms {row.rate_percent:+6.2f} % {row.setting}: {by_place}", flush=True)


if __name__ == "__main__":
    main()
