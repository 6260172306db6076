"""Pages that are one file each: templates, a content policy, pictures and data in the text."""

import base64
import hashlib
import json
from collections.abc import Iterable, Sequence
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from dvc.files import atomic_output

SHARED = resources.files("dvc.web") / "templates"
"""Folder of style sheets, scripts and templates that all pages share."""


def asset(folder: Traversable, name: str) -> str:
    """Return the text of a style sheet, script or template."""
    return (folder / name).read_text(encoding="utf-8")


def render_page(
    folder: Traversable,
    name: str,
    *,
    css: Sequence[str],
    scripts: Sequence[str],
    served: bool = False,
    **values: Any,
) -> str:
    """Return the text of a page, with its assets and policy; the template extends ``document.html.j2``."""
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    environment = Environment(
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        loader=FunctionLoader(lambda shared: asset(SHARED, shared)),
    )
    early = "document.documentElement.classList.add('js');"
    return environment.from_string(asset(folder, name)).render(
        css="".join(css),
        early=early,
        scripts=scripts,
        policy=content_policy([early, *scripts], served),
        **values,
    )


def write_text(path: str | Path, text: str) -> None:
    """Write a page; names of files need not be text."""
    with atomic_output(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="replace")


def content_policy(scripts: Iterable[str], served: bool = False) -> str:
    """Return a policy that allows these scripts only, and requests to the page's own server if it has one."""
    digests = (base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii") for text in scripts)
    sources = " ".join(f"'sha256-{digest}'" for digest in digests)
    loads = " 'self'" if served else ""
    return (
        f"default-src 'none'; img-src data: blob:{loads}; style-src 'unsafe-inline'; script-src {sources}; "
        f"base-uri 'none'; form-action 'none'{'; connect-src' + loads if served else ''}"
    )


def script_json(values: object) -> str:
    """Return values as JSON that is safe inside a script element."""
    text = json.dumps(values, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def data_uri(media_type: str, content: bytes) -> str:
    """Return a picture as the address of an `img` element."""
    return f"data:{media_type};base64,{base64.b64encode(content).decode('ascii')}"
