"""What README and docs claim, and the rows behind each claim."""

from dataclasses import dataclass

Name = tuple[str, str]
"""Area and name of a figure."""


@dataclass(frozen=True)
class Claim:
    """A claim of the documentation.

    Attributes
    ----------
    says : str
        The claim, in a sentence.
    where : tuple of str
        Documents that make it.
    rows : tuple of (str, str)
        Area and name of the figures behind it, all of their clips.
    """

    says: str
    where: tuple[str, ...]
    rows: tuple[Name, ...]


def _claim(says: str, where: str, *rows: str) -> Claim:
    names = [row.partition("/") for row in rows]
    return Claim(says, tuple(where.split(", ")), tuple((area, name) for area, _, name in names))


CLAIMS = (
    _claim(
        "With presets 3D-DVC-TE needs less rate than H.264 intra, −35 % on the mean.",
        "docs/results.md",
        "tracks/te-hierarchical-intra",
        "tracks/te-hierarchical-intra-mean",
        "tracks/te-intra",
    ),
    _claim(
        "It needs less rate than H.264 that predicts each frame from the last one without motion.",
        "docs/results.md",
        "anchors/te-x264-ippp-zero",
        "anchors/te-x264-ippp-zero-mean",
    ),
    _claim(
        "It is asked to need less rate than H.264 with motion search, too; docs say that it does not.",
        "docs/results.md",
        "anchors/te-x264-ippp",
        "anchors/te-x264-ippp-mean",
    ),
    _claim(
        "It needs less rate than 2D-DVC, −30 % on the mean.",
        "docs/results.md",
        "tracks/te-hierarchical-2d",
        "tracks/te-hierarchical-2d-mean",
        "tracks/te-2d",
        "tracks/te-2d-mean",
    ),
    _claim(
        "With one quality for everything it needs less rate than H.264 intra, and than H.264 without motion.",
        "README.md, docs/results.md",
        "allocation/te-qp-intra",
        "allocation/te-qp-intra-mean",
        "allocation/te-qp-zero-motion",
        "allocation/te-qp-zero-motion-mean",
    ),
    _claim(
        "It is asked to need little more rate than H.264 with motion search and one intra frame.",
        "README.md, docs/results.md",
        "allocation/te-qp-x264-ippp",
        "allocation/te-qp-x264-ippp-mean",
    ),
    _claim(
        "It is asked to need less rate than H.264 with motion search and an intra frame every 16.",
        "README.md, docs/results.md",
        "allocation/te-qp-x264-ippp-16",
        "allocation/te-qp-x264-ippp-16-mean",
    ),
    _claim(
        "It is asked to need less rate than 2D-DVC with the same allocation, and than presets.",
        "README.md, docs/results.md",
        "allocation/te-qp-2d",
        "allocation/te-qp-2d-mean",
        "allocation/te-qp-presets",
        "allocation/te-qp-presets-mean",
    ),
    _claim(
        "Prediction from decoded frames, hierarchically, needs less rate than from key frames alone.",
        "docs/side_information_tracks.md",
        "tracks/hierarchical",
        "tracks/hierarchical-mean",
        "tracks/hierarchical-si",
        "tracks/hierarchical-si-mean",
        "tracks/hierarchical-si-same-keys",
        "tracks/hierarchical-si-same-keys-mean",
    ),
    _claim(
        "The encoder takes less processor time than x264 intra, tracking included.",
        "README.md, docs/results.md",
        "tracks/te-encoder-cpu",
        "codec/encode-cpu",
        "tracks/te-operations",
    ),
    _claim(
        "Tracks cost few bits.",
        "docs/side_information_tracks.md",
        "tracks/te-overhead",
        "tracks/td-overhead",
    ),
    _claim(
        "By regression the same tracks cost less than by filters.",
        "docs/tracks.md",
        "tracks/track-bits",
        "tracks/track-bits-mean",
    ),
    _claim(
        "A decoder needs seconds for a frame, and two jobs are nearly twice as fast.",
        "docs/results.md",
        "codec/decode-time-cif",
        "codec/decode-time-qcif",
        "tracks/te-decoding-time",
        "codec/decode-jobs",
    ),
    _claim(
        "2D-DVC needs less rate than openDVC and H.264 intra, with key and WZ frames of like quality.",
        "docs/rd/2d.md",
        "rd/foreman-opendvc",
        "rd/foreman-intra",
        "rd/intra",
        "rd/key-wz-balance",
    ),
    _claim(
        "Tracked points give better side information than block motion.",
        "docs/side_information_tracks.md",
        "tracks/te",
        "tracks/te-scenes",
        "tracks/te-mean",
        "tracks/te-gop10",
        "tracks/te-gop10-scenes",
        "tracks/te-gop10-mean",
    ),
    _claim(
        "So do points that the decoder matches.",
        "docs/tracking_at_the_decoder.md",
        "tracks/td",
        "tracks/td-mean",
    ),
    _claim(
        "Dense depth predicts better than epipolar blocks, and two costs of depth better than one.",
        "docs/scene.md",
        "tracks/depth-blocks",
        "tracks/depth-blocks-mean",
        "tracks/te-depths",
        "tracks/te-depths-mean",
    ),
    _claim(
        "The scene without tracks predicts no worse than block motion.",
        "docs/scene.md",
        "side information/blind",
        "side information/blind-mean",
    ),
    _claim(
        "With true cameras, the scene predicts well.",
        "docs/scene.md",
        "side information/depth-true-cameras",
        "side information/blocks-true-cameras",
    ),
    _claim(
        "Side information is better than that of a prototype, and near its ceiling.",
        "docs/side_information_tracks.md",
        "tracks/te-prototype",
        "tracks/te-prototype-mean",
        "tracks/ceiling",
        "tracks/ceiling-mean",
        "tracks/lossy-keys",
    ),
    _claim(
        "Options that are off by default gain little.",
        "docs/side_information_tracks.md",
        "tracks/option-fused-mean",
        "tracks/option-corrections-mean",
        "tracks/option-regularity-mean",
        "tracks/option-subpixel-mean",
    ),
    _claim(
        "Structure from motion is accurate, and its bundle adjustment fast.",
        "docs/scene.md",
        "sfm/epipolar-error",
        "sfm/epipolar-error-qp42",
        "sfm/correspondences",
        "sfm/bundle-adjustment",
        "sfm/time",
    ),
    _claim(
        "Turbo codes come near the entropy, and errors slip through hardly ever.",
        "README.md",
        "turbo/efficiency-0.01",
        "turbo/efficiency-0.03",
        "turbo/efficiency-0.07",
        "turbo/efficiency-0.12",
        "turbo/efficiency-0.20",
        "turbo/undetected-errors",
    ),
    _claim(
        "Streams decode to the same bytes on any x86-64 processor, with any number of jobs and threads.",
        "README.md, docs/bitstream.md",
        "house/golden-streams",
        "house/golden-libraries",
        "house/golden-compiler",
        "house/golden-c-library",
        "house/golden-1-thread",
        "house/golden-2-threads",
        "house/golden-qemu",
        "side information/determinism",
    ),
    _claim(
        "Damaged input does no harm.",
        "docs/bitstream.md",
        "robustness/streams",
        "robustness/geometry",
        "robustness/pictures",
        "robustness/depth-images",
        "robustness/messages",
    ),
    _claim(
        "The anchors are as good as the reference software.",
        "docs/anchors.md",
        "anchors/intra",
        "anchors/zero-motion",
        "anchors/moving-vectors",
    ),
    _claim(
        "Memory does not grow with the video, and commands start quickly.",
        "README.md",
        "codec/memory",
        "codec/help-time",
        "codec/short-encode-time",
    ),
    _claim(
        "The report is made, loaded and shown quickly, and its BD figures are right.",
        "docs/results.md",
        "report/time",
        "report/size",
        "report/first-paint",
        "report/bd-peer",
        "report/quick-reproduction",
    ),
    _claim(
        "Surfaces have as few bad pixels as the thesis's, and fewer than OpenCV's.",
        "docs/stereo.md",
        "stereo/bad-pixels-tsukuba",
        "stereo/bad-pixels-venus",
        "stereo/bad-pixels-teddy",
        "stereo/bad-pixels-cones",
        "stereo/against-opencv",
        "stereo/tsukuba-2-cameras",
        "stereo/tsukuba-5-cameras",
        "stereo/tsukuba-25-cameras",
        "stereo/antinous",
    ),
    _claim(
        "Surfaces agree, occlusions are found, and layers and sprites hold all that is seen.",
        "docs/stereo.md, docs/layers.md",
        "stereo/consistency-tsukuba",
        "stereo/consistency-cones",
        "stereo/toy",
        "stereo/layers-2-cameras",
        "stereo/layers-5-cameras",
        "stereo/layers-25-cameras",
        "stereo/sprites",
    ),
    _claim(
        "Rectification is exact, and as good as OpenCV's on real pairs.",
        "docs/rectification.md",
        "stereo/rectification-identities",
        "stereo/rows-sport",
        "stereo/rows-ballet",
    ),
    _claim(
        "Surfaces take seconds, and little memory.",
        "docs/stereo.md",
        "stereo/time-tsukuba",
        "stereo/time-teddy",
        "stereo/time-25-cameras",
        "stereo/two-jobs",
        "stereo/large-pair",
    ),
    _claim(
        "Disparities chosen for their bits beat quadtrees, blocks and independent estimation.",
        "docs/dibr.md, docs/dibr-results.md",
        "dibr/bd-teddy-l",
        "dibr/bd-teddy-s",
        "dibr/bd-tsukuba",
        "dibr/bd-others",
        "dibr/bd-pairs",
        "dibr/blocks",
        "dibr/exhaustive",
        "dibr/layers-cost",
        "dibr/share",
        "dibr/independent-sgbm",
        "dibr/independent-stereo",
    ),
    _claim(
        "The codec of the reference view is as good as JPEG 2000, and all of it takes seconds.",
        "docs/dibr.md, docs/dibr-results.md",
        "dibr/jpeg2000-0.25-bpp",
        "dibr/jpeg2000-0.5-bpp",
        "dibr/jpeg2000-1-bpp",
        "dibr/reference-time",
        "dibr/time-l",
        "dibr/time-s",
        "dibr/large",
    ),
    _claim(
        "Wavelets that stop at edges code depth better than standard ones and than other codecs.",
        "docs/dibr.md, docs/shape-adaptive-results.md",
        "shape-adaptive/depth-teddy",
        "shape-adaptive/depth-gain",
        "shape-adaptive/depth-edges",
        "shape-adaptive/depth-others",
        "shape-adaptive/depth-peers",
        "shape-adaptive/image-gain",
        "shape-adaptive/rendered-views",
        "shape-adaptive/reconstruction",
        "shape-adaptive/depth-time",
    ),
)
"""In the order of the documents."""
