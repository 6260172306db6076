"""Pages that are one file each: templates, a content policy, pictures and data in the text."""

import base64
import hashlib
import json
from collections.abc import Iterable, Sequence
from importlib import resources
from importlib.resources.abc import Traversable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jinja2 import Template

SHARED = resources.files("dvc.web") / "templates"
"""Folder of style sheets, scripts and templates that all pages share."""


def asset(folder: Traversable, name: str) -> str:
    """Return the text of a style sheet, script or template."""
    return (folder / name).read_text(encoding="utf-8")


def template(folder: Traversable, name: str) -> "Template":
    """Return a template, which can extend and import the templates in `SHARED`."""
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    environment = Environment(
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        loader=FunctionLoader(lambda shared: asset(SHARED, shared)),
    )
    return environment.from_string(asset(folder, name))


def render_page(
    folder: Traversable,
    name: str,
    *,
    styles: Sequence[str],
    scripts: Sequence[str],
    served: bool = False,
    **values: Any,
) -> str:
    """Return the text of a page, with its assets and policy; the template extends ``document.html.j2``."""
    return template(folder, name).render(
        css="".join(styles),
        early=(early := asset(SHARED, "early.js")),
        scripts=scripts,
        policy=content_policy([early, *scripts], served),
        **values,
    )


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
