"""What decoding a stream takes, known from its headers, and refused beyond limits before it is spent."""

from typing import NamedTuple

from dvc.errors import BitstreamError

MAX_LAYERS = 32
"""Quality layers of a stream."""
MAX_MIB = 2048
"""Memory that decoding and rendering may take."""
FREE_PIXELS = 1024 * 768
"""That a stream of any length may have, counted at each quality layer."""
PIXELS_PER_BYTE = 1024
"""That it may have beyond these: no picture worth decoding is coded in fewer bits."""
_BYTES_PER_HELD, _BYTES_PER_SHOWN = 50, 140  # measured in colour: 84 in four references, 190 in one, rendered


class Extent(NamedTuple):
    """How many pixels decoding goes through."""

    shown: int  # of a rendered view
    held: int  # of all pictures and disparity maps, which are in memory at once
    decoded: int  # of all pictures, at all quality layers


def check_extent(extent: Extent, num_bytes: int, max_mib: float | None) -> None:
    """Refuse a stream that takes more memory than is allowed, or time that its bytes are not worth."""
    memory = extent.shown * _BYTES_PER_SHOWN + extent.held * _BYTES_PER_HELD
    if memory > (MAX_MIB if max_mib is None else max_mib) * 2**20:
        raise BitstreamError(
            f"decoding takes about {memory / 2**20:.0f} MiB, more than {max_mib or MAX_MIB:g}: "
            "--max-memory raises the limit"
        )
    if max_mib is None and extent.decoded > FREE_PIXELS + PIXELS_PER_BYTE * num_bytes:
        raise BitstreamError(
            f"{num_bytes} bytes are too few for {extent.decoded} pixels: --max-memory {MAX_MIB} decodes them"
        )
