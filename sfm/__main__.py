"""Command `dvc-sfm`: the map of a video, or the scene of two pictures, as files and pictures."""

import argparse
import json
import sys
from typing import TYPE_CHECKING

from dvc import cli
from dvc.config import MAPPERS, SFM_BACKENDS
from dvc.errors import ConfigError, DvcError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

PROG = "dvc-sfm"
EXAMPLES = """\
  dvc-sfm video.mkv --out map                            cameras, depth and points of a whole video
  dvc-sfm video.mkv --out map --mapper colmap            the same with COLMAP
  dvc-sfm a.png b.png --out model                        two pictures of one scene
  dvc-sfm video.mkv video.mkv --frames 0 10 --out model  frames 0 and 10 of a video
  dvc-sfm video.mkv video.mkv --frames 0 10 --sfm colmap --out other

For a video DIR then holds index.html, a page to fly through the scene, points.ply, trajectory.txt,
intrinsics.json, COLMAP's text files in sparse/, depth maps in depth/, and scene.json; for two pictures
model.json, points.ply, the text files of COLMAP, and correspondences.png.
"""


def _parser() -> argparse.ArgumentParser:
    parser = cli.ArgumentParser(
        PROG, "Structure from motion: of a video of a static scene, or of two pictures of it.", EXAMPLES
    )
    parser.add_argument("first", metavar="A", help="the video; or picture or video of the first view")
    parser.add_argument("second", metavar="B", nargs="?", help="picture or video of the second view")
    parser.add_argument("--out", metavar="DIR", required=True, help="folder to write, new or empty")
    parser.add_argument("--quiet", action="store_true", help="print no summary and no progress")
    video = parser.add_argument_group("of a video")
    video.add_argument("--mapper", choices=MAPPERS, help="the project's mapper or COLMAP's; default: native")
    pair = parser.add_argument_group("of two pictures")
    pair.add_argument(
        "--frames",
        type=cli.integer(0, 10**9),
        nargs=2,
        metavar=("I", "J"),
        help="frame of A and frame of B; default: the first of each",
    )
    pair.add_argument(
        "--sfm",
        choices=SFM_BACKENDS,
        help="estimators: the project's, COLMAP's, or exactly those of the thesis; default: native",
    )
    cli.add_integer(pair, "--seed", (0, 2**31 - 1), "seed of the random samples; default: 0", metavar="S")
    return parser


def _run(arguments: argparse.Namespace) -> int:
    from dvc.files import check_folder

    of_pair = {"--frames": arguments.frames, "--sfm": arguments.sfm, "--seed": arguments.seed}
    given = [option for option, value in of_pair.items() if value is not None]
    if arguments.second is None and given:
        raise ConfigError(f"{given[0]} requires a second input")
    if arguments.second is not None and arguments.mapper is not None:
        raise ConfigError("--mapper requires a single input, a video; for two pictures use --sfm")
    check_folder(arguments.out)
    if arguments.second is None:
        from sfm.output.scene_folder import map_to_folder

        report, mapper = None if arguments.quiet else _report, arguments.mapper or MAPPERS[0]
        summary = map_to_folder(arguments.first, arguments.out, mapper, report).summary
    else:
        summary = _reconstruct(arguments)
    if not arguments.quiet:
        sys.stdout.write(summary + "\n")
    return 0


def _report(message: str) -> None:
    """Log progress on stderr."""
    sys.stderr.write(f"{PROG}: {cli.one_line(message)}\n")


def _reconstruct(arguments: argparse.Namespace) -> str:
    from dvc.files import atomic_folder
    from dvc.picture_files import write_png
    from sfm.output import map_files
    from sfm.pipeline import reconstruct

    numbers = arguments.frames or (0, 0)
    first, second = _luma(arguments.first, numbers[0]), _luma(arguments.second, numbers[1])
    if first.shape != second.shape:
        sizes = [f"{luma.shape[1]}x{luma.shape[0]}" for luma in (first, second)]
        raise ConfigError(f"both pictures must have the same size, got {sizes[0]} and {sizes[1]}")
    backend, seed = arguments.sfm or SFM_BACKENDS[0], arguments.seed or 0
    reconstruction = reconstruct(first, second, backend=backend, seed=seed)
    model = reconstruction.model
    fundamental = None if model is None else model.fundamental
    pictures = [
        map_files.draw_correspondences(
            second, matches, fundamental, f"{name}: {len(matches)} correspondences"
        )
        for name, matches in reconstruction.stages.items()
        if name in ("weak calibration", "propagation")
    ]
    with atomic_folder(arguments.out) as folder:
        document = json.dumps(map_files.to_dict(reconstruction), indent=1)
        (folder / "model.json").write_text(f"{document}\n")
        if model is not None:
            map_files.write_model(folder, model, map_files.point_colours(first, model.correspondences.first))
        if pictures:
            write_png(folder / "correspondences.png", map_files.side_by_side(pictures))
    lines = [
        f"{name:20} {len(matches):6d} correspondences" for name, matches in reconstruction.stages.items()
    ]
    verdict = "a model that can be trusted" if reconstruction.success else reconstruction.reason
    return "\n".join([*lines, f"motion: {reconstruction.motion}; {verdict}"])


def _luma(path: str, index: int) -> "NDArray[np.uint8]":
    from dvc.video import open_video

    with open_video(path, start=index, num_frames=1) as reader:
        for frame in reader:
            return frame.luma
    raise DvcError(f"{path} has no frame {index}")


main = cli.command(PROG, _parser, _run, extra="decode")

if __name__ == "__main__":
    sys.exit(main())
