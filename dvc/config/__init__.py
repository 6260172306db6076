# ruff: noqa: RUF009 -- sections are frozen, so that they may be shared
"""The codec configuration: everything that changes the decoded frames, and its form in a stream header.

Results hold it as JSON-safe dictionaries (`CodecConfig.to_dict`, `CodecConfig.from_dict`), streams as bytes
(`encode_config`, `decode_config`): MessagePack arrays of the values that differ from the defaults.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import msgspec

from dvc.config.sections import (
    CODERS,
    DEFAULT_CODER,
    DEFAULT_QP,
    DISCOVER_LEVELS,
    FALLBACKS,
    INTRA_PERIOD,
    MAPPERS,
    MAX_GOP_LENGTH,
    MAX_INTRA_PERIOD,
    MAX_POINTS,
    MAX_QP,
    NOISE_MODELS,
    REFERENCES,
    SFM_BACKENDS,
    ZIGZAG,
    CascadeConfig,
    CoderConfig,
    GeometryConfig,
    GopConfig,
    KeyFrameConfig,
    Section,
    SideInformationConfig,
    TracksConfig,
    TurboConfig,
    VideoConfig,
    WynerZivConfig,
    check_choice,
    check_range,
    coder_type,
    field_types,
    is_section,
    key_lambda,
    shown,
)
from dvc.config.variants import (
    DEFAULT_CODEC,
    MAX_NEW_TRACKS,
    MAX_TRACKS_BPP,
    VARIANTS,
    CodecVariant,
    GroupPreset,
    KeyFrameRule,
    variant_of,
)
from dvc.errors import BitstreamError, ConfigError

__all__ = [
    "CODERS",
    "DEFAULT_CODEC",
    "DEFAULT_CODER",
    "DEFAULT_QP",
    "FALLBACKS",
    "INTRA_PERIOD",
    "MAPPERS",
    "MAX_GOP_LENGTH",
    "MAX_INTRA_PERIOD",
    "MAX_NEW_TRACKS",
    "MAX_POINTS",
    "MAX_QP",
    "MAX_TRACKS_BPP",
    "NOISE_MODELS",
    "REFERENCES",
    "SFM_BACKENDS",
    "VARIANTS",
    "ZIGZAG",
    "CascadeConfig",
    "CodecConfig",
    "CodecVariant",
    "CoderConfig",
    "Delivery",
    "DiscoverMatrix",
    "GeometryConfig",
    "GopConfig",
    "GroupPreset",
    "KeyFrameConfig",
    "KeyFrameRule",
    "Live",
    "NoFeedback",
    "ParityBuffer",
    "Qp",
    "Quality",
    "SideInformationConfig",
    "TracksConfig",
    "TurboConfig",
    "VideoConfig",
    "WynerZivConfig",
    "codec_config",
    "decode_config",
    "encode_config",
    "key_lambda",
    "variant_of",
]


@dataclass(frozen=True)
class ParityBuffer:
    """A file with all planes; a decoder takes the bits that it needs."""


@dataclass(frozen=True)
class Live:
    """A feedback channel; a decoder requests the bits that it needs."""


@dataclass(frozen=True)
class NoFeedback:
    """No feedback channel: nothing is sent for Wyner-Ziv frames, and groups have fewer of them."""


Delivery = ParityBuffer | Live | NoFeedback


_KEY_QP = (40, 39, 38, 34, 34, 32, 29, 25)  # for Q1 to Q8: the published choice for the foreman sequence


@dataclass(frozen=True)
class Qp:
    """A quality on H.264's scale: key frames, steps and requests share bits by one Lagrange multiplier.

    Attributes
    ----------
    qp : int
        Quantisation parameter of the key frames, from 1 to `MAX_QP`.
    """

    qp: int = DEFAULT_QP

    def __post_init__(self) -> None:
        check_range("qp", self.qp, 1, MAX_QP)

    @property
    def key_qp(self) -> int:
        """H.264 quantisation parameter of the key frames."""
        return self.qp

    @property
    def wyner_ziv(self) -> WynerZivConfig:
        """Embedded quantisers."""
        return WynerZivConfig(qp=self.qp)


@dataclass(frozen=True)
class DiscoverMatrix:
    """One of the eight quantisation matrices of the DISCOVER codec; all planes are asked for.

    Attributes
    ----------
    q : int
        From 1 (coarsest) to 8 (finest).
    """

    q: int

    def __post_init__(self) -> None:
        if type(self.q) is not int or not 1 <= self.q <= len(DISCOVER_LEVELS):
            raise ConfigError(f"the quantiser must be from 1 to {len(DISCOVER_LEVELS)}, got {shown(self.q)}")

    @property
    def key_qp(self) -> int:
        """H.264 quantisation parameter that gives key frames about the same quality."""
        return _KEY_QP[self.q - 1]

    @property
    def wyner_ziv(self) -> WynerZivConfig:
        """Levels that share the range of each band, and priors by the noise model only."""
        levels = tuple(DISCOVER_LEVELS[self.q - 1][position] for position in ZIGZAG)
        return WynerZivConfig(levels, priors="laplacian")


Quality = Qp | DiscoverMatrix


@dataclass(frozen=True)
class CodecConfig(Section):
    """All that encoder and decoder must agree on; the defaults are those of `codec_config`.

    Attributes
    ----------
    video : VideoConfig
        Format of the frames.
    codec : str
        One of `VARIANTS`.
    gop : GopConfig
        Groups of pictures.
    key : KeyFrameConfig
        Key frames.
    wyner_ziv : WynerZivConfig
        Quantisers, and decoding of the bands.
    coder : CoderConfig
        Coding of bit planes: settings of the chosen coder.
    side_information : SideInformationConfig
        Prediction at the decoder.
    geometry : GeometryConfig
        Structure from motion at the decoder.
    tracks : TracksConfig
        Points that are sent.
    seed : int
        Seed of all random numbers.
    """

    video: VideoConfig
    codec: str = DEFAULT_CODEC
    gop: GopConfig = GopConfig()
    key: KeyFrameConfig = KeyFrameConfig()
    wyner_ziv: WynerZivConfig = WynerZivConfig()
    coder: CoderConfig = CascadeConfig()
    side_information: SideInformationConfig = SideInformationConfig()
    geometry: GeometryConfig = GeometryConfig()
    tracks: TracksConfig = TracksConfig()
    seed: int = 0

    def _check_values(self) -> None:
        check_choice("codec", self.codec, VARIANTS)
        check_range("seed", self.seed, 0, 2**31 - 1)


def codec_config(
    video: VideoConfig,
    codec: str = DEFAULT_CODEC,
    quality: Quality | None = None,
    **overrides: Any,
) -> CodecConfig:
    """Return what codec and quality mean together: the one place where defaults are decided.

    Parameters
    ----------
    video : VideoConfig
        Format of the frames.
    codec : str
        One of `VARIANTS`.
    quality : Qp or DiscoverMatrix, optional
        `Qp()` by default.
    **overrides
        Sections by name that replace the default ones, or tables of the fields that differ from these; also
        the seed.

    Returns
    -------
    CodecConfig
        The configuration.

    Raises
    ------
    ConfigError
        If the codec does not exist, or a value makes no sense.
    """
    quality = quality or Qp()
    variant = variant_of(codec)
    embedded = isinstance(quality, Qp)
    key = KeyFrameConfig(quality.key_qp, intra_period=variant.intra_period if embedded else 0)
    # References and key frames that replace those of the variant change its groups.
    gop, override = overrides.get("gop"), overrides.get("key", key)
    references = str(gop.get("references", variant.references)) if isinstance(gop, Mapping) else None
    override = replace(key, **override) if isinstance(override, Mapping) else override
    period = getattr(override, "intra_period", 0)
    sections: dict[str, Any] = {
        "gop": GopConfig(variant.groups(references, period).length, references or variant.references),
        "key": key,
        "wyner_ziv": quality.wyner_ziv,
        "coder": CascadeConfig(),
        "side_information": variant.side_information,
        "geometry": GeometryConfig(),
        "tracks": variant.tracks,
        "seed": 0,
    }
    for name, override in overrides.items():
        sections[name] = replace(sections[name], **override) if isinstance(override, Mapping) else override
    return CodecConfig(video, codec, **sections)


def encode_config(config: CodecConfig) -> bytes:
    """Write a configuration for a stream header; inverse of `decode_config`.

    A section is an array of its values in the order of its dataclass, that of the coder after its name. Nil
    denotes a default, and a section of defaults; arrays do not end in nil. A configuration
    has exactly one such form, which `docs/spec/bitstream.md` states.

    Parameters
    ----------
    config : CodecConfig
        The configuration.

    Returns
    -------
    bytes
        About 10 bytes, and the values that differ from the defaults.
    """
    return msgspec.msgpack.encode(_values(config))


def _values(section: Section) -> list[Any] | None:
    """Return the values of a section's fields, `None` for defaults; `None` for a section of defaults."""
    values: list[Any] = []
    if isinstance(section, CoderConfig):
        values.append(None if section.name == DEFAULT_CODER else section.name)
    for field in fields(section):
        value = getattr(section, field.name)
        values.append(
            _values(value) if isinstance(value, Section) else None if value == field.default else value
        )
    while values and values[-1] is None:
        values.pop()
    return values or None


def decode_config(data: bytes) -> CodecConfig:
    """Read a configuration from a stream header; inverse of `encode_config`.

    Parameters
    ----------
    data : bytes
        As `encode_config` returns it.

    Returns
    -------
    CodecConfig
        The configuration.

    Raises
    ------
    BitstreamError
        If the bytes are damaged, of a newer program, or hold values that make no sense.
    """
    try:
        values = msgspec.msgpack.decode(data)
        config = CodecConfig.from_dict(_table(CodecConfig, values, "configuration"))
    except (ConfigError, msgspec.DecodeError, TypeError, UnicodeDecodeError, RecursionError) as err:
        raise BitstreamError(f"configuration: {err}") from err
    if encode_config(config) != data:
        raise BitstreamError("configuration: not in its one form")
    return config


def _table(section: type[Section], values: Any, name: str) -> dict[str, Any]:
    """Return the fields of a section that are not left out, for `Section.from_dict`."""
    if not isinstance(values, list):
        raise ConfigError(f"`{name}` must be an array, got {shown(values)}")
    types = field_types(section)
    if section is CoderConfig:
        types = {"name": str, **field_types(coder_type((values or [None])[0] or DEFAULT_CODER))}
    if len(values) > len(types):
        raise ConfigError(f"`{name}` has {len(values)} values, {len(types)} known: made by a newer program?")
    return {
        field: _table(hint, value, field) if is_section(hint) else value
        for (field, hint), value in zip(types.items(), values, strict=False)
        if value is not None
    }
