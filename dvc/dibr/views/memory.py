"""Memory that encoding takes, estimated before it is taken."""

from dvc.errors import ConfigError

MAX_GIB = 4.0
"""More is refused."""
_BYTES_PER_ERROR = 10.0
"""Of the error tensor, its copy with credits and what dynamic programming keeps: 8 to 9 were measured."""
_BYTES_PER_PIXEL = 650.0
"""Of the reference, its trees and its views; measured in colour, gray needs half."""


def check_memory(shape: tuple[int, int], num_labels: int) -> None:
    """Refuse views that are too large for so many labels."""
    num_pixels = shape[0] * shape[1]
    gib = num_pixels * (_BYTES_PER_PIXEL + _BYTES_PER_ERROR * num_labels) / 2**30
    if gib > MAX_GIB:
        raise ConfigError(
            f"{num_labels} disparities of {shape[1]}x{shape[0]} pixels take about {gib:.1f} GiB, more than "
            f"{MAX_GIB:g}: fewer disparities, or smaller views"
        )
