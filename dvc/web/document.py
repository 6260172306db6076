"""What a page that lies in one file is made of: assets, a content policy, pictures and data in its text."""

import base64
import hashlib
import json
from collections.abc import Iterable
from importlib import resources
from importlib.resources.abc import Traversable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jinja2 import Template

SHARED = resources.files("dvc.web") / "templates"
"""Style sheet, scripts and templates that pages share."""


def asset(folder: Traversable, name: str) -> str:
    """Return the text of a style sheet, script or template."""
    return (folder / name).read_text(encoding="utf-8")


def template(folder: Traversable, name: str) -> "Template":
    """Return a template that can import those of `SHARED`."""
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    environment = Environment(
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        loader=FunctionLoader(lambda shared: asset(SHARED, shared)),
    )
    return environment.from_string(asset(folder, name))


def content_policy(scripts: Iterable[str], served: bool = False) -> str:
    """Return the policy of a page that runs these scripts alone, and loads nothing but from its server."""
    digests = (base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii") for text in scripts)
    sources = " ".join(f"'sha256-{digest}'" for digest in digests)
    loads = " 'self'" if served else ""
    return (
        f"default-src 'none'; img-src data: blob:{loads}; style-src 'unsafe-inline'; script-src {sources}; "
        f"base-uri 'none'; form-action 'none'{'; connect-src' + loads if served else ''}"
    )


def script_json(values: object) -> str:
    """Write values as JSON that can stand inside a script element."""
    text = json.dumps(values, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def data_uri(media_type: str, content: bytes) -> str:
    """Return a picture as the address of an `img` element."""
    return f"data:{media_type};base64,{base64.b64encode(content).decode('ascii')}"
