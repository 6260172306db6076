"""Documents of the repository as pages of the site: included files, and links that lead out of docs/."""

import os
import re
import shutil
from pathlib import Path

from sphinx.application import Sphinx

DOCS = Path(__file__).resolve().parents[1]
ROOT = DOCS.parent
PAGES = {
    "README.md": "start.md",
    "CHANGELOG.md": "changes.md",
    "CITATION.cff": "cite.md",
    "LICENSE": "cite.md",
}
"""Pages of the site that show files outside docs/."""
PAGES_VARIABLE = "DVC_SITE_PAGES"
"""Environment variable with the folder where tutorials leave what the site shows in frames."""
_INCLUDE = re.compile(r"^```\{include\} (\S+)\n```$", re.MULTILINE)
_LINK = re.compile(r"(!?)\[([^\]]*)\]\((?!https?:|#)([^)#\s]+)(#[^)]*)?\)")


def page_text(path: Path) -> str:
    """Return what a page shows: its text and what it includes, with links between pages."""
    text = _linked(path.read_text(encoding="utf-8"), path, path.parent)

    def _included(found: re.Match[str]) -> str:
        file = (path.parent / found[1]).resolve()
        return _linked(file.read_text(encoding="utf-8"), file, path.parent)

    return _INCLUDE.sub(_included, text)


def _linked(text: str, path: Path, folder: Path) -> str:
    """Make the links of a file those of a page in a folder; what is no page stays as text."""

    def _link(found: re.Match[str]) -> str:
        mark, label, target, anchor = found.groups()
        file = (path.parent / target).resolve()
        name = file.relative_to(ROOT).as_posix()
        file = DOCS / PAGES[name] if name in PAGES else file
        if DOCS not in file.parents:
            return label
        return f"{mark}[{label}]({os.path.relpath(file, folder)}{anchor or ''})"

    return _LINK.sub(_link, text)


def _read(app: Sphinx, docname: str, source: list[str]) -> None:
    path = Path(app.env.doc2path(docname))
    if path.suffix == ".md":
        for name in _INCLUDE.findall(path.read_text(encoding="utf-8")):
            app.env.note_dependency(str((path.parent / name).resolve()))  # whose changes are this page's
        source[0] = page_text(path)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    pages = Path(app.outdir) / "pages"
    pages.mkdir(parents=True, exist_ok=True)
    os.environ[PAGES_VARIABLE] = str(pages)
    startup = Path(app.doctreedir) / "ipython" / "profile_default" / "startup"
    startup.mkdir(parents=True, exist_ok=True)
    shutil.copy(DOCS / "site" / "shell.py", startup)
    (startup.parent / "ipython_kernel_config.py").write_text("c.IPKernelApp.log_level = 40\n")
    os.environ["IPYTHONDIR"] = str(startup.parents[1])
    app.connect("source-read", _read, priority=100)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
