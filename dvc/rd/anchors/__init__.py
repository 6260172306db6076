"""Standard codecs to compare with, and the exact options of their encoders."""

from dataclasses import dataclass
from typing import Final, Literal

from dvc.config import MAX_QP
from dvc.errors import ConfigError

Library = Literal["libx264", "libx265", "libsvtav1"]
Structure = Literal["intra", "ippp", "random access"]
_LIBRARIES: dict[str, Library] = {"x264": "libx264", "x265": "libx265", "svtav1": "libsvtav1"}
_MAX_AV1_QP = 63
_FILES = {"libx264": (".264", "h264"), "libx265": (".265", "hevc"), "libsvtav1": (".obu", "obu")}
"""Suffix of the elementary streams of each encoder, and FFmpeg's name of their format."""
FILE_FORMATS: Final = dict(_FILES.values())
"""FFmpeg's name of a format, by the suffix of its files."""

# Constant QP for all frames, no tool that trades PSNR for looks, one thread, no version message.
_X264 = (
    "psy=0 ipratio=1 qpmin=0 scenecut=0 mbtree=0 bframes=0 b-adapt=0 ref=1 weightp=0 rc-lookahead=0 "
    "sync-lookahead=0 sliced-threads=0 threads=1"
)
_X264_WITHOUT_VECTORS = f"keyint=infinite {_X264} asm=0"
# As most users run it: the preset chooses B frames, references, lookahead, and QPs of I and B frames.
_X264_PRESET = "psy=0 qpmin=0 scenecut=0 keyint=infinite threads=1"
_X265 = "psy-rd=0 psy-rdoq=0 aq-mode=0 scenecut=0 cutree=0 pools=none frame-threads=1 wpp=0 info=0"
_X265_LOW_DELAY = f"bframes=0 b-adapt=0 ref=1 weightp=0 ipratio=1 rc-lookahead=0 lookahead-slices=0 {_X265}"
_SVTAV1 = (
    "rc=0 aq-mode=0 tune=1 enable-tf=0 scd=0 pred-struct=1 lp=1 use-fixed-qindex-offsets=1 "
    "key-frame-qindex-offset=0 qindex-offsets=[0,0,0,0,0,0]"
)
_SVTAV1_RANDOM_ACCESS = "rc=0 aq-mode=0 tune=1 scd=0 pred-struct=2 lp=1 keyint=-1"


@dataclass(frozen=True)
class AnchorCodec:
    """One anchor: an encoder with its preset and all options that differ from the preset."""

    name: str  # on the command line and in results
    label: str  # in tables and plots
    library: Library  # encoder, as FFmpeg names it
    preset: str
    parameters: str  # words NAME=VALUE in the encoder's syntax, without the QP
    # prediction of frames: none, each from earlier ones only, or with B frames
    structure: Structure
    intra_period: int = 0  # frames from one intra frame to the next; 0: only the first is intra

    @property
    def suffix(self) -> str:
        """Suffix of a file that holds the elementary stream."""
        return _FILES[self.library][0]

    @property
    def file_format(self) -> str:
        """FFmpeg's name of the format of the file."""
        return _FILES[self.library][1]

    def pixel_format(self, *, luma_only: bool) -> Literal["gray", "yuv420p"]:
        """Return the format of the pictures; SVT-AV1 takes no grey and gets chroma of 128."""
        return "gray" if luma_only and self.library != "libsvtav1" else "yuv420p"

    def encoder_qp(self, qp: int) -> int:
        """Return the encoder's quantizer for a QP on the scale of H.264."""
        if not 1 <= qp <= MAX_QP:
            raise ConfigError(f"the QP of an anchor must be 1 to {MAX_QP}, got {qp}")
        if self.library != "libsvtav1":
            return qp
        return min(max(14 + round(5 * (qp - 20) / 3), 1), _MAX_AV1_QP)

    def encoder_parameters(self, qp: int) -> dict[str, str]:
        """Return all parameters by name, the quantizer last."""
        words = [word.partition("=") for word in self.parameters.split()]
        return {name: value for name, _, value in words} | {"qp": str(self.encoder_qp(qp))}


def _anchor(
    name: str, label: str, preset: str, parameters: str, structure: Structure = "ippp", period: int = 0
) -> AnchorCodec:
    library = _LIBRARIES[name.partition("-")[0]]
    return AnchorCodec(name, label, library, preset, parameters, structure, period)


_ALL = (
    _anchor("x264-intra", "x264 intra", "medium", f"keyint=1 {_X264}", "intra"),
    _anchor("x264-ippp", "x264 IPPP", "medium", f"keyint=infinite {_X264}"),
    _anchor("x264-ippp-16", "x264 IPPP, intra every 16", "medium", f"keyint=16 {_X264}", period=16),
    *(
        _anchor(f"x264-{one}", f"x264 IPPP, {one}", one, f"keyint=infinite {_X264}")
        for one in ("ultrafast", "superfast", "veryfast")
    ),
    *(
        _anchor(f"x264-{one}-no-asm", f"x264 IPPP, {one}, no vector code", one, _X264_WITHOUT_VECTORS)
        for one in ("ultrafast", "superfast")
    ),
    _anchor("x264-medium", "x264 medium", "medium", _X264_PRESET, "random access"),
    _anchor("x264-slower", "x264 slower", "slower", _X264_PRESET, "random access"),
    _anchor("x265-intra", "x265 intra", "medium", f"keyint=1 {_X265_LOW_DELAY}", "intra"),
    _anchor("x265", "x265 IPPP", "medium", f"keyint=-1 {_X265_LOW_DELAY}"),
    _anchor("x265-ultrafast", "x265 IPPP, ultrafast", "ultrafast", f"keyint=-1 {_X265_LOW_DELAY}"),
    _anchor("x265-medium", "x265 medium", "medium", f"keyint=-1 {_X265}", "random access"),
    _anchor("svtav1-intra", "SVT-AV1 intra", "5", f"keyint=1 {_SVTAV1}", "intra"),
    _anchor("svtav1", "SVT-AV1 low delay", "5", f"keyint=-1 {_SVTAV1}"),
    _anchor("svtav1-fastest", "SVT-AV1 low delay, fastest", "13", f"keyint=-1 {_SVTAV1}"),
    _anchor("svtav1-6", "SVT-AV1 preset 6", "6", _SVTAV1_RANDOM_ACCESS, "random access"),
)
ANCHOR_CODECS: Final = {codec.name: codec for codec in _ALL}
"""Anchors that are measured as files, by name."""
