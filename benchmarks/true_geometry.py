"""P-type frames by a scene that is known exactly: `python -m benchmarks.true_geometry [SCENE ...]`.

Rendered scenes are coded with the default codec. Each P-type frame for which there is a scene is drawn once
more from the same two decoded frames, with true depth and true cameras in place of those that the decoder
found: that is as far as better maps alone can go. Beside it stands block motion that is found with the
original, as in `benchmarks.p_type_prediction`.
"""

import sys
import tempfile
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.p_type_prediction import RecordingExtrapolation, block_motion, decoded_p_types
from benchmarks.results.harness import SCENES
from benchmarks.stages import coded, enter_baseline_environment
from decoder.side_information.block_motion.compensation import Luma
from decoder.side_information.protocol import ReferenceFrame
from decoder.side_information.scene.extrapolated import LATER_SHARE, Scene
from decoder.side_information.scene.synthesis import render_between
from dvc import cli
from dvc.config import MAX_QP
from dvc.metrics import mean_psnr_db, psnr_db
from dvc.multiview.cameras import PixelFrame
from dvc.multiview.depth_maps import DepthView, checked_depth, discontinuities
from dvc.multiview.warping import warp_matrix
from dvc.video import create_video
from dvc.wynerziv.transform import to_uint8
from sequences.renderer import RenderedFrame
from sequences.sequence import RenderedSequence

PROG = "python -m benchmarks.true_geometry"
EXAMPLES = f"""\
  {PROG}                                  all three scenes
  {PROG} street --frames 33
"""
SURE = 1e3
"""Confidence of a depth that is true."""
FRAME_RATE = 30
"""Of clips that are coded; no figure depends on it."""


class Row(NamedTuple):
    """PSNR of the predictions of a P-type frame, or the mean of several, in dB."""

    used: float
    true_geometry: float
    block_motion: float


class TrueGeometry(RecordingExtrapolation):
    """Predicts as usual, and draws what it predicts from the scene once more as it truly is."""

    def __init__(self, truth: Sequence[RenderedFrame]) -> None:
        super().__init__()
        self.drawn: dict[int, Luma] = {}
        self._truth = truth
        self._decoded: dict[int, Luma] = {}

    def take(self, earlier: Sequence[ReferenceFrame], scene: Scene | None, instant: int) -> None:
        """Draw a frame that is predicted from a scene."""
        self._decoded |= {one.index: one.frame.luma for one in earlier}
        if scene is not None:
            shown = [self._index_of(frame.luma) for frame in scene.frames]
            self.drawn[instant] = to_uint8(draw(self._truth, self._decoded, (shown[0], shown[1]), instant))

    def _index_of(self, luma: Luma) -> int:
        return next(k for k, decoded in self._decoded.items() if np.array_equal(decoded, luma))


def draw(
    truth: Sequence[RenderedFrame], lumas: dict[int, Luma], shown: tuple[int, int], wanted: int
) -> NDArray[np.float64]:
    """Draw a frame from two others by true depth and cameras."""
    frame = PixelFrame(*truth[wanted].depth.shape[::-1])
    cameras = {k: camera_of(truth[k], frame) for k in (*shown, wanted)}
    inverse = {k: 1.0 / truth[k].depth.astype(np.float64) for k in shown}
    views = []
    for own, other in (shown, shown[::-1]):
        there = warp_matrix(cameras[own], cameras[other], frame)
        depth = checked_depth((inverse[own], np.full_like(inverse[own], SURE)), inverse[other], there)
        edges = discontinuities(inverse[own], there)
        views.append(DepthView(lumas[own], cameras[own], depth, edges, there))
    return render_between(views, cameras[wanted], LATER_SHARE, frame).luma


def camera_of(view: RenderedFrame, frame: PixelFrame) -> NDArray[np.float64]:
    """Return the true camera of a view in normalised coordinates."""
    camera: NDArray[np.float64] = frame.normalized_from_pixel @ view.camera.projection
    return camera


def measure(sequence: RenderedSequence, qp: int) -> dict[int, Row]:
    """Code and decode a rendered sequence; return what its P-type frames are predicted like by a scene."""
    truth = list(sequence.rendered())
    with tempfile.TemporaryDirectory() as folder:
        clip = Path(folder) / "clip.mkv"
        size = truth[0].frame.width, truth[0].frame.height
        with create_video(clip, size, Fraction(FRAME_RATE)) as video:
            for view in truth:
                video.write(view.frame)
        stream = coded(str(clip), qp, len(truth), Path(folder))
    recording, rows = TrueGeometry(truth), {}
    for frame in decoded_p_types(stream, recording):
        original, sources = truth[frame.index].frame.luma, recording.sources.pop(frame.index)
        if frame.index in recording.drawn:
            found = block_motion(original, sources.references, sources.starts)
            predictions = frame.side_information, recording.drawn.pop(frame.index), found
            rows[frame.index] = Row(*(psnr_db(original, one) for one in predictions))
    return rows


def table(found: dict[str, dict[int, Row]]) -> str:
    """Return the means of scenes."""
    lines = ["scene        P-type by scene    used    true  blocks"]
    for name, rows in found.items():
        means = map(mean_psnr_db, zip(*rows.values(), strict=True))
        lines.append(f"{name:<12} {len(rows):15d}" + "".join(f"{mean:8.2f}" for mean in means))
    return "\n".join(lines)


def _parser() -> cli.ArgumentParser:
    parser = cli.ArgumentParser(PROG, __doc__, EXAMPLES)
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help=f"default: {' '.join(SCENES)}")
    parser.add_argument("--frames", type=cli.integer(2, 10**6), default=49, help="of each (default: 49)")
    parser.add_argument("--qp", type=cli.integer(1, MAX_QP), default=32, help="quality (default: 32)")
    return parser


def main(words: Sequence[str] | None = None) -> int:
    """Measure scenes, and print a table."""
    parser = _parser()
    arguments = parser.parse_intermixed_args(words)
    found: dict[str, dict[int, Row]] = {}
    scenes = arguments.scenes or SCENES
    if unknown := [name for name in scenes if name not in SCENES]:
        parser.error(f"there are no scenes {', '.join(unknown)}, but {', '.join(SCENES)}")
    with cli.progress_bar("scenes", len(scenes)) as progress:
        for name in scenes:
            found[name] = measure(RenderedSequence(name, num_frames=arguments.frames), arguments.qp)
            progress(1)
    print(f"{arguments.frames} frames, QP {arguments.qp}; PSNR of P-type frames in dB\n")
    print(table(found))
    return 0


if __name__ == "__main__":
    enter_baseline_environment("benchmarks.true_geometry")
    sys.exit(main())
