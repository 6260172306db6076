"""The description of the bitstream is true."""

import io
import json
import os
import re
from collections.abc import Iterator
from dataclasses import MISSING, fields, replace
from pathlib import Path
from typing import Any

import pytest

from dvc.config import (
    CascadeConfig,
    CodecConfig,
    CoderConfig,
    DiscoverMatrix,
    KeyFrameConfig,
    TurboConfig,
    VideoConfig,
    codec_config,
)
from dvc.config.sections import Section
from dvc.stream import Form, GopRecord, StreamReader, StreamWriter
from dvc.stream.records import encode_configuration
from tests.reference.stream_reader import read_configuration

DOCUMENT = Path(__file__).parents[2] / "docs" / "spec" / "bitstream.md"
BEGIN, END = "<!-- fields: begin -->\n", "<!-- fields: end -->\n"
TYPES = {bool: "bool", int: "int", float: "float", str: "str", bytes: "bytes", tuple: "integers"}
CONFIG = CodecConfig(VideoConfig(176, 144, 15, 1), key=KeyFrameConfig(25))
RECORDS = [GopRecord(1, b"K0"), GopRecord(2, b"K2", True, b"", (b"W1!",), 0x13579BDF)]


def field_rows(section: Any, place: str = "", path: str = "") -> Iterator[str]:
    """Yield a line for each field of a section and of the sections in it."""
    values = [(field.name, field.default) for field in fields(section)]
    if isinstance(section, CoderConfig):
        values.insert(0, ("name", section.name))
    for number, (name, default) in enumerate(values):
        value = getattr(section, name)
        if isinstance(value, Section):
            yield from field_rows(value, f"{number}.", f"{name}.")
            continue
        shown = value.hex() if isinstance(value, bytes) else json.dumps(value)
        shown = "required" if default is MISSING else shown
        yield f"{place + str(number):<5}{path + name:<36}{TYPES[type(value)]:<10}{shown}".rstrip() + "\n"


def field_table() -> str:
    return "```text\n" + "".join(field_rows(CodecConfig(VideoConfig(1, 1, 1, 1)))) + "```\n"


def test_all_fields_of_the_configuration_are_described() -> None:
    """The table names every field with number, type and default; `DVC_REGENERATE=1` writes it again."""
    text = DOCUMENT.read_text()
    before, _, rest = text.partition(BEGIN)
    table, _, after = rest.partition(END)
    if os.environ.get("DVC_REGENERATE") == "1":
        table = field_table()
        DOCUMENT.write_text(before + BEGIN + table + END + after)
    assert table == field_table()


def leaves(values: dict[str, Any]) -> list[Any]:
    return [
        leaf for value in values.values() for leaf in (leaves(value) if isinstance(value, dict) else [value])
    ]


SETS = b"any bytes" * 40


@pytest.mark.parametrize(
    "config",
    [
        CONFIG,
        codec_config(CONFIG.video, seed=2**31 - 1),
        codec_config(
            VideoConfig(5, 3000, 2**31 - 1, 1001, True),
            "2d",
            DiscoverMatrix(8),
            key={"lossless": True, "parameter_sets": SETS},
            coder=CascadeConfig(0),
            geometry={"path_regularity": 0.1},
            side_information={"method": "an-extension-of-any-name-there-is"[:32]},
        ),
    ],
)
def test_another_reader_finds_all_fields(config: CodecConfig) -> None:
    """A reader that was written from the description alone finds every value at its place."""
    found = read_configuration(encode_configuration(config, Form.BUFFERED))
    sets = found["parameter_sets"]
    assert sets == config.key.parameter_sets
    values = config.to_dict()
    values["key"]["parameter_sets"] = sets
    assert list(found.values()) == leaves(values)
    turbo = read_configuration(encode_configuration(replace(config, coder=TurboConfig()), Form.NO_FEEDBACK))
    assert turbo == found | {"coder": "turbo", "batch_percent": turbo["batch_percent"]}


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
