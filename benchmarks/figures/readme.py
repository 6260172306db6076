"""The numbers that the README claims: each is that of the row that stands beside it."""

import re
from collections.abc import Sequence

from benchmarks.figures.harness import Row
from benchmarks.figures.page import short
from dvc.errors import DvcError

HEADING = "## Results\n"
_MINUS = "\N{MINUS SIGN}"
_LINE = re.compile(r"^\| (?P<what>[^|]+) \| (?P<value>[^|]*) \| (?P<row>[\w -]+/[\w.-]+) \|$", re.MULTILINE)


def section(text: str) -> str:
    """Return the section of results."""
    return text.partition(HEADING)[2].partition("\n## ")[0]


def with_measured(text: str, rows: Sequence[Row]) -> str:
    """Put what rows say into the table of results."""
    got = {f"{row['area']}/{row['name']}": row["got"] for row in rows if row["clip"] is None}

    def line(found: re.Match[str]) -> str:
        if found["row"] not in got:
            raise DvcError(f"the README names no row of the figures: {found['row']}")
        value = "not measured" if got[found["row"]] is None else short(got[found["row"]])
        return f"| {found['what']} | {value.replace('-', _MINUS)} | {found['row']} |"

    before = section(text)
    return text.replace(HEADING + before, HEADING + _LINE.sub(line, before))
