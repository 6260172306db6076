"""Constants and terms of rates and cameras; tests must notice their change."""

import re
from pathlib import Path
from typing import NamedTuple

from benchmarks.mutants.operators import Change


class Named(NamedTuple):
    """A change by its source line."""

    package: str
    line: str  # the beginning of one line of the package, without indent
    before: str  # in that line
    after: str


NAMED = (
    Named("encoder", "return error * frames[0].size >", "ALONE_COST", "2.0 * ALONE_COST"),
    Named("encoder", "return error * frames[0].size >", "SHORT_COST", "0.5 * SHORT_COST"),
    Named("encoder", "NUM_NEAREST, NEAR_PX2 =", "16.0", "64.0"),
    Named("dvc/config", "LAMBDA_PER_KEY_LAMBDA =", "6.0", "9.0"),
    Named("dvc/wynerziv", "LAMBDA_PER_SQUARED_STEP =", "0.1", "0.2"),
    Named("dvc/slepian_wolf", "SWEEPS, LAST_SWEEPS =", "4", "2"),
    Named("dvc/slepian_wolf", "CHANGE =", "0.02", "0.1"),
    Named(
        "dvc/wynerziv", "return MIN_SCALE + 0.3 * band + 0.5 * neighbourhood", " + 0.5 * neighbourhood", ""
    ),
    Named(
        "dvc/wynerziv",
        "shape = scale * np.sqrt(np.sqrt(texture",
        "np.sqrt(np.sqrt(texture",
        "np.sqrt((texture",
    ),
    Named("sfm", "TUKEY_TUNING =", "5.5", "11.0"),
    Named("sfm", "JERK_PX =", "1.0", "4.0"),
    Named("sfm", "MIN_SHARE_AHEAD =", "0.8", "0.5"),
)


def named_change(named: Named, root: Path) -> Change:
    """Find the position of a named change."""
    found = []
    for path in sorted((root / named.package).rglob("*.py")):
        for number, line in enumerate(path.read_bytes().splitlines(), 1):
            if re.match(rb"\s*" + re.escape(named.line.encode()), line):
                found.append((path.relative_to(root).as_posix(), number, line.find(named.before.encode())))
    if len(found) != 1 or found[0][2] < 0:
        raise LookupError(f"{named.line!r} begins {len(found)} lines of {named.package}: see {__name__}")
    return Change("named", *found[0], named.before, named.after)
