"""Sources of the test clips: public files, the frames and the crop taken from them, digests of the clips."""

from dataclasses import dataclass
from fractions import Fraction

GITHUB = "https://raw.githubusercontent.com"
SIZE = (352, 288)
"""Width and height of all clips."""
BOOFCV = ("lessthanoptimal/BoofCV-Data", "cc6d8adf795be2e0c6cc12b42b9ed0c92cab0fcf")
VISP = ("lagadic/visp", "efb30f05ad48e06db9bfd9537203edbe79fcadc3")
VISP_IMAGES = ("lagadic/visp-images", "ca09c52fe0ff9bb0ddd0e5e24c6a635ce0fa8b43")
POSES = ("sofiawu/realtime_pose_estimate", "bb636500d9958fae255ac4517576c31f5457193a")


@dataclass(frozen=True)
class Source:
    """A clip: the file or numbered images that it is made of, and how."""

    repository: str  # on GitHub
    commit: str
    path: str  # path of a video, or pattern of numbered images such as ``image_%04d.png``
    first: int  # number of the first frame or image
    num_frames: int
    size: tuple[int, int]  # size of the source, pixels
    crop: tuple[int, int, int, int]  # x, y, width, height in source pixels
    frame_rate: Fraction
    uncertain: str = ""  # fact that was not recorded when the clip was made

    @property
    def paths(self) -> list[str]:
        """Paths of the files, in order."""
        if "%" not in self.path:
            return [self.path]
        return [self.path % index for index in range(self.first, self.first + self.num_frames)]


DIGESTS = {
    "stone": "a79a1967cc2f70ce3b35e50c36ffa55405e1cb0d2d77f94542cd250ee1c05097",
    "tree": "f50bf5dfdb5aaa3415e235fe6e8a31e4f9f5f43fdf5955ef269365ee1f2f9509",
    "desk": "3957284697f33dc032ac2aa27a56dcafd00b0763d214fa384992b9cc0faf652c",
    "box": "88df223d6d0adb782387b5e23edb33951fb4af36eca66b39348f8635ed59146b",
    "river": "c3ae2b1c0a58701eaec868ab5517cb5cd3fa06f8f2acc7104e568fbf3c32f40b",
    "cube": "8e4621beb5b0834c331952e668aaf3df5e3775b6e855e5aad63732f01188b957",
}
"""SHA-256 digests of the decoded frames, by `sequences.fetch.digest`."""

NO_RATE = "the source states no frame rate; 30 frames per second are assumed"
NO_FOLDER = "only the name of the source file was recorded; its folder is that of the repository"
PORTRAIT, WIDE = ((450, 800), (0, 216, 450, 368)), ((640, 480), (26, 0, 586, 480))
SWEEP = "example/background/river_overview_long_sweep.mp4"
SOURCES: dict[str, Source] = {
    "stone": Source(*BOOFCV, "example/mvs/stone_sign.mp4", 0, 83, *PORTRAIT, Fraction(25)),
    "tree": Source(*BOOFCV, "example/mvs/tree_snow_01.mp4", 0, 80, *PORTRAIT, Fraction(25)),
    "desk": Source(*VISP_IMAGES, "rbt/sequence/color_image_%04d.png", 0, 99, *WIDE, Fraction(30), NO_RATE),
    "box": Source(*POSES, "data/box.mp4", 0, 101, (960, 544), (148, 0, 664, 544), Fraction(30)),
    "river": Source(*BOOFCV, SWEEP, 0, 101, (426, 320), (18, 0, 390, 320), Fraction(30000, 1001), NO_FOLDER),
    "cube": Source(*VISP, "tutorial/grabber/video.mp4", 125, 101, *WIDE, Fraction(25)),
}

NOT_REPEATABLE: dict[str, str] = {
    "foreman_qcif15": "made of a test stream of openh264 whose commit was not recorded",
    "kitchen": "images of andyzeng/tsdf-fusion-python whose commit was not recorded in full",
}
"""Clips that cannot be made again, with the reason."""
