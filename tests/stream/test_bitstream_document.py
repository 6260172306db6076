"""The description of the bitstream is true."""

import io
import json
import os
import re
from pathlib import Path

from dvc.config import FIELD_NUMBERS, CodecConfig, KeyFrameConfig, VideoConfig
from dvc.stream import GopRecord, StreamReader, StreamWriter

DOCUMENT = Path(__file__).parents[2] / "docs" / "bitstream.md"
BEGIN, END = "<!-- fields: begin -->\n", "<!-- fields: end -->\n"
TYPES = {bool: "bool", int: "int", float: "float", str: "str", bytes: "bytes", tuple: "integers"}
CONFIG = CodecConfig(VideoConfig(176, 144, 15, 1), key=KeyFrameConfig(25))
RECORDS = [GopRecord(1, b"K0"), GopRecord(2, b"K2", True, b"", (b"W1!",), 0x13579BDF)]


def field_table() -> str:
    """Return the table of all fields, with what they are when nothing is said."""
    rows = ["| number | field | type | default |\n", "| --- | --- | --- | --- |\n"]
    defaults = CodecConfig(VideoConfig(1, 1, 1, 1))
    for path, number in FIELD_NUMBERS.items():
        *parents, name = path.split(".")
        section: object = defaults
        for parent in parents:
            section = getattr(section, parent)
        value = getattr(section, name)
        has_default = hasattr(type(section), name)
        shown = value.hex() if isinstance(value, bytes) else json.dumps(value)
        rows.append(
            f"| {number} | `{path}` | {TYPES[type(value)]} | {shown if has_default else '(none)'} |\n"
        )
    return "".join(rows)


def test_all_fields_of_the_configuration_are_described() -> None:
    """The table names every field with number, type and default; `DVC_REGENERATE=1` writes it again."""
    text = DOCUMENT.read_text()
    before, _, rest = text.partition(BEGIN)
    table, _, after = rest.partition(END)
    if os.environ.get("DVC_REGENERATE") == "1":
        table = field_table()
        DOCUMENT.write_text(before + BEGIN + table + END + after)
    assert table == field_table()


def test_the_example_is_a_stream() -> None:
    """The bytes of the example are those that the writer writes, and the reader reads them."""
    rows = re.findall(r"^\| (\d+) \| `((?:[0-9a-f]{2} ?)+)` \|", DOCUMENT.read_text(), re.MULTILINE)
    example = b""
    for offset, digits in rows:
        assert int(offset) == len(example)
        example += bytes.fromhex(digits)
    file = io.BytesIO()
    with StreamWriter(file, CONFIG, "punctured") as writer:
        for record in RECORDS:
            writer.write_gop(record)
    assert file.getvalue().hex(" ") == example.hex(" ")
    assert list(StreamReader(io.BytesIO(example))) == RECORDS
