"""Draw the pictures of tracked coding: figures 5.11 to 5.14, tracks, snakes; and fill in table 5.1."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.figures.harness import RESULTS, SCENES, STATIC_CLIPS, Setting, clip_source
from benchmarks.figures.tracks.limits import KEY_QPS, LOSSY_FRAMES
from benchmarks.figures.tracks.prediction import (
    ReceivedGroup,
    frame_results,
    mean_db,
    predictions,
    received_groups,
)
from benchmarks.figures.tracks.quality import fixed_gop
from benchmarks.figures.tracks.runs import (
    BLIND_DEPTH,
    BLOCK_MOTION,
    TD_BLOCKS,
    TD_DEPTH,
    TE_BLOCKS,
    TE_DEPTH,
    WAYS,
    Run,
    Way,
)
from benchmarks.pictures.drawing import (
    Line,
    Picture,
    correlation_noise,
    draw_clips,
    draw_snakes,
    draw_tracks,
    in_pairs,
    panel,
    plot_by_frame,
    write_picture,
)
from decoder.side_information.protocol import Prediction
from decoder.tracking import match_points
from dvc import cli
from dvc.files import atomic_output
from dvc.metrics import psnr_db
from dvc.tracks import FeaturePoints, PointTracks
from dvc.video import open_video
from dvc.wynerziv.transform import to_uint8
from sfm.pipeline import reconstruct

PROG = "python -m benchmarks.pictures.tracks"
EXAMPLES = """\
  python -m benchmarks.pictures.tracks               scenes to docs/tracks, real clips to results/tracks
  python -m benchmarks.pictures.tracks --clip tree   one sequence
"""
FOLDER = Path("docs") / "tracks"
FOLDER_OF_REAL_CLIPS = Path("results") / "tracks"
PAGE = Path("docs") / "side_information_tracks.md"
BEGIN, END = "<!-- table: begin -->", "<!-- table: end -->"
CLIPS = (*SCENES, *STATIC_CLIPS)
SUBJECTIVE_QP = 26
NOISE_WAYS = (BLOCK_MOTION, BLIND_DEPTH, TE_DEPTH, TD_DEPTH)
PLOTTED = (
    (BLOCK_MOTION, 5, "-"),
    (BLIND_DEPTH, 4, "-"),
    (TD_BLOCKS, 2, ":"),
    (TD_DEPTH, 2, "-"),
    (TE_BLOCKS, 0, ":"),
    (TE_DEPTH, 0, "-"),
)
"""Ways of figure 5.11, each with its colour and style."""


def key_frames_by_index(run: Run) -> dict[int, float]:
    """Return the PSNR of the key frames around predicted frames."""
    keys = {key.index: key.frame.luma for group in received_groups(run) for key in group.keys}
    with open_video(clip_source(run.clip).path, num_frames=run.num_frames) as reader:
        return {
            index: psnr_db(frame.luma, keys[index]) for index, frame in enumerate(reader) if index in keys
        }


def _run(clip: str, way: Way, frames: int) -> Run:
    return Run(clip, way, frames, fixed_gop(clip), every=2)


def _psnrs_db(run: Run, folder: Path) -> dict[int, float]:
    return {frame.index: frame.psnr_db for frame in frame_results(run, folder)}


def _quality_by_frame(clip: str, frames: int, results: Path) -> list[Line]:
    """Figure 5.11: by frame, every way at a fixed distance of lossless keys, and TE by its own rule."""
    lines = [
        Line(way.name, _psnrs_db(_run(clip, way, frames), results), colour, style, gop=fixed_gop(clip))
        for way, colour, style in PLOTTED
    ]
    chosen = _psnrs_db(Run(clip, TE_DEPTH, frames), results)
    return [*lines, Line(f"{TE_DEPTH.name}, keys by tracks", chosen, 1, "-")]


def _quality_from_lossy_keys(clip: str, frames: int, results: Path) -> list[Line]:
    """Figure 5.13: key frames, as peaks, and side information by frame, for several quantisers."""
    lines = []
    for number, qp in enumerate(KEY_QPS):
        run = Run(clip, TE_DEPTH, min(frames, LOSSY_FRAMES), fixed_gop(clip), qp, every=2)
        points = _psnrs_db(run, results)
        lines.append(Line(f"keys at QP {qp}", points, number, peaks=key_frames_by_index(run)))
    return lines


def _middle(run: Run) -> tuple[ReceivedGroup, int, Prediction]:
    """Predict the frame in the middle of the first group."""
    group, predicted = next(iter(predictions(run)))
    index, prediction = predicted[len(predicted) // 2]
    return group, index, prediction


def _noise_pictures(clip: str) -> Picture:
    """Draw figure 5.12: correlation noise of one frame by four codecs."""
    panels = []
    for way in NOISE_WAYS:
        group, index, prediction = _middle(_run(clip, way, fixed_gop(clip) + 1))
        original = group.originals[index - 1].luma
        quality_db = psnr_db(original, to_uint8(prediction.luma))
        title = f"{way.name}, frame {index}: {quality_db:.1f} dB"
        panels.append(panel(correlation_noise(prediction.luma, original), title))
    return in_pairs(panels)


def _subjective_pictures(clip: str) -> Picture:
    """Draw figure 5.14: a decoded key frame and a frame that is interpolated."""
    run = Run(clip, TE_DEPTH, fixed_gop(clip) + 1, fixed_gop(clip), SUBJECTIVE_QP, every=2)
    group, index, prediction = _middle(run)
    interpolated = to_uint8(prediction.luma)
    quality_db = psnr_db(group.originals[index - 1].luma, interpolated)
    key_db = key_frames_by_index(run)[0]
    first = f"key frame 0 at QP {SUBJECTIVE_QP}: {key_db:.1f} dB"
    second = f"interpolated frame {index}: {quality_db:.1f} dB"
    return in_pairs([panel(group.keys[0].frame.luma, first), panel(interpolated, second)])


def _track_pictures(clip: str) -> dict[str, Picture]:
    """Draw the tracks of TE and the snakes of TD in the first group of each, where anything was tracked."""
    pictures = {}
    tracked = next(iter(received_groups(Run(clip, TE_DEPTH, fixed_gop(clip) + 1))), None)
    if tracked is not None and isinstance(tracked.points, PointTracks):
        pictures["tracks"] = draw_tracks(tracked.keys[0].frame.luma, tracked.points)
    run = Run(clip, TD_DEPTH, fixed_gop(clip) + 1, fixed_gop(clip))
    found = next(iter(received_groups(run)), None)
    if found is not None and isinstance(found.points, FeaturePoints):
        first, second = (key.frame.luma for key in found.keys)
        tracks = match_points(reconstruct(first, second), first, second, found.points)
        pictures["snakes"] = draw_snakes(first, tracks)
    return pictures


def _table_row(clip: str, frames: int, results: Path) -> str:
    """Measure a row of table 5.1, in Markdown: the name, and the mean PSNR by every way."""
    values = [f"{mean_db(_run(clip, way, frames), results):.1f}" for way in WAYS]
    name = clip if fixed_gop(clip) == fixed_gop("") else f"{clip} (GOP {fixed_gop(clip)})"
    return "| " + " | ".join([name, *values]) + " |"


def with_rows(page: str, rows: Sequence[str]) -> str:
    """Put rows into the table of a page, in the place of older ones of the same sequences."""
    before, rest = page.split(BEGIN)
    table, after = rest.split(END)
    known = {_sequence(row): row for row in table.strip().splitlines()[2:]}
    known |= {_sequence(row): row for row in rows}
    ordered = [known[clip] for clip in CLIPS if clip in known]
    heads = "| sequence | " + " | ".join(way.name for way in WAYS) + " |"
    lines = [heads, "| --- |" + " --- |" * len(WAYS), *ordered]
    return "\n".join([before + BEGIN, *lines, END + after])


def _sequence(row: str) -> str:
    return row.split("|")[1].split(maxsplit=1)[0]


def draw(clip: str, folder: Path, frames: int) -> list[Path]:
    """Draw all pictures of a sequence."""
    pictures = {
        **_track_pictures(clip),
        "noise": _noise_pictures(clip),
        "subjective": _subjective_pictures(clip),
    }
    paths = [folder / f"{clip}_{name}.jpg" for name in pictures]
    for path, picture in zip(paths, pictures.values(), strict=True):
        write_picture(path, picture)
    plots = {
        "psnr": (f"{clip}: side information, lossless key frames", _quality_by_frame),
        "lossy_keys": (
            f"{clip}: {TE_DEPTH.name}, key frames (diamonds) and side information",
            _quality_from_lossy_keys,
        ),
    }
    for name, (title, measure) in plots.items():
        paths.append(folder / f"{clip}_{name}.png")
        plot_by_frame(paths[-1], title, measure(clip, frames, RESULTS))
    return paths


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command."""
    parser: argparse.ArgumentParser = cli.ArgumentParser(
        PROG, "Draw figures 5.11 to 5.14, tracks and snakes, and fill in table 5.1.", EXAMPLES
    )
    parser.add_argument("--clip", choices=CLIPS, help="only of this sequence")
    parser.add_argument(
        "--frames", type=cli.integer(3, 10**6), default=Setting.frames, metavar="N", help="of plots and table"
    )
    parser.add_argument(
        "--out", type=Path, help=f"folder; default: {FOLDER}, and for real clips {FOLDER_OF_REAL_CLIPS}"
    )
    parser.add_argument("--no-table", action="store_true", help=f"leave {PAGE} as it is")
    return cli.run(PROG, lambda: _draw_all(parser.parse_args(argv)))


def _draw_all(arguments: argparse.Namespace) -> int:
    def draw_and_fill_in(clip: str) -> list[Path]:
        folder = arguments.out or (FOLDER if clip in SCENES else FOLDER_OF_REAL_CLIPS)
        paths = draw(clip, folder, arguments.frames)
        if not arguments.no_table:
            page = with_rows(PAGE.read_text(encoding="utf-8"), [_table_row(clip, arguments.frames, RESULTS)])
            with atomic_output(PAGE) as temporary:
                temporary.write_text(page, encoding="utf-8")
        return paths

    draw_clips([arguments.clip] if arguments.clip else CLIPS, draw_and_fill_in)
    return 0


if __name__ == "__main__":
    sys.exit(main())
