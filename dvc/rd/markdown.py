"""Tables in Markdown."""

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
    return "".join("| " + " | ".join(map(_escaped, line)) + " |\n" for line in lines)


def _escaped(cell: str) -> str:
    """Write a text so that it is neither the end of a cell nor markup."""
    return cell.replace("|", "\\|").replace("<", "&lt;")
