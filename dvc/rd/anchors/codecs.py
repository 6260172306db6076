"""The anchors, and the exact options that they are run with."""

from dataclasses import dataclass
from typing import Final, Literal

from dvc.config import MAX_QP
from dvc.errors import ConfigError

_MAX_AV1_QP = 63

Parameters = tuple[tuple[str, str], ...]

# Constant QP for all frames, no tool that gives up PSNR for looks, one thread, no version message.
_X264: Parameters = (("psy", "0"), ("ipratio", "1"), ("qpmin", "0"), ("scenecut", "0"), ("mbtree", "0"))
_X264 += (("bframes", "0"), ("b-adapt", "0"), ("ref", "1"), ("weightp", "0"), ("rc-lookahead", "0"))
_X264 += (("sync-lookahead", "0"), ("sliced-threads", "0"), ("threads", "1"))
# As people run it: B frames, references, lookahead and QPs of I and B frames as the preset has them.
_X264_AS_IT_COMES: Parameters = (("psy", "0"), ("qpmin", "0"), ("scenecut", "0"), ("keyint", "infinite"))
_X264_AS_IT_COMES += (("threads", "1"),)
_X264_INTRA = (("keyint", "1"), *_X264)
_X264_IPPP = (("keyint", "infinite"), *_X264)
_X264_IPPP_16 = (("keyint", "16"), *_X264)
# Without subpixel refinement x264 chooses transforms and skipped blocks by rough measures: with 4x4
# transforms only, as the reference software's rows have, and no early skipping it stays close to these.
_X264_ZERO = (("me", "esa"), ("subme", "0"), ("8x8dct", "0"), ("fast-pskip", "0"))
_X265: Parameters = (("psy-rd", "0"), ("psy-rdoq", "0"), ("aq-mode", "0"), ("scenecut", "0"))
_X265 += (("cutree", "0"), ("pools", "none"), ("frame-threads", "1"), ("wpp", "0"), ("info", "0"))
_X265_LOW_DELAY: Parameters = (
    ("bframes", "0"),
    ("b-adapt", "0"),
    ("ref", "1"),
    ("weightp", "0"),
    ("ipratio", "1"),
)
_X265_LOW_DELAY += (("rc-lookahead", "0"), ("lookahead-slices", "0"), *_X265)
_SVTAV1: Parameters = (("rc", "0"), ("aq-mode", "0"), ("tune", "1"), ("enable-tf", "0"), ("scd", "0"))
_SVTAV1 += (("pred-struct", "1"), ("lp", "1"), ("use-fixed-qindex-offsets", "1"))
_SVTAV1 += (("key-frame-qindex-offset", "0"), ("qindex-offsets", "[0,0,0,0,0,0]"))
_SVTAV1_RANDOM_ACCESS: Parameters = (("rc", "0"), ("aq-mode", "0"), ("tune", "1"), ("scd", "0"))
_SVTAV1_RANDOM_ACCESS += (("pred-struct", "2"), ("lp", "1"), ("keyint", "-1"))


@dataclass(frozen=True)
class AnchorCodec:
    """One anchor."""

    name: str  # as the command line and results name it
    label: str  # as tables and plots name it
    library: Literal["libx264", "libx265", "libsvtav1"]  # encoder, as FFmpeg names it
    preset: str  # preset of that encoder
    parameters: Parameters  # all that differs from the preset, apart from the QP
    # which frames are predicted: none, each from the one before it, or with B frames
    structure: Literal["intra", "ippp", "random access"]
    zero_motion: bool = False  # whether every motion vector must be zero
    # frames from one intra frame to the next; 0 where only the first is one, or the preset decides
    intra_period: int = 0

    @property
    def suffix(self) -> str:
        """Suffix of a file that holds the elementary stream."""
        return {"libx264": ".264", "libx265": ".265", "libsvtav1": ".obu"}[self.library]

    @property
    def file_format(self) -> str:
        """Name that FFmpeg has for such a file."""
        return {"libx264": "h264", "libx265": "hevc", "libsvtav1": "obu"}[self.library]

    def pixel_format(self, *, luma_only: bool) -> Literal["gray", "yuv420p"]:
        """4:2:0, or luma alone where the encoder takes that, otherwise 4:2:0 with chroma of 128."""
        return "gray" if luma_only and self.library != "libsvtav1" else "yuv420p"

    def encoder_qp(self, qp: int) -> int:
        """Return the encoder's own quantizer for a QP on the scale of H.264."""
        if not 1 <= qp <= MAX_QP:
            raise ConfigError(f"the QP of an anchor must be 1 to {MAX_QP}, got {qp}")
        if self.library != "libsvtav1":
            return qp
        return min(max(14 + round(5 * (qp - 20) / 3), 1), _MAX_AV1_QP)

    def encoder_parameters(self, qp: int) -> dict[str, str]:
        """Return the parameters of the encoder's own syntax."""
        return {**dict(self.parameters), "qp": str(self.encoder_qp(qp))}


_ALL = (
    AnchorCodec("x264-intra", "x264 intra", "libx264", "medium", _X264_INTRA, "intra"),
    AnchorCodec(
        "x264-ippp-zero",
        "x264 IPPP, zero motion",
        "libx264",
        "medium",
        (*_X264_IPPP, *_X264_ZERO),
        "ippp",
        zero_motion=True,
    ),
    AnchorCodec("x264-ippp", "x264 IPPP", "libx264", "medium", _X264_IPPP, "ippp"),
    AnchorCodec(
        "x264-ippp-16",
        "x264 IPPP, intra every 16",
        "libx264",
        "medium",
        _X264_IPPP_16,
        "ippp",
        intra_period=16,
    ),
    *(
        AnchorCodec(f"x264-{preset}", f"x264 IPPP, {preset}", "libx264", preset, _X264_IPPP, "ippp")
        for preset in ("ultrafast", "superfast", "veryfast")
    ),
    *(
        AnchorCodec(
            f"x264-{preset}-no-asm",
            f"x264 IPPP, {preset}, no vector code",
            "libx264",
            preset,
            (*_X264_IPPP, ("asm", "0")),
            "ippp",
        )
        for preset in ("ultrafast", "superfast")
    ),
    *(
        AnchorCodec(f"x264-{preset}", f"x264 {preset}", "libx264", preset, _X264_AS_IT_COMES, "random access")
        for preset in ("medium", "slower")
    ),
    AnchorCodec(
        "x265-intra", "x265 intra", "libx265", "medium", (("keyint", "1"), *_X265_LOW_DELAY), "intra"
    ),
    AnchorCodec("x265", "x265 IPPP", "libx265", "medium", (("keyint", "-1"), *_X265_LOW_DELAY), "ippp"),
    AnchorCodec(
        "x265-ultrafast",
        "x265 IPPP, ultrafast",
        "libx265",
        "ultrafast",
        (("keyint", "-1"), *_X265_LOW_DELAY),
        "ippp",
    ),
    AnchorCodec(
        "x265-medium",
        "x265 medium",
        "libx265",
        "medium",
        (("keyint", "-1"), *_X265),
        "random access",
    ),
    AnchorCodec("svtav1-intra", "SVT-AV1 intra", "libsvtav1", "5", (("keyint", "1"), *_SVTAV1), "intra"),
    AnchorCodec("svtav1", "SVT-AV1 low delay", "libsvtav1", "5", (("keyint", "-1"), *_SVTAV1), "ippp"),
    AnchorCodec(
        "svtav1-fastest",
        "SVT-AV1 low delay, fastest",
        "libsvtav1",
        "13",
        (("keyint", "-1"), *_SVTAV1),
        "ippp",
    ),
    AnchorCodec("svtav1-6", "SVT-AV1 preset 6", "libsvtav1", "6", _SVTAV1_RANDOM_ACCESS, "random access"),
)
ANCHOR_CODECS: Final = {codec.name: codec for codec in _ALL}
"""Anchors that are measured as files, by name."""
