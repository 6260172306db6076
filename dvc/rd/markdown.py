"""Tables in Markdown."""

import re
from collections.abc import Sequence

NOTHING = "–"
"""What a cell without a value shows."""


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table.

    Parameters
    ----------
    head : sequence of str
        Titles.
    rows : sequence of sequence of str
        Cells.

    Returns
    -------
    str
        Lines, the last one with its end.
    """
    lines = [head, ["---"] * len(head), *rows]
    return "".join("| " + " | ".join(map(escaped, line)) + " |\n" for line in lines)


def escaped(text: str) -> str:
    """Write a text so that it is neither markup nor the end of a cell or line.

    Parameters
    ----------
    text : str
        Any.

    Returns
    -------
    str
        One line.
    """
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")


def fenced(lines: Sequence[str]) -> str:
    """Write lines as a block that is shown as it is.

    Parameters
    ----------
    lines : sequence of str
        Any; what would end the block makes its fence longer.

    Returns
    -------
    str
        Markdown.
    """
    text = "".join(f"{line}\n" for line in lines)
    fence = "`" * max(3, 1 + max((len(run) for run in re.findall("`+", text)), default=0))
    return f"{fence}\n{text}{fence}\n"
