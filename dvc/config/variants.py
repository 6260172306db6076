"""Variants of the codec: how each predicts, what it sends of the geometry, and its groups of pictures."""

from dataclasses import dataclass

from dvc.config.delivery import Delivery, EstimatedRate
from dvc.config.fields import check_choice
from dvc.config.sections import SideInformationConfig, TracksConfig
from dvc.errors import ConfigError

KEY_FRAME_CHOICES = ("tracks", "rate")
"""What decides where a group ends."""
MAX_TRACKS_BPP = 0.01
"""Most bits that tracks cost, per pixel of the Wyner-Ziv frames."""
MAX_NEW_TRACKS = 48
"""Most points of the key frame that closes a group which are followed back."""


@dataclass(frozen=True)
class KeyFrameRule:
    """When the tracks ask for a key frame."""

    longest_track_px: float = 40.0  # a point has moved so far since the key frame
    lost_share: float = 0.5  # so many of the points are lost since then
    min_length: int = 2  # frames from one key frame to the next, unless the scene changes
    cut_share: float = 0.9  # so many points that are lost from one frame to the next are another scene
    # How groups end but for cuts: "tracks", by the first two bounds, or "rate", at the least estimated rate.
    choice: str = "tracks"
    hierarchical: bool = False  # Wyner-Ziv frames are references, too

    def __post_init__(self) -> None:
        """Refuse values that make no sense."""
        if not self.longest_track_px > 0:
            raise ConfigError(f"the longest track must be above 0 pixels, got {self.longest_track_px}")
        for share in (self.lost_share, self.cut_share):
            if not 0 < share <= 1:
                raise ConfigError(f"the share of lost tracks must be above 0 and at most 1, got {share}")
        if self.choice not in KEY_FRAME_CHOICES:
            raise ConfigError(
                f"key frames are chosen by {' or '.join(KEY_FRAME_CHOICES)}, not {self.choice!r}"
            )
        if self.min_length < 1:
            raise ConfigError(f"the shortest group must have at least 1 frame, got {self.min_length}")


@dataclass(frozen=True)
class GroupPreset:
    """Groups of pictures of a variant: how long they are, and when tracks end one before that."""

    length: int
    key_frames: KeyFrameRule = KeyFrameRule()


@dataclass(frozen=True)
class CodecVariant:
    """One variant of the codec.

    Attributes
    ----------
    summary : str
        What it predicts by, in a few words.
    side_information : SideInformationConfig
        How the decoder predicts.
    tracks : TracksConfig
        What is sent of the geometry.
    references : str
        What frames are predicted from, one of `dvc.config.REFERENCES`.
    usual_groups : GroupPreset
        Its groups of pictures.
    groups_of_keys : GroupPreset or None
        Those where key frames alone are references; None: the same.
    groups_of_estimated_rate : GroupPreset or None
        Those where the encoder estimates rates; None: the same. Frames far from key frames need the most
        bits, and these can only be estimated: key frames are worth their rate earlier.
    """

    summary: str
    side_information: SideInformationConfig
    tracks: TracksConfig
    references: str
    usual_groups: GroupPreset
    groups_of_keys: GroupPreset | None = None
    groups_of_estimated_rate: GroupPreset | None = None

    def groups(self, references: str | None = None, delivery: Delivery | None = None) -> GroupPreset:
        """Return the groups of pictures that suit what frames are predicted from.

        Parameters
        ----------
        references : str, optional
            One of `dvc.config.REFERENCES`; the variant's own by default.
        delivery : Delivery, optional
            How they get to the decoder.

        Returns
        -------
        GroupPreset
            Shorter ones where key frames alone are references and points are tracked, or rates are estimated.
        """
        if (references or self.references) == "keys" and self.groups_of_keys is not None:
            return self.groups_of_keys
        if isinstance(delivery, EstimatedRate) and self.groups_of_estimated_rate is not None:
            return self.groups_of_estimated_rate
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
        # Of each frame as many points as there are in the thesis.
        tracks=TracksConfig("decoder", num_points=176, subpixel_bits=0),
        references="hierarchical",
        usual_groups=GroupPreset(10),
    ),
    "3d-te": CodecVariant(
        summary="the scene, with cameras from points that the encoder tracks, which set the key frames, too",
        side_information=_DEPTH,
        tracks=TracksConfig("encoder", subpixel_bits=1),  # half pixels save more than they cost
        references="hierarchical",
        usual_groups=GroupPreset(16, KeyFrameRule(longest_track_px=64.0, lost_share=0.68, hierarchical=True)),
        groups_of_keys=GroupPreset(8),
        groups_of_estimated_rate=GroupPreset(
            16, KeyFrameRule(longest_track_px=40.0, lost_share=0.5, hierarchical=True)
        ),
    ),
}
"""All variants by name, from the simplest to the best."""

DEFAULT_CODEC = "3d-te"
"""The best: it predicts by block motion by itself where there is no static scene."""


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
        If there is none of that name.
    """
    check_choice("codec", codec, VARIANTS)
    return VARIANTS[codec]
