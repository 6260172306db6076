"""Identity of the code of a result, by hashes as git computes them, and versions of installed packages."""

import ast
import hashlib
import re
import sys
from collections.abc import Sequence
from functools import cache
from importlib import metadata
from pathlib import Path

from dvc.files import atomic_output

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("dvc", "encoder", "decoder", "sfm", "sequences", "benchmarks")
_IGNORED = ("__pycache__", ".pyc", ".nbi", ".nbc", ".part")
CONSTRAINTS = ROOT / "docs" / "constraints.txt"
_HEAD = "# What results were measured with: pip install -c docs/constraints.txt '.[all]', by make results\n"
_NAME = re.compile(r"[A-Za-z0-9._-]+")


@cache
def code_digest(root: Path = ROOT) -> str:
    """Digest all packages without documents and tests."""
    lines = [f"{name} {tree_hash(root / name)}" for name in PACKAGES]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16]


def tree_hash(folder: Path) -> str:
    """Hash a folder as ``git rev-parse HEAD:FOLDER`` does once its files are committed."""
    entries = []
    for path in folder.iterdir():
        if path.name.endswith(_IGNORED) or (path.is_dir() and not any(_files(path))):
            continue
        if path.is_dir():
            entries.append((f"{path.name}/", b"40000", tree_hash(path)))
        else:
            mode = b"100755" if path.stat().st_mode & 0o100 else b"100644"
            entries.append((path.name, mode, _object_hash(b"blob", path.read_bytes())))
    parts = [
        mode + b" " + name.rstrip("/").encode() + b"\0" + bytes.fromhex(digest)
        for name, mode, digest in sorted(entries, key=lambda entry: entry[0].encode())
    ]
    return _object_hash(b"tree", b"".join(parts))


def own_code(*modules: str, files: Sequence[bytes] = ()) -> str:
    """Digest files, and the modules that measure a result without comments, docstrings and layout."""
    parts = [hashlib.sha256(data).hexdigest() for data in files]
    for name in sorted(modules):
        tree = ast.parse(Path(str(sys.modules[name].__file__)).read_bytes())
        for node in ast.walk(tree):
            if isinstance(node, ast.Module | ast.FunctionDef | ast.ClassDef) and ast.get_docstring(node):
                node.body = node.body[1:]
        parts.append(ast.dump(tree))
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]


def _files(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file() and "__pycache__" not in path.parts]


def _object_hash(kind: bytes, data: bytes) -> str:
    return hashlib.sha1(b"%s %d\0" % (kind, len(data)) + data, usedforsecurity=False).hexdigest()


def write_constraints(path: Path = CONSTRAINTS) -> None:
    """Write a line for each installed package that this one needs, directly or not."""
    found, names = dict[str, str](), ["dvc3d"]
    while names:
        name = names.pop()
        for needed in metadata.requires(name) or ():
            is_extra = "extra ==" in needed and name != "dvc3d"
            match = _NAME.match(needed)
            if is_extra or match is None or (key := re.sub(r"[-_.]+", "-", match[0]).lower()) in found:
                continue
            try:
                found[key] = metadata.version(key)
            except metadata.PackageNotFoundError:  # a package for other systems
                continue
            names.append(key)
    found.pop("dvc3d", None)
    text = _HEAD + "".join(f"{name}=={version}\n" for name, version in sorted(found.items()))
    with atomic_output(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
