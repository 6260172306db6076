"""Numbers in documents: each follows a mark with the name of its result, and is filled in from the document.

``<!-- row:NAME --> +4.6 %`` is the value of a result; ``<!-- row:NAME:box --> −3.0 %`` that of one clip.
The number ends before ``<!-- / -->``, which closes every mark. Given numbers, such as settings
and those of other projects, are between ``<!-- given -->`` and ``<!-- / -->``.
"""

import re
from collections.abc import Iterator
from pathlib import Path

from benchmarks.results.code import ROOT
from benchmarks.results.document import ABSENT, Entry, one_code
from benchmarks.results.rows import BY_NAME
from dvc.errors import ConfigError
from dvc.files import atomic_output

_MARK = re.compile(r"<!-- row:([a-z0-9-]+/[a-z0-9-]+)(?::([\w-]+))? -->(.*?)<!-- / -->", re.DOTALL)
_MEASURED = re.compile(
    r"(?<![\w/.-])[+−-]?\d+(?:\.\d+)? ?(?:%|dB\b|kbit/s|s/frame|(?:ms|s) (?:a|per) frame|bit/pixel|bpp\b)"
)
"""Numbers that look measured: shares, qualities, rates, times of a frame."""
_GIVEN = re.compile(r"<!-- given -->.*?<!-- / -->", re.DOTALL)
_CODE = re.compile(r"```.*?```|`[^`]*`", re.DOTALL)
GENERATED = ("results.md", "results.json")


def documents(root: Path = ROOT) -> list[Path]:
    """List the documents with numbers of results."""
    return [
        root / "README.md",
        *(path for path in sorted((root / "docs").glob("*.md")) if path.name not in GENERATED),
    ]


def filled(text: str, entries: dict[str, Entry]) -> str:
    """Put the values of results behind their marks."""
    shown = one_code(entries)

    def _value(match: re.Match[str]) -> str:
        name, clip = match[1], match[2]
        if name not in BY_NAME:
            raise ConfigError(f"no result is called {name!r}")
        return f"<!-- row:{name}{f':{clip}' if clip else ''} --> {_written(name, clip, shown)} <!-- / -->"

    return _MARK.sub(_value, text)


def _written(name: str, clip: str | None, shown: dict[str, Entry]) -> str:
    if name not in shown:
        return ABSENT
    if clip is None:
        return str(shown[name]["text"])
    values = shown[name]["by_clip"]
    if clip not in values:
        raise ConfigError(f"{name} has no clip {clip!r}, but {', '.join(values)}")
    return BY_NAME[name].written(values[clip])


def unmarked(text: str) -> Iterator[str]:
    """Find numbers that look measured but have no mark, with their context."""
    bare = _CODE.sub(" ", _GIVEN.sub("", _MARK.sub("", text)))
    for match in _MEASURED.finditer(bare):
        yield " ".join(bare[max(0, match.start() - 40) : match.end() + 20].split())


def fill(entries: dict[str, Entry]) -> list[Path]:
    """Fill in all documents, and return the changed ones."""
    changed = []
    for path in documents():
        text = path.read_text(encoding="utf-8")
        new = filled(text, entries)
        if new != text:
            with atomic_output(path) as temporary:
                temporary.write_text(new, encoding="utf-8")
            changed.append(path)
    return changed
