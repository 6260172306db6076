"""The sections of the codec configuration: one frozen dataclass per part of the codec."""

import re
from dataclasses import dataclass
from typing import Self

from dvc.config.fields import Section, check_choice, check_range, shown
from dvc.errors import ConfigError

REFERENCES = ("keys", "hierarchical", "all")
TRACKS_KINDS = ("none", "encoder", "decoder")
FALLBACKS = ("block-motion", "tracks")
SFM_BACKENDS = ("native", "colmap")
TURBO_FAMILIES = ("adaptive", "classical", "cascade")
NOISE_MODELS = ("frame", "band", "coefficient", "local")
QUANTIZERS = ("range", "nested")
PRIORS = ("laplacian", "learned", "by-level")
NUM_BANDS = 16
MAX_SIDE_PX = 16384
MAX_AREA_PX = 2**24
MAX_GOP_LENGTH = 256
MAX_INTRA_PERIOD = 1024
MAX_POINTS = 1024
MAX_PARAMETER_SETS_BYTES = 1024
MAX_SLOPE = 1e6
MAX_HIERARCHY = 8
MAX_BAND_PLANES = 12
"""Most bit planes of a band of nested bins: steps of 1 over all coefficients that there are."""

ZIGZAG = (0, 1, 4, 8, 5, 2, 3, 6, 9, 12, 13, 10, 7, 11, 14, 15)
"""Raster position in the 4x4 block of each band, in zigzag order."""

PRESET_LEVELS = (
    (16, 8, 0, 0, 8, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0),
    (32, 8, 0, 0, 8, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0),
    (32, 8, 4, 0, 8, 4, 0, 0, 4, 0, 0, 0, 0, 0, 0, 0),
    (32, 16, 8, 4, 16, 8, 4, 0, 8, 4, 0, 0, 4, 0, 0, 0),
    (32, 16, 8, 4, 16, 8, 4, 4, 8, 4, 4, 0, 4, 4, 0, 0),
    (64, 16, 8, 8, 16, 8, 8, 4, 8, 8, 4, 4, 8, 4, 4, 0),
    (64, 32, 16, 8, 32, 16, 8, 4, 16, 8, 4, 4, 8, 4, 4, 0),
    (128, 64, 32, 16, 64, 32, 16, 8, 32, 16, 8, 4, 16, 8, 4, 0),
)
"""Levels of each band for Q1 to Q8, in raster order of the 4x4 block; 0 where a band is not sent."""

_KEY_QP = (40, 39, 38, 34, 34, 32, 29, 25)  # for Q1 to Q8: the published choice for the foreman sequence
_NAME = re.compile(r"[a-z0-9_-]{1,32}")


@dataclass(frozen=True)
class VideoConfig(Section):
    """Format of the frames that are coded."""

    width: int  # in pixels
    height: int  # in pixels
    frame_rate_num: int  # frames per second, as a fraction
    frame_rate_den: int
    luma_only: bool = False  # no chroma is coded

    def _check_values(self) -> None:
        check_range("width", self.width, 1, MAX_SIDE_PX)
        check_range("height", self.height, 1, MAX_SIDE_PX)
        if self.width * self.height > MAX_AREA_PX:
            raise ConfigError(
                f"a frame must have {MAX_AREA_PX} pixels or fewer, got {self.width}x{self.height}"
            )
        check_range("frame_rate_num", self.frame_rate_num, 1, 2**31 - 1)
        check_range("frame_rate_den", self.frame_rate_den, 1, 2**31 - 1)

    @property
    def num_blocks(self) -> int:
        """Number of 4x4 blocks that cover a frame: the length of every band and bit plane."""
        return -(-self.width // 4) * -(-self.height // 4)


@dataclass(frozen=True)
class GopConfig(Section):
    """Spacing of the key frames."""

    length: int = 2  # frames from one key frame to the next; 1: key frames only
    # What frames are predicted from: the key frames; also the middle frame, decoded first, and so on; or
    # every frame of the group that has been decoded, in the same order.
    references: str = "keys"
    # Groups may end with a Wyner-Ziv frame that is predicted from earlier frames alone. In these the last
    # frame, and others not more than this apart, are anchors, decoded first; 0: key frames end all groups.
    anchor_distance: int = 0
    intra_period: int = 0  # most frames from one key frame to the next where there are such groups

    def _check_values(self) -> None:
        check_range("length", self.length, 1, MAX_GOP_LENGTH)
        check_choice("references", self.references, REFERENCES)
        check_range("anchor_distance", self.anchor_distance, 0, MAX_GOP_LENGTH)
        check_range("intra_period", self.intra_period, 0, MAX_INTRA_PERIOD)
        if bool(self.anchor_distance) != bool(self.intra_period):
            raise ConfigError("`anchor_distance` and `intra_period` are given together or not at all")


@dataclass(frozen=True)
class KeyFrameConfig(Section):
    """H.264 intra coding of the key frames."""

    qp: int = 34  # quantisation parameter
    lossless: bool = False  # code the samples exactly; `qp` plays no part
    parameter_sets: bytes = b""  # what the H.264 decoder needs once, before the first key frame

    def _check_values(self) -> None:
        check_range("qp", self.qp, 1, 51)
        size = len(self.parameter_sets)
        if size > MAX_PARAMETER_SETS_BYTES:
            raise ConfigError(f"`parameter_sets` is limited to {MAX_PARAMETER_SETS_BYTES} bytes, got {size}")


@dataclass(frozen=True)
class WynerZivConfig(Section):
    """Quantisation of the Wyner-Ziv frames and decoding of their bands."""

    levels: tuple[int, ...] = tuple(
        PRESET_LEVELS[3][position] for position in ZIGZAG
    )  # per band, zigzag order
    noise_model: str = "local"  # how the scale of the correlation noise follows from the references
    # Bins: `levels` that share the range of a band in its frame; or nested ones, whose step the frame tells.
    quantizer: str = "range"
    # Squared error that a bit must save, or its plane is not asked for; 0: all planes are.
    slope: float = 0.0
    # Percent of `slope` that holds for a frame with references up to 2, 4, 8, ... frames apart, the last
    # beyond; none: all the same.
    slope_percent: tuple[int, ...] = ()
    # Priors of bits: as the correlation noise has them; or corrected by what was decoded, with neighbours:
    # all of the group before; or the frame itself, and frames before those with which it is decoded side by
    # side, since none of them is predicted from another.
    priors: str = "laplacian"

    def _check_values(self) -> None:
        if len(self.levels) != NUM_BANDS:
            raise ConfigError(f"`levels` must have {NUM_BANDS} entries, got {len(self.levels)}")
        for number in self.levels:
            if number != 0 and (not 2 <= number <= 256 or number & (number - 1)):
                raise ConfigError(f"`levels` must hold 0 or powers of two from 2 to 256, got {shown(number)}")
        if not any(self.levels):
            raise ConfigError("`levels` must send at least one band")
        check_choice("noise_model", self.noise_model, NOISE_MODELS)
        check_choice("quantizer", self.quantizer, QUANTIZERS)
        check_choice("priors", self.priors, PRIORS)
        check_range("slope", self.slope, 0.0, MAX_SLOPE)
        if len(self.slope_percent) > MAX_HIERARCHY or any(not 0 < n <= 100 for n in self.slope_percent):
            raise ConfigError(f"`slope_percent` must hold at most {MAX_HIERARCHY} numbers from 1 to 100")

    @classmethod
    def preset(cls, q: int) -> Self:
        """Build one of the eight quantisation presets of the DISCOVER family.

        Parameters
        ----------
        q : int
            From 1 (coarsest) to 8 (finest).

        Returns
        -------
        WynerZivConfig
            Its levels; all else at the defaults.

        Raises
        ------
        ConfigError
            If there is no such preset.
        """
        _check_preset(q)
        return cls(tuple(PRESET_LEVELS[q - 1][position] for position in ZIGZAG))

    @property
    def max_planes(self) -> tuple[int, ...]:
        """Most bit planes of each band; 0 for one that is not sent."""
        if self.quantizer == "nested":
            return (MAX_BAND_PLANES,) * NUM_BANDS
        return tuple(max(number.bit_length() - 1, 0) for number in self.levels)

    def slope_between(self, distance: int) -> float:
        """Return the slope for a frame by the distance of its references.

        Parameters
        ----------
        distance : int
            Frames from one to the other of the references around it, at least 2.

        Returns
        -------
        float
            Squared error that a bit must save; 0: all planes are asked for.
        """
        if not self.slope_percent:
            return self.slope
        level = min((distance - 1).bit_length(), len(self.slope_percent)) - 1
        return self.slope * self.slope_percent[level] / 100


@dataclass(frozen=True)
class TurboConfig(Section):
    """Slepian-Wolf coding of the bit planes."""

    family: str = "adaptive"  # set of turbo codes that the decoder chooses from, or parities of ranges
    interleaver_seed: int = 1
    # With parities of ranges, what the answers to a request are to tell, in percent of what is not known of
    # the plane; 0: as little as costs the fewest bits, in the most requests.
    batch_percent: int = 0
    # Bits that they are to tell beyond that share; above 0, orders that are not in use yet help with it.
    batch_bits: int = 0

    def _check_values(self) -> None:
        check_choice("family", self.family, TURBO_FAMILIES)
        check_range("interleaver_seed", self.interleaver_seed, 0, 2**31 - 1)
        check_range("batch_percent", self.batch_percent, 0, 100)
        check_range("batch_bits", self.batch_bits, 0, 1000 if self.batch_percent else 0)
        if self.batch_percent and self.family != "cascade":
            raise ConfigError("`batch_percent` is for parities of ranges, family `cascade`")


@dataclass(frozen=True)
class SideInformationConfig(Section):
    """Prediction of the Wyner-Ziv frames at the decoder."""

    method: str = "mci"  # name of the method; the decoder knows which there are
    track_corrections: bool = False  # move what is rendered to where neighbouring tracks agree that it is
    # What serves beside a model of the scene, and alone where there is none, if points are sent: block motion
    # after that of the whole frame; or references that are warped by the points, pixel by pixel.
    fallback: str = "block-motion"

    def _check_values(self) -> None:
        if not _NAME.fullmatch(self.method):
            raise ConfigError(
                f"`method` must be 1 to 32 of the characters a-z 0-9 _ -, got {shown(self.method)}"
            )
        check_choice("fallback", self.fallback, FALLBACKS)


@dataclass(frozen=True)
class GeometryConfig(Section):
    """Structure from motion at the decoder, for methods of side information that need it."""

    backend: str = "native"  # whose estimators: the project's own, or COLMAP's
    path_regularity: float = 0.0  # weight of second differences of the camera's path, with respect to tracks

    def _check_values(self) -> None:
        check_choice("backend", self.backend, SFM_BACKENDS)
        check_range("path_regularity", self.path_regularity, 0.0, 100.0)


@dataclass(frozen=True)
class TracksConfig(Section):
    """Feature points that the encoder sends."""

    kind: str = "none"  # nothing; tracks of points of the key frame; or points, to be matched at the decoder
    num_points: int = 128  # most of them: tracks that begin with a group, or points of a frame
    subpixel_bits: int = 0  # binary digits of their coordinates after the point

    def _check_values(self) -> None:
        check_choice("kind", self.kind, TRACKS_KINDS)
        check_range("num_points", self.num_points, 1, MAX_POINTS)
        check_range("subpixel_bits", self.subpixel_bits, 0, 3)


def _check_preset(q: int) -> None:
    if type(q) is not int or not 1 <= q <= len(PRESET_LEVELS):
        raise ConfigError(f"the quantiser must be from 1 to {len(PRESET_LEVELS)}, got {shown(q)}")


def key_qp_for(wz_q: int) -> int:
    """Return the key-frame QP that gives key and Wyner-Ziv frames about the same quality.

    Parameters
    ----------
    wz_q : int
        Quantisation preset, 1 to 8.

    Returns
    -------
    int
        H.264 quantisation parameter.

    Raises
    ------
    ConfigError
        If there is no such preset.
    """
    _check_preset(wz_q)
    return _KEY_QP[wz_q - 1]
