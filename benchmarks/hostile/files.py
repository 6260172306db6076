"""Files that commands read: damage to one of several in a folder, and the reader that must bear it."""

import re
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from benchmarks.hostile.mutations import Change, mutate
from dvc.bits import decode_bytes, encode_varint
from dvc.errors import DvcError

Files = dict[str, bytes]
"""Contents by name."""
_WORD = re.compile(rb"-?\d[\d.eE+-]*|\btrue\b|\bfalse\b|\bnull\b|\"[^\"\n]*\"")
_ODD = (*b"0 -1 1e308 -1e308 1e-308 NaN inf 65536 2147483648 null true".split(), b"9" * 40, b'""', b'"../x"')
_ODD += (b"[]", b"{}", b"[" * 40 + b"]" * 40, b'"\\ud800"', b'"\\u0000"')


def mutate_text(data: bytes, rng: np.random.Generator) -> bytes:
    """Put something odd in the place of a number or a quoted word, or damage bytes."""
    words = list(_WORD.finditer(data))
    if not words or rng.random() < 0.4:
        return mutate(data, rng)
    word = words[int(rng.integers(len(words)))]
    return data[: word.start()] + _ODD[int(rng.integers(len(_ODD)))] + data[word.end() :]


def damaged_files(good: Sequence[Files], number: int, change: Change = mutate_text) -> bytes:
    """Return files of which one is damaged, one after the other with their names."""
    rng, files = np.random.default_rng(number), dict(good[number % len(good)])
    chosen = sorted(files)[int(rng.integers(len(files)))]
    files[chosen] = change(files[chosen], rng)
    parts = [part for name, data in files.items() for part in (name.encode(), data)]
    return b"".join(encode_varint(len(part)) + part for part in parts)


def try_files(read: Callable[[Path], bool], damaged: bytes) -> str:
    """Read files; `read` gets their folder, and tells whether what it has read is as it must be."""
    with tempfile.TemporaryDirectory() as folder:
        position = 0
        while position < len(damaged):
            name, position = decode_bytes(damaged, position, len(damaged))
            data, position = decode_bytes(damaged, position, len(damaged))
            (Path(folder) / name.decode()).write_bytes(data)
        try:
            return "decoded" if read(Path(folder)) else "what is read is not finite, or not what it says"
        except (DvcError, OSError):
            return "refused"


def contents(folder: Path) -> Files:
    """Return the files of a folder."""
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.is_file()}


def written(write: Callable[[Path], object]) -> Files:
    """Return what something writes into a folder."""
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder))
        return contents(Path(folder))
