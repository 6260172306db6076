"""Rate of several pieces: each in the best of several codes, all cut at one multiplier."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dvc.images.picture_codec import PictureCode, multipliers_around


@dataclass(frozen=True, eq=False)
class Choices:
    """Codes of one piece to choose from."""

    codes: tuple[PictureCode, ...]  # at least one; errors of all pieces in the same unit
    fixed_bytes: tuple[int, ...]  # what each needs beside its own
    weight: float = 1.0  # of their errors, so that nothing is worth its bits at the largest multiplier

    def bytes_at_multiplier(self, multiplier: float) -> int:
        """Return the length of the code of least cost."""
        multiplier /= self.weight
        costs, lengths = [], []
        for code, fixed in zip(self.codes, self.fixed_bytes, strict=True):
            num_pixels = code.shape[0] * code.shape[1]
            cost = float(np.min(code.mse + multiplier * code.bits_per_pixel))
            costs.append(cost + multiplier * 8.0 * fixed / num_pixels)
            lengths.append(fixed + code.bytes_at_multiplier(multiplier))
        return lengths[int(np.argmin(costs))]


def allot(choices: Sequence[Choices], num_bytes: int) -> list[int] | None:
    """Divide bytes among pieces, so that the last bits of each are worth the same."""
    smaller, larger = multipliers_around(choices, num_bytes)
    lengths = [choice.bytes_at_multiplier(larger) for choice in choices]
    left = num_bytes - sum(lengths)
    if left < 0:  # few pixels: even the first bits of a code may be worth it
        lengths = [min(choice.fixed_bytes) for choice in choices]
        return lengths if sum(lengths) <= num_bytes else None
    for number, choice in enumerate(choices):
        more = min(max(choice.bytes_at_multiplier(smaller) - lengths[number], 0), left)
        lengths[number] += more
        left -= more
    return lengths
