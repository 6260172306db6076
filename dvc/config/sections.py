"""The sections of the codec configuration: a frozen dataclass of checked fields for each part."""

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import MISSING, dataclass, fields
from fractions import Fraction
from functools import cache
from typing import Any, Self, TypeGuard, get_type_hints

import msgspec

from dvc import extensions
from dvc.errors import ConfigError
from dvc.extensions import PLANE_CODERS, Registry
from dvc.limits import MAX_SIDE_PX

REFERENCES = ("keys", "hierarchical", "all")
TRACKS_KINDS = ("none", "encoder", "decoder")
FALLBACKS = ("block-motion", "tracks")
SFM_BACKENDS = ("native", "colmap", "thesis")
MAPPERS = SFM_BACKENDS[:2]
NOISE_MODELS = ("frame", "band", "coefficient", "local")
"""Names of the models of `dvc.wynerziv.noise`."""
PRIORS = ("laplacian", "learned")
NUM_BANDS = 16
MAX_AREA_PX = 2**24
MAX_GOP_LENGTH = 256
MAX_INTRA_PERIOD = 1024
MAX_POINTS = 1024
MAX_PARAMETER_SETS_BYTES = 1024
MAX_QP = 51
DEFAULT_QP = 30
LAMBDA_PER_KEY_LAMBDA = 6.0
"""Lagrange multiplier of frames that predict no other, relative to that of key frames: 4 and 9 change the
rate at equal PSNR by -.3 and +1.2 %, and requests by +44 and -32 %. By `benchmarks.searches.settings --qp 28
36 --frames 33 dvc.config.sections.LAMBDA_PER_KEY_LAMBDA=9 --clips box desk river stone street tree`."""
INTRA_PERIOD = 96
"""Largest number of frames from one IDR picture to the next: decoding can start every three seconds."""
LAMBDA_PERCENT = (100, 60, 40, 30, 30)
"""Percentage of that multiplier for frames with references up to 2, 4, 8, ... frames apart, which predict
more frames; the last also beyond."""
STEP_PER_ROOT_LAMBDA = 3.0
"""Finest step over the root of the multiplier: a bit of a fine uniform quantiser saves 2 ln 2 / 12 squared
steps."""
MAX_BAND_PLANES = 12
"""Largest number of bit planes of an embedded quantiser: steps of 1 over the range of all coefficients."""

ZIGZAG = (0, 1, 4, 8, 5, 2, 3, 6, 9, 12, 13, 10, 7, 11, 14, 15)
"""Raster position in the 4x4 block of each band, in zigzag order."""

DISCOVER_LEVELS = (
    (16, 8, 0, 0, 8, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0),
    (32, 8, 0, 0, 8, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0),
    (32, 8, 4, 0, 8, 4, 0, 0, 4, 0, 0, 0, 0, 0, 0, 0),
    (32, 16, 8, 4, 16, 8, 4, 0, 8, 4, 0, 0, 4, 0, 0, 0),
    (32, 16, 8, 4, 16, 8, 4, 4, 8, 4, 4, 0, 4, 4, 0, 0),
    (64, 16, 8, 8, 16, 8, 8, 4, 8, 8, 4, 4, 8, 4, 4, 0),
    (64, 32, 16, 8, 32, 16, 8, 4, 16, 8, 4, 4, 8, 4, 4, 0),
    (128, 64, 32, 16, 64, 32, 16, 8, 32, 16, 8, 4, 16, 8, 4, 0),
)
"""Levels of each band for Q1 to Q8, in raster order of the 4x4 block; 0 if a band is not sent."""


def shown(value: object) -> str:
    """Write a value into a message, cut short if it is long."""
    if isinstance(value, int) and value.bit_length() > 64:
        return f"a number of {value.bit_length()} bits"
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def check_range(name: str, value: float, low: float, high: float) -> None:
    """Refuse a number out of range."""
    if not low <= value <= high:
        raise ConfigError(f"`{name}` must be from {low} to {high}, got {shown(value)}")


def check_choice(name: str, value: str, choices: Collection[str]) -> None:
    """Refuse a name that is not among the choices."""
    if value not in choices:
        if isinstance(choices, Registry):
            raise ConfigError(choices.missing(shown(value)))
        raise ConfigError(f"`{name}` must be one of {', '.join(choices)}, got {shown(value)}")


field_types: Callable[[Any], Mapping[str, Any]] = cache(get_type_hints)
"""Types of a section's fields by name."""


def is_section(hint: Any) -> "TypeGuard[type[Section]]":
    """Return whether the type of a field is a section."""
    return isinstance(hint, type) and issubclass(hint, Section)


@dataclass(frozen=True)
class Section:
    """Part of a configuration: each field has its type, and the values pass the checks of the section."""

    def __post_init__(self) -> None:
        for name, hint in field_types(type(self)).items():
            value = getattr(self, name)
            if is_section(hint):
                result = value if isinstance(value, hint) else hint.from_dict(value, name)
            else:
                try:
                    result = msgspec.convert(value, hint)
                except (msgspec.ValidationError, OverflowError) as err:
                    raise ConfigError(f"`{name}` is {shown(value)}: {err}") from err
            if isinstance(result, float) and not math.isfinite(result):
                raise ConfigError(f"`{name}` must be a finite number, got {shown(value)}")
            object.__setattr__(self, name, result)
        self._check_values()

    def _check_values(self) -> None:
        """Raise `ConfigError` for values that make no sense; the types are right already."""

    def to_dict(self) -> dict[str, Any]:
        """Return the section as JSON-safe values; inverse of `from_dict`."""
        values: dict[str, Any] = {}
        for name in field_types(type(self)):
            value = getattr(self, name)
            value = list(value) if isinstance(value, tuple) else value
            values[name] = value.to_dict() if isinstance(value, Section) else msgspec.to_builtins(value)
        return values

    @classmethod
    def from_dict(cls, values: Any, name: str = "configuration") -> Self:
        """Build the section from a table of fields; those that are left out take their defaults."""
        if not isinstance(values, dict):
            raise ConfigError(f"`{name}` must be a table of fields, got {shown(values)}")
        defaults = {field.name: field.default for field in fields(cls)}
        for key in values:
            if key not in defaults:
                raise ConfigError(f"`{name}` has no field {shown(key)}; fields are {', '.join(defaults)}")
        for key, default in defaults.items():
            if default is MISSING and key not in values:
                raise ConfigError(f"`{name}` lacks the field `{key}`")
        return cls(**values)


@dataclass(frozen=True)
class VideoConfig(Section):
    """Format of the coded frames."""

    width: int  # in pixels
    height: int  # in pixels
    frame_rate_num: int  # frames per second, as a fraction
    frame_rate_den: int
    luma_only: bool = False  # whether chroma is left out

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
    def frame_rate(self) -> Fraction:
        """Frames per second."""
        return Fraction(self.frame_rate_num, self.frame_rate_den)

    @property
    def num_blocks(self) -> int:
        """Number of 4x4 blocks that cover a frame: the length of every band and bit plane."""
        return -(-self.width // 4) * -(-self.height // 4)


@dataclass(frozen=True)
class GopConfig(Section):
    """Groups of pictures."""

    length: int = 8  # largest number of frames of a group; 1: key frames only
    # Reference frames: the key frames; also the middle frame, decoded first, and so on; or all decoded frames
    # of the group, in the same order.
    references: str = "hierarchical"

    def _check_values(self) -> None:
        check_range("length", self.length, 1, MAX_GOP_LENGTH)
        check_choice("references", self.references, REFERENCES)


@dataclass(frozen=True)
class KeyFrameConfig(Section):
    """H.264 coding of the key frames."""

    qp: int = DEFAULT_QP  # quantisation parameter, of predicted key frames if any
    lossless: bool = False  # code the samples exactly; `qp` plays no part
    intra_period: int = INTRA_PERIOD  # largest distance of IDR pictures; 0: all key frames are such
    parameter_sets: bytes = b""  # parameter sets that the H.264 decoder needs before the first key frame

    @property
    def predicted(self) -> bool:
        """Whether key frames are predicted from earlier ones."""
        return self.intra_period > 0

    def _check_values(self) -> None:
        check_range("qp", self.qp, 1, MAX_QP)
        check_range("intra_period", self.intra_period, 0, MAX_INTRA_PERIOD)
        size = len(self.parameter_sets)
        if size > MAX_PARAMETER_SETS_BYTES:
            raise ConfigError(f"`parameter_sets` is limited to {MAX_PARAMETER_SETS_BYTES} bytes, got {size}")


def key_lambda(qp: int) -> float:
    """Return the distortion that a bit of an H.264 picture saves: the Lagrange multiplier of its encoders.

    Parameters
    ----------
    qp : int
        H.264 quantisation parameter.

    Returns
    -------
    float
        Squared error per bit, 0.85 * 2^((QP - 12) / 3).

    References
    ----------
    T. Wiegand, B. Girod, "Lagrange multiplier selection in hybrid video coder control", ICIP 2001.
    """
    return float(0.85 * 2.0 ** ((qp - 12) / 3))


@dataclass(frozen=True)
class WynerZivConfig(Section):
    """Quantisation of the Wyner-Ziv frames and decoding of their bands."""

    # Levels that share the range of each band in its frame, as in the DISCOVER codec, in zigzag order; none:
    # embedded quantisers with steps that the frame states.
    levels: tuple[int, ...] = ()
    noise_model: str = "local"  # model of the scale of the correlation noise
    qp: int = DEFAULT_QP  # quality on H.264's scale: sets the steps of embedded quantisers
    # Priors of bits: by the correlation noise, or corrected by decoded bits and neighbours in the frame and
    # in earlier frames that are not decoded in parallel.
    priors: str = "learned"
    limited: bool = False  # whether each group states a limit of requests for its frames, for a bitrate

    def _check_values(self) -> None:
        if self.levels and len(self.levels) != NUM_BANDS:
            raise ConfigError(f"`levels` must have {NUM_BANDS} entries or none, got {len(self.levels)}")
        for number in self.levels:
            if number != 0 and (not 2 <= number <= 256 or number & (number - 1)):
                raise ConfigError(f"`levels` must hold 0 or powers of two from 2 to 256, got {shown(number)}")
        if self.levels and not any(self.levels):
            raise ConfigError("`levels` must send at least one band")
        check_choice("noise_model", self.noise_model, NOISE_MODELS)
        check_choice("priors", self.priors, PRIORS)
        check_range("qp", self.qp, 1, MAX_QP)
        if self.limited and self.levels:
            raise ConfigError("`limited` requires embedded quantisers: their last planes can be left out")

    @property
    def embedded(self) -> bool:
        """Whether quantisers are embedded, so that frames differ in their planes."""
        return not self.levels

    @property
    def max_planes(self) -> tuple[int, ...]:
        """Largest number of bit planes of each band; 0 for one that is not sent."""
        if self.embedded:
            return (MAX_BAND_PLANES,) * NUM_BANDS
        return tuple(max(number.bit_length() - 1, 0) for number in self.levels)

    def step(self, distance: int) -> float:
        """Return the width of the finest bins of a frame with embedded quantisers.

        Parameters
        ----------
        distance : int
            Number of frames between the references around it, at least 2.

        Returns
        -------
        float
            Step in coefficient units.
        """
        level = min((distance - 1).bit_length(), len(LAMBDA_PERCENT)) - 1
        percent = LAMBDA_PER_KEY_LAMBDA * LAMBDA_PERCENT[level]
        return STEP_PER_ROOT_LAMBDA * math.sqrt(percent / 100 * key_lambda(self.qp))


@dataclass(frozen=True)
class SideInformationConfig(Section):
    """Prediction of the Wyner-Ziv frames at the decoder."""

    method: str = "depth"  # name of a method of the decoder
    track_corrections: bool = True  # correct rendered positions by neighbouring tracks that agree
    # Prediction next to or without a model of the scene, if points are sent: block motion after that of the
    # whole frame, or references that are warped by the points, pixel by pixel.
    fallback: str = "tracks"

    def _check_values(self) -> None:
        if not extensions.NAME.fullmatch(self.method):
            raise ConfigError(
                f"`method` must be 1 to 32 of the characters a-z 0-9 _ -, got {shown(self.method)}"
            )
        check_choice("fallback", self.fallback, FALLBACKS)


@dataclass(frozen=True)
class GeometryConfig(Section):
    """Structure from motion at the decoder, for methods of side information that need it."""

    backend: str = "native"  # estimators: native, of COLMAP, or of the thesis as written
    path_regularity: float = 0.0  # weight of second differences of the camera's path, relative to tracks

    def _check_values(self) -> None:
        check_choice("backend", self.backend, SFM_BACKENDS)
        check_range("path_regularity", self.path_regularity, 0.0, 100.0)


@dataclass(frozen=True)
class TracksConfig(Section):
    """Feature points that the encoder sends."""

    kind: str = "encoder"  # none; tracks of points of the key frame; or points, matched at the decoder
    num_points: int = 128  # largest number of tracks that begin with a group, or of points of a frame
    subpixel_bits: int = 1  # binary digits of their coordinates after the point

    def _check_values(self) -> None:
        check_choice("kind", self.kind, TRACKS_KINDS)
        check_range("num_points", self.num_points, 1, MAX_POINTS)
        check_range("subpixel_bits", self.subpixel_bits, 0, 3)


@dataclass(frozen=True)
class CoderConfig(Section):
    """Settings of the coder of bit planes; results and streams also hold its name."""

    @property
    def name(self) -> str:
        """One of `CODERS`."""
        return next(name for name, coder in CODERS.items() if type(self) is coder)

    def to_dict(self) -> dict[str, Any]:
        """Return the name and the settings as JSON-safe values; inverse of `from_dict`."""
        return {"name": self.name, **super().to_dict()}

    @classmethod
    def from_dict(cls, values: Any, name: str = "coder") -> Self:
        """Build the settings of the coder that is named, by default `DEFAULT_CODER`."""
        if cls is not CoderConfig or not isinstance(values, dict):
            return super().from_dict(values, name)
        kind = coder_type(values.get("name", DEFAULT_CODER))
        settings = kind.from_dict({key: value for key, value in values.items() if key != "name"}, name)
        assert isinstance(settings, cls)
        return settings


@dataclass(frozen=True)
class CascadeConfig(CoderConfig):
    """Parities of ranges that the decoder chooses."""

    # Information of the answers to a request, in percent of the unknown bits of the run; 0: the least
    # information and the fewest bits. 12 and 6 save .3 and .5 % of the rate for 1.3 and 2.1 times the
    # requests (`benchmarks.searches.settings coder.batch_percent=6 --qp 28 36 --frames 33 --clips box desk
    # tree stone river street`).
    batch_percent: int = 20

    def _check_values(self) -> None:
        check_range("batch_percent", self.batch_percent, 0, 100)


@dataclass(frozen=True)
class TurboConfig(CoderConfig):
    """The classical pair of recursive convolutional codes, punctured; it has no settings."""


@cache
def _extension(name: str) -> type[CoderConfig]:
    """Return the settings of a coder that another package registers: none."""
    return type(name, (CoderConfig,), {"__reduce__": lambda self: (_build_extension, (name,))})


def _build_extension(name: str) -> CoderConfig:
    return _extension(name)()


CODERS: Registry[type[CoderConfig]] = Registry(
    PLANE_CODERS, {"cascade": CascadeConfig, "turbo": TurboConfig}, _extension
)
"""All coders by name."""
DEFAULT_CODER = "cascade"


def coder_type(name: object) -> type[CoderConfig]:
    """Return the type of the settings of a coder, one of `CODERS`."""
    if not isinstance(name, str):
        raise ConfigError(f"`name` of a coder must be a string, got {shown(name)}")
    check_choice("coder", name, CODERS)
    return CODERS[name]
