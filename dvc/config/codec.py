# ruff: noqa: RUF009 -- sections are frozen, so that they may be shared
"""The whole configuration of the codec: what an encoder writes into a stream for any decoder to go by.

It travels as JSON-safe dictionaries (`CodecConfig.to_dict`, `CodecConfig.from_dict`) in results, and as bytes
(`dvc.config.header`) in streams.
"""

from dataclasses import dataclass
from typing import Any, Self

from dvc.config.fields import Section, check_choice, check_range
from dvc.config.sections import (
    GeometryConfig,
    GopConfig,
    KeyFrameConfig,
    SideInformationConfig,
    TracksConfig,
    TurboConfig,
    VideoConfig,
    WynerZivConfig,
)
from dvc.config.variants import VARIANTS, variant_of
from dvc.errors import ConfigError


@dataclass(frozen=True)
class CodecConfig(Section):
    """All that encoder and decoder must agree on."""

    codec: str  # one of `VARIANTS`
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
        check_choice("codec", self.codec, VARIANTS)
        check_range("seed", self.seed, 0, 2**31 - 1)
        if self.wyner_ziv.priors == "by-level" and self.gop.references == "all":
            raise ConfigError("frames that are predicted from all others cannot have priors by level")

    @classmethod
    def preset(cls, codec: str, video: VideoConfig, **sections: Any) -> Self:
        """Build the configuration of a variant of the codec.

        Parameters
        ----------
        codec : str
            One of `VARIANTS`.
        video : VideoConfig
            Format of the frames.
        **sections
            Sections that take the place of the variant's, and the seed.

        Returns
        -------
        CodecConfig
            What is not given is as the variant has it; all else at the defaults.

        Raises
        ------
        ConfigError
            If there is no such variant.
        """
        variant = variant_of(codec)
        own = {
            "gop": variant.gop(),
            "side_information": variant.side_information,
            "tracks": variant.tracks,
        }
        return cls(codec, video, **(own | sections))
