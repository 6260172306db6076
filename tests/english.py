"""Lint of the English of code and documents: `python -m tests.english` lists phrases to rewrite.

A file of allowed counts keeps old phrases from spreading: it may shrink, and `--write` brings it up to date.
"""

import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ALLOWED = ROOT / "tests" / "english.txt"
PACKAGES = ("dvc/", "encoder/", "decoder/", "sfm/", "sequences/", "docs/", "README.md")
PATTERNS = {
    "tell": (r"\b([Tt]ells?|[Tt]old)\b", "return, encode, report, specify"),
    "verb": (r'"""(Say|Let|Tell) ', "Return, Keep, Allow"),
    "what": (r'"""What |\bwhat (is|was|are|has|it|they|there)\b', "the noun"),
    "fragment": (
        r'"""(Of|Where|By|At|In|To|With|Beyond|For|Up) |#( |, )?of (it|the|a|all|each|this|that|its)\b',
        "a whole noun phrase",
    ),
    "where": (r"\b[Ww]here (there|it|they|that|no|one|nothing|a|the)\b", "if, when, unless"),
    "which": (r"\b(of|by|to|from|in|with|for|on|at) which\b|\bwhose\b", "two sentences, with"),
    "body": (r"\b([Nn]obody|[Aa]nybody|[Ss]omebody|[Ww]ho(ever)|[Ww]hat(ever)|[Ww]here(ver))\b", "a noun"),
    "others": (r"\bothers\b|\balone\b|\bbeside\b", "the other X, only, besides"),
    "so": (r"\bso (many|much|few|far|long)\b(?! as)|\bstands?\b", "up to N, is"),
    "phrase": (
        r"\b(but for|anew|as far as|in place of|giv(e|es|en) up|lets? go|go(es)? on)\b",
        "except, again, instead of, abort, continue",
    ),
}


def phrases() -> Counter[tuple[str, str]]:
    """Count the phrases of each kind in each file."""
    found: Counter[tuple[str, str]] = Counter()
    for path, _, _, kind in occurrences():
        found[path, kind] += 1
    return found


def occurrences() -> list[tuple[str, int, str, str]]:
    """Return file, line number, line and kind of each phrase."""
    names = subprocess.run(
        ["git", "ls-files", "*.py", "*.md"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.split()
    found = []
    for name in (name for name in names if name.startswith(PACKAGES) and (ROOT / name).is_file()):
        for number, line in enumerate((ROOT / name).read_text(encoding="utf-8").splitlines(), 1):
            found += [
                (name, number, line.strip(), kind)
                for kind, (pattern, _) in PATTERNS.items()
                if re.search(pattern, line)
            ]
    return found


def allowed() -> Counter[tuple[str, str]]:
    """Read the allowed counts."""
    rows = (line.split() for line in ALLOWED.read_text(encoding="utf-8").splitlines())
    return Counter({(path, kind): int(count) for path, kind, count in rows})


def main() -> int:
    """List the phrases of files and kinds with more than are allowed."""
    found = phrases()
    if "--write" in sys.argv:
        rows = [f"{path} {kind} {count}\n" for (path, kind), count in sorted(found.items())]
        ALLOWED.write_text("".join(rows), encoding="utf-8")
        return 0
    limits = allowed()
    more = {key for key, count in found.items() if count > limits[key]}
    for path, number, line, kind in occurrences():
        if (path, kind) in more:
            sys.stdout.write(f"{path}:{number}: {kind} ({PATTERNS[kind][1]}): {line}\n")
    return int(bool(more))


if __name__ == "__main__":
    sys.exit(main())
