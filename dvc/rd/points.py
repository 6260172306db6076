"""Points of an experiment: a sequence, a codec and its options; and what identifies the result of one."""

import re
from dataclasses import asdict, dataclass
from typing import Any

from dvc.config import VARIANTS
from dvc.rd.anchors.codecs import ANCHOR_CODECS
from dvc.rd.anchors.version import anchors_digest
from dvc.rd.provenance import CodeVersion, values_digest
from dvc.rd.sources import Source
from dvc.versions import library_versions

SCHEMA = "dvc3d-rd-point/1"
"""Of the result of a point."""
INTRA = "h264-intra"
ANCHORS = {"intra": INTRA, **{name: name for name in ANCHOR_CODECS}}
"""Codecs to compare with, by the names that the command line knows."""
NO_FEEDBACK = "no-feedback"
"""Option of the encoder that makes a file which no decoder asks for."""
CODECS = (*VARIANTS, *ANCHORS.values())


@dataclass(frozen=True)
class Point:
    """One point of a rate-distortion curve, before it is measured."""

    sequence: str  # name of the catalogue, or a path
    codec: str  # one of `CODECS`
    wz_q: int | None  # DISCOVER matrix; None where there is none
    key_qp: str  # QP of the key frames, ``"auto"`` or ``"lossless"``
    gop: int  # frames from one key frame to the next; 0 where only the first is one
    start: int = 0  # first frame
    frames: int | None = None  # number of frames; None for all
    luma_only: bool = False  # whether chroma is left out
    # further options of the encoder without their dashes, sorted; the value ``"true"`` stands for a flag
    options: tuple[tuple[str, str], ...] = ()
    # method that the decoder predicts with instead of what the stream names
    side_information: str | None = None
    qp: int | None = None  # quality that sets key frames, steps and requests together, in place of a matrix
    decoder: tuple[tuple[str, str], ...] = ()  # further options of the decoder, as in `options`
    proof: bool = True  # whether a fresh process decodes the punctured stream, too

    @property
    def has_wyner_ziv(self) -> bool:
        """Whether there are frames that are not key frames."""
        return self.gop != 1 and (self.wz_q is not None or self.qp is not None)

    @property
    def no_feedback(self) -> bool:
        """Whether the encoder's own file is what is decoded, and no decoder asks for any bit of it."""
        return (NO_FEEDBACK, "true") in self.options

    def encoder_options(self) -> list[str]:
        """Return the options of the encoder that make this point."""
        words = ["--codec", "2d" if self.codec == INTRA else self.codec]
        words += ["--gop", str(self.gop), "--key-qp", self.key_qp, "--start", str(self.start)]
        if self.wz_q is not None:
            words += ["--wz-q", str(self.wz_q)]
        if self.qp is not None:
            words += ["--qp", str(self.qp)]
        if self.frames is not None:
            words += ["--frames", str(self.frames)]
        if self.luma_only:
            words.append("--luma-only")
        return words + _words(self.options)

    def decoder_options(self) -> list[str]:
        """Return the options of the decoder that make this point."""
        method = [] if self.side_information is None else ["--side-information", self.side_information]
        return method + _words(self.decoder)

    def to_dict(self) -> dict[str, Any]:
        """Return what makes the point, apart from the sequence, as JSON-safe values."""
        values = asdict(self)
        del values["sequence"]
        for name in ("side_information", "qp"):
            if values[name] is None:
                del values[name]
        values["options"] = dict(self.options)
        del values["decoder"]
        if self.proof:
            del values["proof"]
        return values | ({"decoder": dict(self.decoder)} if self.decoder else {})


@dataclass(frozen=True)
class Task:
    """A point with everything that identifies its result."""

    point: Point  # what to measure
    source: Source  # on what
    code: CodeVersion  # with which code

    @property
    def name(self) -> str:
        """Name of the result file without suffix: what a reader looks for, then what makes it unique."""
        point = self.point
        preset = "" if point.wz_q is None else f"-q{point.wz_q}"
        key_qp = str(point.qp) if point.qp is not None and point.key_qp == "auto" else _plain(point.key_qp)
        unique = values_digest([point.to_dict(), self.source.digest])[:8]
        return f"{self.source.name}-{point.codec}{preset}-qp{key_qp}-{unique}"

    @property
    def identity(self) -> str:
        """Digest of configuration, input, code and libraries: equal if the result would be."""
        code = (self.code.version, self.code.digest)
        if self.point.codec in ANCHOR_CODECS:
            code = ("anchors", self.code_digest)
        made_by = [*code, library_versions()]
        return values_digest([SCHEMA, self.point.to_dict(), self.source.digest, made_by])

    @property
    def code_digest(self) -> str:
        """Digest of the code that makes the result: of the codec, or of what runs an anchor's encoder."""
        return anchors_digest() if self.point.codec in ANCHOR_CODECS else self.code.digest


def anchor_gop(codec: str) -> int:
    """Return how far apart the intra frames of an anchor are."""
    if codec == INTRA or ANCHOR_CODECS[codec].structure == "intra":
        return 1
    return ANCHOR_CODECS[codec].intra_period


def _words(options: tuple[tuple[str, str], ...]) -> list[str]:
    """Return options as arguments of a command."""
    given = [[f"--{name}"] if value == "true" else [f"--{name}", value] for name, value in options]
    return [word for words in given for word in words]


def _plain(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9]+", "_", text)[:20]
