# ruff: noqa: RUF009 -- sections are frozen, so that they may be shared
"""The whole configuration of the codec, as an encoder writes it into a stream.

Results hold it as JSON-safe dictionaries (`CodecConfig.to_dict`, `CodecConfig.from_dict`), streams as bytes
(`dvc.config.header`).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from dvc.config.fields import Section, check_choice, check_range, shown
from dvc.config.sections import (
    DEFAULT_QP,
    DISCOVER_LEVELS,
    MAX_QP,
    ZIGZAG,
    CascadeConfig,
    CoderConfig,
    GeometryConfig,
    GopConfig,
    KeyFrameConfig,
    SideInformationConfig,
    TracksConfig,
    VideoConfig,
    WynerZivConfig,
)
from dvc.config.variants import DEFAULT_CODEC, VARIANTS, CodecVariant, variant_of
from dvc.errors import ConfigError


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
        """Refuse values off the scale."""
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
        """Refuse a matrix that does not exist."""
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
    sections: dict[str, Any] = {
        "gop": _gop_config(variant, key, overrides),
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


def _gop_config(variant: CodecVariant, key: KeyFrameConfig, overrides: Mapping[str, Any]) -> GopConfig:
    """Return the default groups of pictures for a variant and overrides of its references and key frames."""
    gop, key_override = overrides.get("gop"), overrides.get("key")
    references = str(gop.get("references", variant.references)) if isinstance(gop, Mapping) else None
    period = key.intra_period
    if isinstance(key_override, KeyFrameConfig):
        period = key_override.intra_period
    elif isinstance(key_override, Mapping):
        period = key_override.get("intra_period", period)
    return GopConfig(variant.groups(references, period).length, references or variant.references)
