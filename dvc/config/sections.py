"""The codec configuration: one frozen dataclass per part of the codec, nested in `CodecConfig`.

It travels as JSON-safe dictionaries (`CodecConfig.to_dict`, `CodecConfig.from_dict`) in results, and as bytes
(`dvc.config.header`) in streams.
"""

import base64
import binascii
import math
import re
from dataclasses import MISSING, dataclass, fields, is_dataclass
from typing import Any, Self, get_type_hints

from dvc.errors import ConfigError

CODECS = ("2d", "3d", "3d-td", "3d-te")
REFERENCES = ("keys", "hierarchical", "all")
TRACKS_KINDS = ("none", "encoder", "decoder")
SFM_BACKENDS = ("native", "colmap")
TURBO_FAMILIES = ("adaptive", "classical")
NOISE_MODELS = ("frame", "band", "coefficient", "local")
NUM_BANDS = 16
MAX_SIDE_PX = 16384
MAX_AREA_PX = 2**24
MAX_GOP_LENGTH = 256
MAX_POINTS = 1024
CRC_BITS = (8, 12, 16, 24, 32)
MAX_PARAMETER_SETS_BYTES = 1024

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
_METHOD_OF_CODEC = {"2d": "mci", "3d": "mesh", "3d-td": "mesh", "3d-te": "mesh"}
_TRACKS_OF_CODEC = {"2d": "none", "3d": "none", "3d-td": "decoder", "3d-te": "encoder"}
_POINTS_OF_CODEC = {"3d-td": 176}  # of each frame, as many as there are in the thesis
_SUBPIXEL_BITS_OF_CODEC = {"3d-te": 1}  # half pixels: what they cost is less than what they save
_NAME = re.compile(r"[a-z0-9_-]{1,32}")


def _shown(value: object) -> str:
    if isinstance(value, int) and value.bit_length() > 64:
        return f"a number of {value.bit_length()} bits"
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _check_range(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise ConfigError(f"`{name}` must be from {low} to {high}, got {_shown(value)}")


def _check_choice(name: str, value: str, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise ConfigError(f"`{name}` must be one of {', '.join(choices)}, got {_shown(value)}")


def type_hints_of(section: Any) -> dict[str, Any]:
    """Return the types of a section's fields.

    Parameters
    ----------
    section : type
        A section's class.

    Returns
    -------
    dict
        Type by name, in the order of the fields.
    """
    return get_type_hints(section)


def _check_type(name: str, value: object, hint: Any) -> None:
    if hint == tuple[int, ...]:
        good = isinstance(value, tuple) and all(type(item) is int for item in value)
        expected = "a sequence of integers"
    elif hint is float:
        good = type(value) is float and math.isfinite(value)
        expected = "a finite number"
    else:
        good = type(value) is hint
        expected = f"of type {hint.__name__}"
    if not good:
        raise ConfigError(f"`{name}` must be {expected}, got {_shown(value)}")


class _Section:
    """Check the type of every field, then what the section itself demands of the values."""

    def __post_init__(self) -> None:
        for name, hint in type_hints_of(type(self)).items():
            value = getattr(self, name)
            if hint is float and type(value) is int and abs(value) < 2**53:
                value = float(value)
                object.__setattr__(self, name, value)
            _check_type(name, value, hint)
        self._check_values()

    def _check_values(self) -> None:
        """Raise `ConfigError` for values that make no sense; the types are right already."""


@dataclass(frozen=True)
class VideoConfig(_Section):
    """Format of the frames that are coded."""

    width: int  # in pixels
    height: int  # in pixels
    frame_rate_num: int  # frames per second, as a fraction
    frame_rate_den: int
    luma_only: bool = False  # no chroma is coded

    def _check_values(self) -> None:
        _check_range("width", self.width, 1, MAX_SIDE_PX)
        _check_range("height", self.height, 1, MAX_SIDE_PX)
        if self.width * self.height > MAX_AREA_PX:
            raise ConfigError(
                f"a frame must have {MAX_AREA_PX} pixels or fewer, got {self.width}x{self.height}"
            )
        _check_range("frame_rate_num", self.frame_rate_num, 1, 2**31 - 1)
        _check_range("frame_rate_den", self.frame_rate_den, 1, 2**31 - 1)

    @property
    def num_blocks(self) -> int:
        """Number of 4x4 blocks that cover a frame: the length of every band and bit plane."""
        return -(-self.width // 4) * -(-self.height // 4)


@dataclass(frozen=True)
class GopConfig(_Section):
    """Spacing of the key frames."""

    length: int = 2  # frames from one key frame to the next; 1: key frames only
    # What frames are predicted from: the key frames; also the middle frame, decoded first, and so on; or
    # every frame of the group that has been decoded, in the same order.
    references: str = "keys"

    def _check_values(self) -> None:
        _check_range("length", self.length, 1, MAX_GOP_LENGTH)
        _check_choice("references", self.references, REFERENCES)


@dataclass(frozen=True)
class KeyFrameConfig(_Section):
    """H.264 intra coding of the key frames."""

    qp: int = 34  # quantisation parameter
    lossless: bool = False  # code the samples exactly; `qp` plays no part
    parameter_sets: bytes = b""  # what the H.264 decoder needs once, before the first key frame

    def _check_values(self) -> None:
        _check_range("qp", self.qp, 1, 51)
        size = len(self.parameter_sets)
        if size > MAX_PARAMETER_SETS_BYTES:
            raise ConfigError(f"`parameter_sets` is limited to {MAX_PARAMETER_SETS_BYTES} bytes, got {size}")


@dataclass(frozen=True)
class WynerZivConfig(_Section):
    """Quantisation of the Wyner-Ziv frames and decoding of their bands."""

    levels: tuple[int, ...] = tuple(
        PRESET_LEVELS[3][position] for position in ZIGZAG
    )  # per band, zigzag order
    # Positions in coding order of the bands after which the side information is refined; after the last one
    # it always is.
    refine_after: tuple[int, ...] = (0, 1, 2, 3, 4, 6, 8, 10)
    max_llr: float = 9.0  # bound on the magnitude of the prior LLR of a bit
    noise_model: str = "local"  # how the scale of the correlation noise follows from the references
    initial_gain: float = 1.3  # factor on that scale before anything of a frame is decoded

    def _check_values(self) -> None:
        if len(self.levels) != NUM_BANDS:
            raise ConfigError(f"`levels` must have {NUM_BANDS} entries, got {len(self.levels)}")
        for number in self.levels:
            if number != 0 and (not 2 <= number <= 256 or number & (number - 1)):
                raise ConfigError(
                    f"`levels` must hold 0 or powers of two from 2 to 256, got {_shown(number)}"
                )
        if not any(self.levels):
            raise ConfigError("`levels` must send at least one band")
        if len(self.refine_after) > NUM_BANDS or any(not 0 <= n < NUM_BANDS for n in self.refine_after):
            raise ConfigError(f"`refine_after` must hold numbers of bands below {NUM_BANDS}")
        if any(b <= a for a, b in zip(self.refine_after, self.refine_after[1:], strict=False)):
            raise ConfigError(f"`refine_after` must increase, got {_shown(self.refine_after)}")
        if not 0 < self.max_llr <= 100:
            raise ConfigError(f"`max_llr` must be above 0 and at most 100, got {self.max_llr}")
        _check_choice("noise_model", self.noise_model, NOISE_MODELS)
        _check_range("initial_gain", self.initial_gain, 0.01, 100.0)

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
    def num_planes(self) -> int:
        """Number of bit planes of a frame, over all bands."""
        return sum(number.bit_length() - 1 for number in self.levels if number)


@dataclass(frozen=True)
class TurboConfig(_Section):
    """Slepian-Wolf coding of the bit planes."""

    family: str = "adaptive"  # set of turbo codes that the decoder chooses from
    interleaver_seed: int = 1
    crc_bits: int = 16  # length of the checksum that the encoder computes for each bit plane
    first_crc_bits: int = 8  # of these, how many the decoder asks for at once; more only where it is in doubt

    def _check_values(self) -> None:
        _check_choice("family", self.family, TURBO_FAMILIES)
        _check_range("interleaver_seed", self.interleaver_seed, 0, 2**31 - 1)
        if self.crc_bits not in CRC_BITS:
            raise ConfigError(f"`crc_bits` must be one of {CRC_BITS}, got {_shown(self.crc_bits)}")
        _check_range("first_crc_bits", self.first_crc_bits, 1, self.crc_bits)


@dataclass(frozen=True)
class SideInformationConfig(_Section):
    """Prediction of the Wyner-Ziv frames at the decoder."""

    method: str = "mci"  # name of the method; the decoder knows which there are
    block_size: int = 8  # side of a block in pixels: 4, 8 or 16
    search_radius: int = 16  # of the motion search, in pixels of the coarsest level
    smoothness: int = 6  # weight of smooth motion against matching blocks
    track_corrections: bool = False  # move what is rendered to where neighbouring tracks agree that it is

    def _check_values(self) -> None:
        if not _NAME.fullmatch(self.method):
            raise ConfigError(
                f"`method` must be 1 to 32 of the characters a-z 0-9 _ -, got {_shown(self.method)}"
            )
        if self.block_size not in (4, 8, 16):
            raise ConfigError(f"`block_size` must be 4, 8 or 16, got {_shown(self.block_size)}")
        _check_range("search_radius", self.search_radius, 0, 64)
        _check_range("smoothness", self.smoothness, 0, 1000)


@dataclass(frozen=True)
class GeometryConfig(_Section):
    """Structure from motion at the decoder, for methods of side information that need it."""

    backend: str = "native"  # whose estimators: the project's own, or COLMAP's
    path_regularity: float = 0.0  # weight of second differences of the camera's path, with respect to tracks

    def _check_values(self) -> None:
        _check_choice("backend", self.backend, SFM_BACKENDS)
        _check_range("path_regularity", self.path_regularity, 0.0, 100.0)


@dataclass(frozen=True)
class TracksConfig(_Section):
    """Feature points that the encoder sends."""

    kind: str = "none"  # nothing; tracks of points of the key frame; or points, to be matched at the decoder
    num_points: int = 128  # most of them: tracks that begin with a group, or points of a frame
    subpixel_bits: int = 0  # binary digits of their coordinates after the point

    def _check_values(self) -> None:
        _check_choice("kind", self.kind, TRACKS_KINDS)
        _check_range("num_points", self.num_points, 1, MAX_POINTS)
        _check_range("subpixel_bits", self.subpixel_bits, 0, 3)


@dataclass(frozen=True)
class CodecConfig(_Section):
    """All that encoder and decoder must agree on."""

    codec: str  # one of `CODECS`
    video: VideoConfig
    gop: GopConfig = GopConfig()
    key: KeyFrameConfig = KeyFrameConfig()
    wyner_ziv: WynerZivConfig = WynerZivConfig()
    turbo: TurboConfig = TurboConfig()
    side_information: SideInformationConfig = SideInformationConfig()
    geometry: GeometryConfig = GeometryConfig()
    tracks: TracksConfig = TracksConfig()
    seed: int = 0  # of all randomness but the interleavers

    def _check_values(self) -> None:
        _check_choice("codec", self.codec, CODECS)
        _check_range("seed", self.seed, 0, 2**31 - 1)

    def to_dict(self) -> dict[str, Any]:
        """Return the configuration as JSON-safe values; inverse of `from_dict`.

        Returns
        -------
        dict
            One entry per field, sections as dictionaries, bytes in base64.
        """
        return _to_json(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Self:
        """Rebuild a configuration from JSON-safe values; fields that are left out take their defaults.

        Parameters
        ----------
        values : dict
            As `to_dict` returns it.

        Returns
        -------
        CodecConfig
            The configuration.

        Raises
        ------
        ConfigError
            If a name is unknown, a value is missing, of the wrong type or out of range.
        """
        built = _build(cls, values, "configuration")
        assert isinstance(built, cls)
        return built


def _check_preset(q: int) -> None:
    if type(q) is not int or not 1 <= q <= len(PRESET_LEVELS):
        raise ConfigError(f"the quantiser must be from 1 to {len(PRESET_LEVELS)}, got {_shown(q)}")


def side_information_for(codec: str) -> SideInformationConfig:
    """Return the side information that a codec predicts with unless told otherwise.

    Parameters
    ----------
    codec : str
        One of `CODECS`.

    Returns
    -------
    SideInformationConfig
        Its method; all else at the defaults.

    Raises
    ------
    ConfigError
        If there is no such codec.
    """
    _check_choice("codec", codec, CODECS)
    return SideInformationConfig(method=_METHOD_OF_CODEC[codec])


def gop_for(codec: str, length: int | None = None, references: str | None = None) -> GopConfig:
    """Return the groups of pictures of a codec, as far as nothing else is wanted.

    Parameters
    ----------
    codec : str
        One of `CODECS`.
    length : int, optional
        Frames from one key frame to the next, with tracks that set key frames the most of them.
    references : str, optional
        One of `REFERENCES`.

    Returns
    -------
    GopConfig
        Codecs with tracked points predict from decoded frames, and have longer groups.

    Raises
    ------
    ConfigError
        If there is no such codec, or a value makes no sense.
    """
    kind = tracks_for(codec).kind
    chosen = references or ("keys" if kind == "none" else "hierarchical")
    usual = {"none": 2, "decoder": 10, "encoder": 8 if chosen == "keys" else 16}
    return GopConfig(usual[kind] if length is None else length, chosen)


def tracks_for(codec: str) -> TracksConfig:
    """Return the feature points that a codec sends unless told otherwise.

    Parameters
    ----------
    codec : str
        One of `CODECS`.

    Returns
    -------
    TracksConfig
        Their kind, number and precision; all else at the defaults.

    Raises
    ------
    ConfigError
        If there is no such codec.
    """
    _check_choice("codec", codec, CODECS)
    return TracksConfig(
        _TRACKS_OF_CODEC[codec],
        _POINTS_OF_CODEC.get(codec, TracksConfig.num_points),
        _SUBPIXEL_BITS_OF_CODEC.get(codec, TracksConfig.subpixel_bits),
    )


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


def _to_json(section: _Section) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for name in type_hints_of(type(section)):
        value = getattr(section, name)
        if isinstance(value, _Section):
            value = _to_json(value)
        elif isinstance(value, bytes):
            value = base64.b64encode(value).decode("ascii")
        elif isinstance(value, tuple):
            value = list(value)
        values[name] = value
    return values


def _from_json(name: str, value: Any, hint: Any) -> Any:
    if hint is bytes and isinstance(value, str):
        try:
            return base64.b64decode(value, validate=True)
        except (binascii.Error, ValueError) as err:
            raise ConfigError(f"`{name}` must be base64, got {_shown(value)}") from err
    return tuple(value) if isinstance(value, list) else value


def _build(section: Any, values: Any, name: str) -> Any:
    """Build a section from a dictionary of JSON values or of the fields themselves."""
    if not isinstance(values, dict):
        raise ConfigError(f"`{name}` must be a table of fields, got {_shown(values)}")
    hints = type_hints_of(section)
    unknown = [key for key in values if key not in hints]
    if unknown:
        raise ConfigError(f"`{name}` has no field {_shown(unknown[0])}; fields are {', '.join(hints)}")
    arguments: dict[str, Any] = {}
    for field in fields(section):
        if field.name not in values:
            if field.default is MISSING:
                raise ConfigError(f"`{name}` lacks the field `{field.name}`")
            continue
        hint, value = hints[field.name], values[field.name]
        arguments[field.name] = (
            _build(hint, value, field.name) if is_dataclass(hint) else _from_json(field.name, value, hint)
        )
    return section(**arguments)
