"""Hostile input: see `benchmarks.hostile`."""

from collections import Counter
from collections.abc import Sequence

from benchmarks.figures.harness import Figure, Measured, Setting
from benchmarks.hostile import batches

NUM_MUTATIONS = 10_000
NUM_GEOMETRY_MUTATIONS = 1_000


def mutations(setting: Setting, kinds: Sequence[str], total: int = NUM_MUTATIONS) -> Measured:
    """Mutate what decoder or encoder receive."""
    count = setting.choose(total, 100) // len(kinds)
    counts: Counter[str] = Counter()
    failures: dict[str, str] = {}
    for kind in kinds:
        found, harmful = batches.summary(batches.run_kind(kind, 0, count))
        counts += found
        failures |= {f"{kind} {number}": text for number, text in harmful.items()}
    values = {"num_mutations": count * len(kinds), "failures": dict(list(failures.items())[:20])}
    harmless = f"{counts['refused']} refused, {counts['decoded']} decoded"
    text = f"{len(failures)} of {count * len(kinds)} did harm; {harmless}"
    return Measured(text, not failures, values)


def _streams(setting: Setting, _clip: str) -> Measured:
    return mutations(setting, batches.STREAMS)


def _messages(setting: Setting, _clip: str) -> Measured:
    return mutations(setting, batches.MESSAGES)


def _geometry(setting: Setting, _clip: str) -> Measured:
    return mutations(setting, batches.GEOMETRY, NUM_GEOMETRY_MUTATIONS)


def _pictures(setting: Setting, _clip: str) -> Measured:
    return mutations(setting, batches.PICTURES)


def _depth_images(setting: Setting, _clip: str) -> Measured:
    return mutations(setting, batches.DEPTH_IMAGES)


AREA = "robustness"
_ASKED = "no crash, hang, allocation over 1 GiB or traceback"
FIGURES = (
    Figure(
        AREA,
        "streams",
        "10,000 mutations of streams",
        f"{_ASKED}; every GOP before the damage decodes",
        _streams,
    ),
    Figure(
        AREA,
        "geometry",
        "1,000 mutations of streams with tracks or points, most of them there",
        _ASKED,
        _geometry,
    ),
    Figure(
        AREA,
        "pictures",
        "10,000 mutations of streams of pictures with depth",
        f"{_ASKED}; every layer before the damage is decoded",
        _pictures,
    ),
    Figure(
        AREA,
        "depth-images",
        "10,000 mutations of streams of depth maps and of pictures with shared edges",
        f"{_ASKED}; what is cut after the edges is decoded",
        _depth_images,
    ),
    Figure(AREA, "messages", "10,000 mutations of live messages", _ASKED, _messages),
)
"""Figures of this area."""
