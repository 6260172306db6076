"""Command `dvc-sfm`: reconstruct a scene from two pictures, and look at what was found."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dvc import cli
from dvc.config import SFM_BACKENDS
from dvc.errors import ConfigError, DvcError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from sfm.model import Reconstruction

PROG = "dvc-sfm"
EXAMPLES = """\
  dvc-sfm a.png b.png --out model                        two pictures of one scene
  dvc-sfm video.mkv video.mkv --frames 0 10 --out model  frames 0 and 10 of a video
  dvc-sfm video.mkv video.mkv --frames 0 10 --sfm colmap --out other

DIR then holds model.json, points.ply, the text files of COLMAP, and correspondences.png.
"""


def _parser() -> argparse.ArgumentParser:
    parser = cli.ArgumentParser(
        PROG, "Structure from motion between two pictures of a static scene.", EXAMPLES
    )
    parser.add_argument("first", metavar="A", help="picture or video of the first view")
    parser.add_argument("second", metavar="B", help="picture or video of the second view")
    parser.add_argument("--out", metavar="DIR", required=True, help="folder to write, new or empty")
    parser.add_argument(
        "--frames",
        type=cli.integer(0, 10**9),
        nargs=2,
        default=(0, 0),
        metavar=("I", "J"),
        help="frame of A and frame of B; default: the first of each",
    )
    parser.add_argument(
        "--sfm",
        choices=SFM_BACKENDS,
        default="native",
        help="whose estimators: the project's own or COLMAP's; default: %(default)s",
    )
    seed = "seed of the random samples"
    cli.add_integer(parser, "--seed", (0, 2**31 - 1), seed, default=0, metavar="S")
    parser.add_argument("--quiet", action="store_true", help="print no summary")
    return parser


def _reconstruct(arguments: argparse.Namespace) -> int:
    from dvc.files import atomic_folder
    from sfm.pipeline import reconstruct

    first = _luma(arguments.first, arguments.frames[0])
    second = _luma(arguments.second, arguments.frames[1])
    if first.shape != second.shape:
        sizes = [f"{luma.shape[1]}x{luma.shape[0]}" for luma in (first, second)]
        raise ConfigError(f"both pictures must have the same size, got {sizes[0]} and {sizes[1]}")
    reconstruction = reconstruct(first, second, backend=arguments.sfm, seed=arguments.seed)
    with atomic_folder(arguments.out) as folder:
        _write(folder, reconstruction, first, second)
    if not arguments.quiet:
        sys.stdout.write(_summary(reconstruction))
    return 0


def _luma(path: str, index: int) -> "NDArray[np.uint8]":
    from dvc.video import open_video

    with open_video(path, start=index, num_frames=1) as reader:
        for frame in reader:
            return frame.luma
    raise DvcError(f"{path} has no frame {index}")


def _write(folder: Path, reconstruction: "Reconstruction", first: Any, second: Any) -> None:
    import cv2

    from sfm.output.drawing import draw_correspondences, side_by_side
    from sfm.output.export import point_colours, write_colmap, write_json, write_ply

    write_json(folder / "model.json", reconstruction)
    model = reconstruction.model
    if model is not None:
        colours = point_colours(first, model.correspondences.first)
        write_ply(folder / "points.ply", model, colours)
        write_colmap(folder, model, ("first.png", "second.png"), colours)
    fundamental = None if model is None else model.fundamental
    pictures = [
        draw_correspondences(second, matches, fundamental, f"{name}: {len(matches)} correspondences")
        for name, matches in reconstruction.stages.items()
        if name in ("weak calibration", "propagation")
    ]
    if pictures:
        cv2.imwrite(str(folder / "correspondences.png"), side_by_side(pictures))


def _summary(reconstruction: "Reconstruction") -> str:
    lines = [
        f"{name:20} {len(matches):6d} correspondences" for name, matches in reconstruction.stages.items()
    ]
    verdict = "a model that can be trusted" if reconstruction.success else reconstruction.reason
    lines.append(f"motion: {reconstruction.motion}; {verdict}")
    return "\n".join(lines) + "\n"


main = cli.command(PROG, _parser, _reconstruct)

if __name__ == "__main__":
    sys.exit(main())
