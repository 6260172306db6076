"""What groups of pictures without key frame cost over those with one, and how many lost points tell it.

``python -m benchmarks.searches.lost_points CLIP... --qp 26 32 38 --frames 33`` codes clips whose groups all
end with a key frame, and clips with as few as may be, and decodes them. What a group costs more than with its
key frame are bits, and squared error at the Lagrange multiplier of the stream, in bits of the key frame. The
command prints, for several weights of points that leave the picture, the `MAX_LOST_SHARE` of
`encoder.intra_decision` that saves most, clips weighing the same; and what each clip saves by the values in
use, by the best share for all others, and at best.
"""

import argparse
import io
import math
from collections.abc import Iterator, Sequence
from itertools import islice
from typing import NamedTuple
from unittest import mock

import numpy as np

from benchmarks.results.harness import CLIPS, clip_source
from decoder.session import decode_stream
from dvc.config import P_TYPE_DISTANCE, key_lambda
from dvc.config.sections import LAMBDA_PER_KEY_LAMBDA
from dvc.stream import StreamReader, StreamWriter
from dvc.video import Frame, open_video
from encoder import intra_decision, options
from encoder.groups import Group
from encoder.intra_decision import LEAVING_WEIGHT, MAX_LOST_SHARE, lost_shares

WEIGHTS = (0.0, 0.1, LEAVING_WEIGHT, 0.3, 0.5, 1.0)
"""Of points that leave the picture."""


class Ending(NamedTuple):
    """A group that P-type frames end."""

    clip: str
    lost_share: float  # of the points, on the way to its P-type frames
    cost: float  # over that with a key frame


class CodedGroup(NamedTuple):
    """A group, decoded."""

    group: Group
    key_bits: int
    bits: float  # all of it, and what its squared error is worth


def coded_groups(clip: str, qp: int, num_frames: int, max_lost_share: float) -> list[CodedGroup]:
    """Code a clip with key frames where more points than a share are lost."""
    source = clip_source(clip).path
    parsed = options.parser().parse_args([str(source), "-", "--qp", str(qp), "--luma-only"])
    stream = io.BytesIO()
    with (
        mock.patch.object(intra_decision, "MAX_LOST_SHARE", max_lost_share),
        open_video(source) as video,
    ):
        session = options.session(parsed, video.info)
        with StreamWriter(stream, session.config, "buffered") as writer:
            groups = list(session.groups(islice(video, num_frames)))
            for group in groups:
                writer.write_gop(session.encode(group).record)
    reader = StreamReader(io.BytesIO(stream.getvalue()))
    per_error = 1.0 / (LAMBDA_PER_KEY_LAMBDA * key_lambda(reader.config.wyner_ziv.qp))
    return [
        CodedGroup(
            group,
            8 * len(decoded.record.key),
            8 * sum(map(len, (decoded.record.key, *decoded.record.wyner_ziv)))
            + per_error * squared_error((*group.wyner_ziv, group.key), decoded.frames),
        )
        for group, decoded in zip(groups, decode_stream(reader.config, reader), strict=True)
    ]


def squared_error(originals: Sequence[Frame], frames: Sequence[Frame]) -> float:
    """Add up squared differences of luma."""
    pairs = zip(originals, frames, strict=True)
    return sum(float(np.square(np.subtract(a.luma, b.luma, dtype=np.float64)).sum()) for a, b in pairs)


def endings(clip: str, qp: int, num_frames: int) -> Iterator[tuple[Ending, ...]]:
    """Compare groups that P-type frames end with those that key frames do; one for each of the weights."""
    with_keys, without = (coded_groups(clip, qp, num_frames, share) for share in (-1.0, math.inf))
    for keyed, ended in zip(with_keys, without, strict=True):
        path, key = ended.group.path, ended.group.key
        if path is not None and not ended.key_bits:
            size, cost = (key.width, key.height), (ended.bits - keyed.bits) / keyed.key_bits
            shares = map(sum, lost_shares(path, size, P_TYPE_DISTANCE, *WEIGHTS))
            yield tuple(Ending(clip, share, cost) for share in shares)


def saved(found: Sequence[Ending], max_lost_share: float) -> float:
    """Return what a clip saves in key frames a group, the mean over clips."""
    clips = {one.clip for one in found}
    costs = [[one.cost * (one.lost_share <= max_lost_share) for one in found if one.clip == c] for c in clips]
    return -float(np.mean([np.mean(of_clip) for of_clip in costs]))


def best_share(found: Sequence[Ending]) -> float:
    """Return the share by which most is saved: between that of two groups."""
    shares = sorted({0.0, *(one.lost_share for one in found)})
    between = [(low + high) / 2 for low, high in zip(shares, [*shares[1:], shares[-1]], strict=True)]
    return max(between, key=lambda share: saved(found, share))


def main() -> None:
    """Print the share that suits clips."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("clips", nargs="*", default=CLIPS, help=f"default: {' '.join(CLIPS)}")
    parser.add_argument("--qp", nargs="+", type=int, default=[32])
    parser.add_argument("--frames", type=int, default=33)
    arguments = parser.parse_args()
    groups: list[tuple[Ending, ...]] = []
    for clip in arguments.clips:
        for qp in arguments.qp:
            groups += endings(clip, qp, arguments.frames)
    by_weight = dict(zip(WEIGHTS, zip(*groups, strict=True), strict=True))
    for weight, weighted in by_weight.items():
        best = best_share(weighted)
        print(f"points that leave count {weight}: {best:.2f} saves most, {saved(weighted, best):.3f}")
    found = by_weight[LEAVING_WEIGHT]
    print(f"{LEAVING_WEIGHT} and {MAX_LOST_SHARE} in use; key frames saved a group:")
    for clip in arguments.clips:
        own = [one for one in found if one.clip == clip]
        others = [one for one in found if one.clip != clip] or own
        best = -float(np.mean([min(one.cost, 0.0) for one in own]))
        in_use, by_others = saved(own, MAX_LOST_SHARE), saved(own, best_share(others))
        print(f"  {clip}: {in_use:.2f} in use, {by_others:.2f} by others, {best:.2f} at best")


if __name__ == "__main__":
    main()
