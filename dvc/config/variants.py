"""Variants of the codec: prediction, transmitted geometry, and groups of pictures of each."""

from dataclasses import dataclass

from dvc.config.sections import INTRA_PERIOD, SideInformationConfig, TracksConfig, check_choice
from dvc.errors import ConfigError

MAX_TRACKS_BPP = 0.01
"""Largest cost of tracks, in bits per pixel of the Wyner-Ziv frames."""
MAX_NEW_TRACKS = 48
"""Largest number of points of the closing key frame that are tracked backwards."""


@dataclass(frozen=True)
class KeyFrameRule:
    """Conditions for a key frame that the tracks request."""

    longest_track_px: float = 40.0  # distance that a point has moved since the key frame
    lost_share: float = 0.5  # share of the points lost since then
    min_length: int = 2  # frames from one key frame to the next, unless the scene changes
    cut_share: float = 0.9  # share of the points lost from one frame to the next at a cut

    def __post_init__(self) -> None:
        if not self.longest_track_px > 0:
            raise ConfigError(f"the longest track must be above 0 pixels, got {self.longest_track_px}")
        for share in (self.lost_share, self.cut_share):
            if not 0 < share <= 1:
                raise ConfigError(f"the share of lost tracks must be above 0 and at most 1, got {share}")
        if self.min_length < 1:
            raise ConfigError(f"the shortest group must have at least 1 frame, got {self.min_length}")


@dataclass(frozen=True)
class GroupPreset:
    """Groups of pictures of a variant: their largest length, and the rule that ends one earlier."""

    length: int
    key_frames: KeyFrameRule = KeyFrameRule()


@dataclass(frozen=True)
class CodecVariant:
    """One variant of the codec.

    Attributes
    ----------
    summary : str
        Short description of the prediction.
    side_information : SideInformationConfig
        Prediction at the decoder.
    tracks : TracksConfig
        Transmitted geometry.
    references : str
        Kind of reference frames, one of `dvc.config.REFERENCES`.
    usual_groups : GroupPreset
        Groups of pictures.
    groups_of_keys : GroupPreset or None
        Groups if only key frames are references; None: the same.
    intra_groups : GroupPreset or None
        Groups if no key frame is predicted, so that each costs more; None: the same.
    intra_period : int
        Largest distance of IDR pictures in frames; 0: no key frame is predicted.
    """

    summary: str
    side_information: SideInformationConfig
    tracks: TracksConfig
    references: str
    usual_groups: GroupPreset
    groups_of_keys: GroupPreset | None = None
    intra_groups: GroupPreset | None = None
    intra_period: int = 0

    def groups(self, references: str | None = None, intra_period: int | None = None) -> GroupPreset:
        """Return the groups for kinds of references and key frames, which are the variant's by default."""
        if (references or self.references) == "keys" and self.groups_of_keys is not None:
            return self.groups_of_keys
        intra_period = self.intra_period if intra_period is None else intra_period
        if not intra_period and self.intra_groups is not None:
            return self.intra_groups
        return self.usual_groups


_DEPTH = SideInformationConfig()
_WITHOUT_POINTS = TracksConfig("none", subpixel_bits=0)

VARIANTS = {
    "2d": CodecVariant(
        summary="block motion",
        side_information=SideInformationConfig("mci"),
        tracks=_WITHOUT_POINTS,
        references="keys",
        usual_groups=GroupPreset(2),
    ),
    "3d": CodecVariant(
        summary="a reconstruction of the scene",
        side_information=_DEPTH,
        tracks=_WITHOUT_POINTS,
        references="keys",
        usual_groups=GroupPreset(2),
    ),
    "3d-td": CodecVariant(
        summary="the scene, with cameras from corners of every frame, which the decoder matches",
        side_information=_DEPTH,
        # As many points per frame as in the thesis.
        tracks=TracksConfig("decoder", num_points=176, subpixel_bits=0),
        references="hierarchical",
        usual_groups=GroupPreset(10),
    ),
    "3d-te": CodecVariant(
        summary="the scene, with cameras from points that the encoder tracks, which set the key frames, too",
        side_information=_DEPTH,
        tracks=TracksConfig("encoder", subpixel_bits=1),  # half pixels save more than they cost
        references="hierarchical",
        # By `benchmarks.searches.settings rule.lost_share=0.35 rule.lost_share=0.68` at QP 28 and 36 the nine
        # clips of the results take 1.1 and 2.5 % more; `gop.length=16` saved nothing on box, desk and river.
        usual_groups=GroupPreset(8, KeyFrameRule(longest_track_px=64.0, lost_share=0.45)),
        groups_of_keys=GroupPreset(8),
        intra_groups=GroupPreset(16, KeyFrameRule(longest_track_px=64.0, lost_share=0.68)),
        intra_period=INTRA_PERIOD,
    ),
}
"""All variants by name, from the simplest to the best."""

DEFAULT_CODEC = "3d-te"
"""The best codec: it falls back to block motion if the scene is not static."""


def variant_of(codec: str) -> CodecVariant:
    """Return a variant by its name.

    Parameters
    ----------
    codec : str
        One of `VARIANTS`.

    Returns
    -------
    CodecVariant
        The variant.

    Raises
    ------
    ConfigError
        If no variant has that name.
    """
    check_choice("codec", codec, VARIANTS)
    return VARIANTS[codec]
