"""Wrong planes that pass all checks, by the codes and the request policy of the codec."""

from dataclasses import replace

from benchmarks.figures.allocation.curves import AREA
from benchmarks.figures.harness import Figure, Measured, Setting

NUM_BITS = 396
PLANES_PER_FRAME = 12
NUM_FRAMES = 4000
"""48,000 planes: with one error among them the share is below 1e-4 at 95 %."""
SEED = 20082
MOST_UNDETECTED = 1e-4


def undetected_planes(setting: Setting, _clip: str) -> Measured:
    """Count planes that are wrong after the check of their frame has passed."""
    import numpy as np
    from scipy.stats import beta

    from benchmarks.figures.turbo import noisy_plane
    from benchmarks.recorded_planes import SEED as ORDERS_SEED
    from benchmarks.recorded_planes import FrameSource
    from decoder.wyner_ziv import REQUESTS
    from dvc import slepian_wolf
    from dvc.config.allocation import ALLOCATED_FAMILY

    rng = np.random.default_rng(SEED)
    decoder = slepian_wolf.plane_decoder(replace(REQUESTS, family=ALLOCATED_FAMILY), NUM_BITS, ORDERS_SEED)
    undetected = failed = corrected = 0
    num_frames = setting.choose(NUM_FRAMES, 20)
    for _ in range(num_frames):
        planes, llrs = {}, {}
        for plane in range(PLANES_PER_FRAME):
            unsure = rng.random(NUM_BITS) < rng.choice([0.0, 0.01, 0.05, 0.3])
            probabilities = np.where(unsure, 0.2, rng.choice([0.0005, 0.002, 0.01]))
            planes[plane], llrs[plane] = noisy_plane(NUM_BITS, probabilities, rng)
        source = FrameSource(planes, ALLOCATED_FAMILY)
        results = {
            plane: slepian_wolf.drive(decoder.decode(llr_ch, (0, plane)), source.answer)
            for plane, llr_ch in llrs.items()
        }
        check = slepian_wolf.drive(decoder.check(0), source.answer)
        results |= check.corrected
        wrong = sum(not np.array_equal(results[plane].bits, bits) for plane, bits in planes.items())
        corrected += len(check.corrected)
        failed += not check.success
        undetected += wrong if check.success else 0
    num_planes = num_frames * PLANES_PER_FRAME
    upper = float(beta.ppf(0.95, undetected + 1, num_planes - undetected))
    values = {"num_undetected": undetected, "num_planes": num_planes, "upper_95": upper}
    values |= {"num_corrected": corrected, "num_failed_frames": failed}
    text = f"{undetected} of {num_planes} planes; below {upper:.1e} with 95 % confidence"
    note = f"{corrected} planes were decoded again after the check of their frame, {failed} frames failed"
    return Measured(text, upper < MOST_UNDETECTED, values, note)


FIGURES = (
    Figure(
        AREA,
        "undetected-planes",
        "planes of a frame by parities of ranges: wrong, though the check of the frame passes",
        "< 1e-4 with 95 % confidence",
        undetected_planes,
    ),
)
"""The figures of this module."""
