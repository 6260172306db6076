"""What planes cost over their ideal code length, from real decoding."""

from functools import partial

from benchmarks.figures.allocation.curves import AREA, TRACKED, curve
from benchmarks.figures.harness import STATIC_CLIPS, Figure, Measured, Setting

ASKED = {"all": 1.12, "dc": 1.08, "ac_6_15": 1.3}
"""Most bits over ideal code length that are asked, by class of the decoder's report."""
_NAMES = {"all": "plane-ratios", "dc": "plane-ratios-dc", "ac_6_15": "plane-ratios-lowest"}
_WHAT = {"all": "all planes and checks of frames", "dc": "DC planes", "ac_6_15": "planes of the last bands"}
_NOTE = "ideal code length under the decoder's own priors, which learn"


def plane_ratio(setting: Setting, clip: str, planes: str) -> Measured:
    """Divide all bits received for planes by their ideal code length, over all points of all static clips."""
    del clip
    bits, ideal_bits = {}, {}
    for name in STATIC_CLIPS[: setting.choose(len(STATIC_CLIPS), 1)]:
        costs = [point.data["totals"]["plane_bits"][planes] for point in curve(setting, name, TRACKED).points]
        bits[name] = sum(float(cost["bits"]) for cost in costs)
        ideal_bits[name] = sum(float(cost["ideal_bits"]) for cost in costs)
    ratios = {name: bits[name] / ideal_bits[name] for name in bits}
    ratio = sum(bits.values()) / sum(ideal_bits.values())
    each = ", ".join(f"{name} {value:.3f}" for name, value in ratios.items())
    return Measured(f"{ratio:.3f} ({each})", ratio <= ASKED[planes], {"all_clips": ratio} | ratios, _NOTE)


FIGURES = tuple(
    Figure(
        AREA,
        _NAMES[planes],
        f"TE (--qp), 49 frames, {_WHAT[planes]}: bits received over ideal code length",
        f"≤ {most:.2f}",
        partial(plane_ratio, planes=planes),
    )
    for planes, most in ASKED.items()
)
"""The figures of this module."""
