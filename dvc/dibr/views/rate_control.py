"""Rate control: a stream that is as long as it may be.

The code of pictures can be cut at any byte, that of disparities follows from a Lagrange multiplier. So
pictures get what disparities leave, and disparities the multiplier of pictures of that length, repeatedly.
"""

from dvc.dibr.view_encoder import Encoded, ViewEncoder
from dvc.errors import ConfigError
from dvc.images.picture_codec import LARGEST_MULTIPLIER

PICTURE_SHARE = 0.85
"""Share of the pictures in most streams: where the search begins."""
TOLERANCE = 0.005
"""Share of the budget that may be left."""
GROWTH = 0.7, 3.0
"""Limits of how many bytes streams grow by for a byte of the pictures."""
MAX_STEPS = 8


def encode_to_size(encoder: ViewEncoder, max_bytes: int) -> Encoded:
    """Encode views to a stream of some length."""
    best: Encoded | None = None
    picture_bytes, growth = int(PICTURE_SHARE * max_bytes), 1.0 / PICTURE_SHARE
    tried: list[tuple[int, int]] = []
    for _ in range(MAX_STEPS):
        found = encoder.encode(encoder.multiplier_of_pictures(picture_bytes), picture_bytes)
        size = len(found.data)
        if size <= max_bytes and (best is None or size > len(best.data)):
            best = found
        if (1.0 - TOLERANCE) * max_bytes <= size <= max_bytes:
            break
        if tried and tried[-1][0] != picture_bytes:
            measured = (size - tried[-1][1]) / (picture_bytes - tried[-1][0])
            growth = min(max(measured, GROWTH[0]), GROWTH[1])
        tried.append((picture_bytes, size))
        # half of the tolerance is aimed at, as the code of disparities varies a little
        wanted = (1.0 - 0.5 * TOLERANCE) * max_bytes
        picture_bytes = max(picture_bytes + round((wanted - size) / growth), 0)
    if best is not None:
        return best
    least = encoder.encode(LARGEST_MULTIPLIER)
    if len(least.data) > max_bytes:
        raise ConfigError(f"{max_bytes} bytes are too few: these views need {len(least.data)} at least")
    return least
