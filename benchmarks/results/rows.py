"""The results: measurement, target, and canaries of their code."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from benchmarks.hostile.campaign import CUTS, FUZZING
from benchmarks.results import curves, dibr, encoder, hostile, live, stereo
from benchmarks.results.harness import Measured, Setting
from benchmarks.thesis.scenes import PAIRS

CODEC = ("default",)
FEEDBACK_FREE = ("no-feedback",)


@dataclass(frozen=True)
class Row:
    """One result."""

    name: str
    title: str  # description of the value
    measure: Callable[[Setting], Measured]
    form: str = "{:+.1f} %"  # format of the value
    at_most: float | None = None  # target
    at_least: float | None = None
    canaries: tuple[str, ...] = CODEC  # configurations that it depends on
    files: tuple[Path, ...] = ()  # files that it is read from

    @property
    def target(self) -> str:
        """The target as text."""
        if self.at_most is not None:
            return f"≤ {self.written(self.at_most)}"
        return "no target" if self.at_least is None else f"≥ {self.written(self.at_least)}"

    def met(self, value: float) -> bool | None:
        """Return whether a value reaches the target, if there is one."""
        if self.at_most is not None:
            return value <= self.at_most
        return None if self.at_least is None else value >= self.at_least

    def written(self, value: float) -> str:
        """Write a value with its unit."""
        return self.form.format(value).replace("-", "−")

    @property
    def module(self) -> str:
        """Module that measures it."""
        function = self.measure.func if isinstance(self.measure, partial) else self.measure
        return function.__module__


def _against_anchor(anchor: str, title: str, at_most: float | None = None) -> Row:
    measure = partial(curves.against_anchor, anchor=anchor)
    return Row(f"rate/{anchor}", f"BD-rate against {title}", measure, at_most=at_most)


ROWS = (
    _against_anchor("svtav1-6", "SVT-AV1 preset 6, random access"),
    _against_anchor("x265-medium", "x265 medium, B frames", 8.0),
    _against_anchor("x264-slower", "x264 slower, B frames", 3.0),
    _against_anchor("x264-medium", "x264 medium, B frames", -5.0),
    Row(
        "rate/x264-medium-colour",
        "BD-rate against x264 medium, B frames, at equal PSNR in colour",
        partial(curves.against_anchor, anchor="x264-medium", measure="colour"),
        at_most=-3.0,
    ),
    _against_anchor("x264-ippp", "x264 medium without B frames, one reference", 10.0),
    _against_anchor("x264-superfast", "x264 superfast without B frames, one reference"),
    _against_anchor("x264-ippp-16", "the same with medium and an intra frame every 16", -15.0),
    _against_anchor("intra", "H.264 intra", -70.0),
    Row(
        "rate/2d",
        "BD-rate against block motion at the decoder (`--codec 2d`)",
        partial(curves.against_codec, reference="2d"),
        at_most=-45.0,
        canaries=("default", "2d"),
    ),
    Row(
        "rate/matrices",
        "BD-rate against DISCOVER quantisation matrices (`--wz-q`), both of luma only",
        partial(curves.against_codec, reference="matrices", name=curves.LUMA_ONLY),
        at_most=-35.0,
        canaries=("default", "matrices"),
    ),
    Row(
        "no-feedback/rate",
        "BD-rate without feedback over that with feedback",
        partial(curves.against_codec, reference=curves.DEFAULT, name="no-feedback"),
        at_most=10.0,
        canaries=("default", "no-feedback"),
    ),
    Row(
        "no-feedback/x264-medium",
        "BD-rate without feedback against x264 medium, B frames",
        partial(curves.against_anchor, anchor="x264-medium", name="no-feedback"),
        at_most=5.0,
        canaries=FEEDBACK_FREE,
    ),
    Row(
        "no-feedback/x264-superfast",
        "BD-rate without feedback against x264 superfast without B frames, one reference",
        partial(curves.against_anchor, anchor="x264-superfast", name="no-feedback"),
        canaries=FEEDBACK_FREE,
    ),
    Row(
        "quality/worst-frame",
        "PSNR of the worst frame below the mean, at the worst QP",
        curves.worst_frame_db,
        "{:.2f} dB",
        at_most=2.0,
    ),
    Row(
        "quality/side-information",
        "side information over that of block motion, the same lossless key frames",
        curves.side_information_gain,
        "{:+.2f} dB",
        at_least=6.0,
        canaries=("matrices",),
    ),
    Row(
        "parity/over-ideal",
        "bits of planes over the ideal code length",
        curves.parity_over_ideal,
        "{:.3f}",
        at_most=1.05,
    ),
    Row(
        "stream/not-proven",
        "clips whose punctured stream a fresh process decodes to other frames",
        curves.not_proven,
        "{:.0f}",
        at_most=0.0,
    ),
    Row(
        "decoding/time",
        "processor time of the decoder for a Wyner-Ziv frame, CIF",
        curves.decoding_cpu_s,
        "{:.2f} s",
        at_most=0.5,
    ),
    Row("decoding/requests", "requests for a Wyner-Ziv frame, CIF", curves.requests_per_frame, "{:.0f}"),
    Row(
        "encoding/time",
        "processor time without feedback over that of x264 superfast",
        partial(encoder.time_over, anchor="x264-superfast"),
        "{:.2f}",
        at_most=1.0,
        canaries=FEEDBACK_FREE,
    ),
    Row(
        "encoding/time-no-asm",
        "processor time without feedback over that of x264 superfast without vector code",
        partial(encoder.time_over, anchor="x264-superfast-no-asm"),
        "{:.2f}",
        at_most=0.5,
        canaries=FEEDBACK_FREE,
    ),
    Row(
        "encoding/operations",
        "operations a pixel without feedback, except key frames",
        encoder.operations,
        "{:.0f}",
        canaries=FEEDBACK_FREE,
    ),
    Row(
        "encoding/memory",
        "peak memory of the encoder without Python, libraries and compiled code",
        encoder.own_memory_mib,
        "{:.0f} MiB",
        canaries=FEEDBACK_FREE,
    ),
    Row(
        "encoding/memory-growth",
        "growth of the peak memory of encoder or decoder on long videos",
        encoder.memory_growth,
        "{:+.1f} %",
        at_most=10.0,
        canaries=("default", "no-feedback"),
    ),
    Row(
        "live/encoder-time",
        "processor time of a live encoder over that of x264 superfast",
        live.encoder_time,
        "{:.2f}",
        at_most=1.5,
    ),
    Row(
        "live/messages",
        "messages of requests for a Wyner-Ziv frame, live",
        live.messages,
        "{:.1f}",
        at_most=5.0,
    ),
    Row(
        "live/differences",
        "clips whose frames or bits differ between a live run and a file",
        live.differences,
        "{:.0f}",
        at_most=0.0,
    ),
    *(
        Row(
            f"stereo/{name}",
            f"pixels off by more than 1 px, {name}, two views",
            partial(stereo.bad_pixels, name=name),
            "{:.2f} %",
            at_most=target,
            canaries=("stereo",),
        )
        for name, target in (("tsukuba", 1.5), ("venus", 1.0), ("teddy", 9.0), ("cones", 8.0))
    ),
    Row(
        "stereo/over-sgbm",
        "such pixels over those of OpenCV's StereoSGBM, holes filled, these four pairs",
        partial(stereo.over_baseline, names=tuple(PAIRS)),
        "{:.2f}",
        at_most=0.65,
        canaries=("stereo",),
    ),
    Row(
        "stereo/over-sgbm-others",
        "the same on nine other pairs",
        partial(stereo.over_baseline, names=stereo.OTHERS),
        "{:.2f}",
        canaries=("stereo",),
    ),
    Row(
        "dibr/l",
        "texture + depth, L transform: BD-rate against quadtrees, four pairs",
        partial(dibr.over_quadtree, method="l"),
        at_most=0.0,
        canaries=("texture-depth",),
    ),
    Row(
        "dibr/s",
        "texture + depth, S transform: BD-rate against quadtrees, Teddy",
        partial(dibr.over_quadtree, method="s", names=("teddy",)),
        at_most=0.0,
        canaries=("texture-depth",),
    ),
    Row(
        "depth/largest-gain",
        "shape-adaptive over standard wavelets, Teddy's map, best of nine rates",
        dibr.largest_depth_gain,
        "{:+.2f} dB",
        at_least=5.5,
        canaries=("depth-map",),
    ),
    Row(
        "depth/mean-gain",
        f"the same at {dibr.DEPTH_RATE:g} bit/pixel, four maps",
        dibr.depth_gain,
        "{:+.2f} dB",
        at_least=3.0,
        canaries=("depth-map",),
    ),
    Row(
        "depth/picture-gain",
        "Teddy's picture with the edges of its map over without, best of three rates",
        dibr.picture_gain,
        "{:+.2f} dB",
        at_least=0.15,
        canaries=("depth-map",),
    ),
    Row(
        "hostile/harm",
        "mutations of streams and messages that did harm",
        hostile.harmful,
        "{:.0f}",
        at_most=0.0,
        canaries=("default", "texture-depth", "depth-map"),
    ),
    Row(
        "hostile/campaign",
        "hours of new mutations, by code that checks bounds",
        hostile.hours_fuzzed,
        "{:.1f} h",
        at_least=8.0,
        canaries=(),
        files=(FUZZING,),
    ),
    Row(
        "hostile/finds",
        "such mutations that did harm, and still do",
        hostile.finds_left,
        "{:.0f}",
        at_most=0.0,
        files=(FUZZING,),
    ),
    Row(
        "hostile/cuts",
        "live runs that were cut at a random moment and gave the same frames and bits",
        hostile.same_after_cuts,
        "{:.0f}",
        at_least=1000.0,
        canaries=(),
        files=(CUTS,),
    ),
)
"""All results in the order of the page, apart from missed targets."""
BY_NAME = {row.name: row for row in ROWS}
