"""What P-type frames cost over key frames, and the weights of motion, parallax and loss that tell it.

``python -m benchmarks.searches.p_type_shares CLIP... --qp 30 34 --frames 33`` encodes clips with as few key
frames as the format allows, decodes them, and prints `_MIN_SHARE` and the weights of
`encoder.intra_decision`: those of least squares, each clip with the same weight, and how far from the costs
they and those in use are.
"""

import argparse
import math
import tempfile
from collections.abc import Iterator, Sequence
from itertools import islice, pairwise
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from decoder.session import decode_stream
from dvc.stream import StreamReader, StreamWriter
from dvc.video import open_video
from dvc.wynerziv.hierarchy import p_type_instants
from encoder import intra_decision, options
from encoder.intra_decision import FieldOfMotion, field_of_motion, p_type_share

Floats = NDArray[np.float64]


class Cost(NamedTuple):
    """A P-type frame."""

    clip: str
    side_px: int  # the longer side of the picture
    field: FieldOfMotion
    share: float  # its bits, of those of the mean key frame

    @property
    def terms(self) -> list[float]:
        """What the weights are of: 1, motion, parallax and loss."""
        return [1.0, self.field.motion_px / self.side_px, self.field.parallax_px, self.field.lost_share]


def costs(path: Path, qp: int, num_frames: int) -> Iterator[Cost]:
    """Encode and decode a clip."""
    parsed = options.parser().parse_args([str(path), "-", "--qp", str(qp), "--luma-only"])
    fields: dict[int, FieldOfMotion] = {}
    with tempfile.TemporaryDirectory() as folder:
        stream, first = Path(folder) / "stream.dvc", 0
        with (
            mock.patch.object(intra_decision, "MAX_SHARE", math.inf),
            open_video(str(path)) as video,
            stream.open("wb") as file,
        ):
            session = options.session(parsed, video.info)
            with StreamWriter(file, session.config, "buffered") as writer:
                for group in session.groups(islice(video, num_frames)):
                    record = session.encode(group).record
                    writer.write_gop(record)
                    if record.without_key and group.tracks is not None:
                        positions, last = group.tracks.positions, group.tracks.num_instants - 1
                        instants = [0, *p_type_instants(0, last, session.config.gop.p_type_distance)]
                        for before, after in pairwise(instants):
                            field = field_of_motion(positions[:, before], positions[:, after])
                            fields[first + after - 1] = field
                    first += record.num_frames
        with StreamReader(stream) as reader:
            decoded = list(decode_stream(reader.config, reader))
    key_bits = np.mean([8 * len(group.record.key) for group in decoded if group.key is not None])
    side_px = max(session.config.video.width, session.config.video.height)
    for frame in (frame for group in decoded for frame in group.wyner_ziv):
        if frame.index in fields:
            share = 8 * len(frame.punctured) / float(key_bits)
            yield Cost(path.stem, side_px, fields[frame.index], share)


def fit(found: Sequence[Cost]) -> Floats:
    """Return the weights of the terms, none below zero, that tell the costs best."""
    counts = {clip: sum(cost.clip == clip for cost in found) for clip in {cost.clip for cost in found}}
    roots = np.sqrt([1.0 / counts[cost.clip] for cost in found])
    rows = roots[:, None] * np.array([cost.terms for cost in found])
    weights: Floats = nnls(rows, roots * [cost.share for cost in found])[0]
    return weights


def main() -> None:
    """Print weights that fit clips."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("clips", nargs="+", type=Path, help="videos")
    parser.add_argument("--qp", nargs="+", type=int, default=[30, 34])
    parser.add_argument("--frames", type=int, default=33)
    arguments = parser.parse_args()
    found: list[Cost] = []
    for clip in arguments.clips:
        for qp in arguments.qp:
            found += costs(clip, qp, arguments.frames)
    weights = fit(found)
    print("share, motion, parallax, loss:", *(f"{weight:.3f}" for weight in weights))
    for clip in sorted({cost.clip for cost in found}):
        own = [cost for cost in found if cost.clip == clip]
        fitted = np.array([weights @ cost.terms - cost.share for cost in own])
        used = np.array([p_type_share(cost.field, cost.side_px) - cost.share for cost in own])
        print(
            f"  {clip}: {len(own)} frames of {np.mean([cost.share for cost in own]):.2f} key frames,"
            f" fitted {fitted.mean():+.2f} ± {fitted.std():.2f}, in use {used.mean():+.2f} ± {used.std():.2f}"
        )


if __name__ == "__main__":
    main()
