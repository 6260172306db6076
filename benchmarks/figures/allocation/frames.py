"""How even the quality of frames is."""

from benchmarks.figures.allocation.curves import AREA, CLIPS, TRACKED, curve
from benchmarks.figures.harness import Figure, Measured, Setting

MOST_DB = 4.0


def worst_frame(setting: Setting, clip: str) -> Measured:
    """Tell how far the worst frame of a point is below the mean of all of its frames."""
    below_db = {}
    for point in curve(setting, clip, TRACKED).points:
        worst_db = min(float(row["psnr_y_db"]) for row in point.frame_rows)
        below_db[point.level] = point.psnr_y_db - worst_db
    worst = max(below_db, key=lambda level: below_db[level])
    text = f"{below_db[worst]:.2f} dB below the mean, at {worst}"
    return Measured(text, below_db[worst] <= MOST_DB, below_db)


FIGURES = (
    Figure(
        AREA,
        "te-qp-worst-frame",
        "TE (--qp), 49 frames: PSNR of the worst frame under the mean",
        "≤ 4 dB",
        worst_frame,
        CLIPS,
    ),
)
"""The figures of this module."""
