"""Streams: written, read in order and at random, from files and pipes, whole and damaged."""

import io
import os
import threading
import tracemalloc
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import BinaryIO, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.bits import encode_varint
from dvc.config import CodecConfig, VideoConfig, codec_config
from dvc.errors import BitstreamError
from dvc.stream import (
    Form,
    GopRecord,
    RecordType,
    StreamIndex,
    StreamReader,
    StreamWriter,
    encode_gop,
    gop_bits,
)
from dvc.stream.records import encode_end, frame_record

CONFIG = codec_config(VideoConfig(176, 144, 15, 1), "2d", gop={"length": 4}, key={"intra_period": 16})
RECORDS = [
    GopRecord(1, b"first key"),
    GopRecord(4, b"a key" * 40, True, b"", (b"wz 1" * 40, b"", b"wz 3")),
    GopRecord(4, b"", False, b"tracks", (b"wz 5", b"wz 6", b"wz 7")),
    GopRecord(2, b"last key", True, b"", (b"wz 9",)),
]
forms = pytest.mark.parametrize("form", list(Form))


def in_form(form: Form | str, records: list[GopRecord]) -> list[GopRecord]:
    """Return records in a form of stream: punctured ones have digests."""
    if Form(form) is not Form.PUNCTURED:
        return records
    return [replace(r, digest=zlib.crc32(r.key)) if r.wyner_ziv else r for r in records]


def write(form: Form | str, records: list[GopRecord], config: CodecConfig = CONFIG) -> bytes:
    file = io.BytesIO()
    with StreamWriter(file, config, form) as writer:
        for record in in_form(form, records):
            writer.write_gop(record)
    assert writer.num_bytes == len(file.getvalue())
    return file.getvalue()


def changed(data: bytes, position: int, bits: int) -> bytes:
    return data[:position] + bytes([data[position] ^ bits]) + data[position + 1 :]


def read_before_error(source: bytes | BinaryIO) -> tuple[list[GopRecord], str]:
    """Return the records that a reader yields before it raises, and the message."""
    records: list[GopRecord] = []
    try:
        for record in StreamReader(io.BytesIO(source) if isinstance(source, bytes) else source):
            records.append(record)
    except BitstreamError as err:
        return records, str(err)
    return records, ""


@forms
@pytest.mark.parametrize("piped", [False, True])
def test_unfinished_streams_give_their_finished_groups(form: Form, piped: bool) -> None:
    """Cut anywhere, a stream has the whole groups before the cut, and reports the missing part."""
    data, records = write(form, RECORDS), in_form(form, RECORDS)
    entries = StreamReader(io.BytesIO(data)).index.entries
    for cut in range(entries[0].offset, len(data) + 1):
        whole = [entry for entry in entries if entry.offset + entry.size <= cut]
        file = io.BytesIO(data[:cut])
        if piped:
            file.seekable = lambda: False
        reader = StreamReader(file, unfinished=True)
        if not whole:
            with pytest.raises(BitstreamError, match="record 1"):
                list(reader)
            continue
        assert list(reader) == records[: len(whole)]
        assert list(reader) == []
        assert (reader.missing is None) == (cut == len(data))
        if reader.missing is not None:
            assert f"groups of pictures before it: {len(whole)}," in reader.missing


@forms
def test_unfinished_streams_have_an_index(form: Form) -> None:
    """Groups of a cut stream can be sought; a whole stream lacks nothing when it is read as unfinished."""
    data, records = write(form, RECORDS), in_form(form, RECORDS)
    entries = StreamReader(io.BytesIO(data)).index.entries
    for cut in (entries[2].offset, entries[3].offset - 1, len(data)):
        reader = StreamReader(io.BytesIO(data[:cut]), unfinished=True)
        whole = 2 if cut < len(data) else 4
        assert reader.index.entries == entries[:whole]
        reader.seek_gop(1)
        assert list(reader) == records[1:whole]
        assert (reader.missing is None) == (whole == 4)


def test_damage_is_no_unfinished_end() -> None:
    data = write("buffered", RECORDS)
    position = StreamReader(io.BytesIO(data)).index.entries[2].offset + 9
    reader = StreamReader(io.BytesIO(changed(data, position, 1)), unfinished=True)
    with pytest.raises(BitstreamError, match=r"record 3 .* checksum mismatch"):
        list(reader)


@forms
@given(
    lengths=st.lists(st.integers(1, 4), max_size=6),
    rng=st.integers(0, 2**32).map(np.random.default_rng),
)
def test_streams_come_back(form: Form, lengths: list[int], rng: np.random.Generator) -> None:
    """Any sequence of groups of pictures comes back, in order and by number, with its sizes."""
    lengths = [1, *lengths] if lengths else []
    records = [
        GopRecord(
            n,
            rng.bytes(int(rng.integers(200))),
            number > 0 and bool(rng.integers(2)),
            b"",
            tuple(rng.bytes(int(rng.integers(200))) for _ in range(n - 1)),
        )
        for number, n in enumerate(lengths)
    ]
    data = write(form, records)
    reader = StreamReader(io.BytesIO(data))
    assert (reader.config, reader.form) == (CONFIG, form)
    assert list(reader) == in_form(form, records)
    assert list(reader) == []
    assert [8 * entry.size for entry in reader.index.entries] == [
        gop_bits(record).total for record in in_form(form, records)
    ]
    assert [entry.num_frames for entry in reader.index.entries] == lengths
    assert reader.index.num_frames == sum(lengths)
    for number in range(len(records) + 1):
        reader.seek_gop(number)
        assert list(reader) == in_form(form, records[number:])


@forms
def test_seeking_before_and_while_reading(form: Form, tmp_path: Path) -> None:
    path = tmp_path / "s.dvc"
    path.write_bytes(write(form, RECORDS))
    with StreamReader(path) as reader:
        reader.seek_gop(2)
        assert next(reader) == in_form(form, RECORDS)[2]
        assert reader.index.first_frame(2) == 5
        assert next(reader) == in_form(form, RECORDS)[3]
        reader.seek_gop(0)
        assert list(reader) == in_form(form, RECORDS)
        for number in (-1, 5):
            with pytest.raises(ValueError, match="`number` must be from 0 to 4"):
                reader.seek_gop(number)
        assert reader.index.num_frames == 11
        gops = [n for n, record in enumerate(RECORDS) for _ in range(record.num_frames)]
        assert [reader.index.gop_of(frame) for frame in range(11)] == gops
        for frame in (-1, 11):
            with pytest.raises(ValueError, match="`frame` must be from 0 to 10"):
                reader.index.gop_of(frame)


def test_punctured_form_pays_for_no_index() -> None:
    head = len(write("punctured", [])) - 7
    sizes = {form: sum(gop_bits(record).total // 8 for record in in_form(form, RECORDS)) for form in Form}
    assert len(write("punctured", RECORDS)) == head + sizes[Form.PUNCTURED] + 7
    assert sizes[Form.PUNCTURED] == sizes[Form.BUFFERED] + 4 * sum(
        record.num_frames > 1 for record in RECORDS
    )
    assert len(write("buffered", RECORDS)) > head + sizes[Form.BUFFERED] + 7


@pytest.mark.parametrize(("intra_period", "place"), [(0, 1), (0, 0), (16, 0)])
def test_predicted_key_frames_where_there_can_be_none_are_refused(intra_period: int, place: int) -> None:
    file = io.BytesIO()
    config = replace(CONFIG, key=replace(CONFIG.key, intra_period=intra_period))
    with StreamWriter(file, config, "buffered") as writer:
        for number in range(3):
            writer.write_gop(GopRecord(1, b"key", predicted=number == place))
    reader = StreamReader(io.BytesIO(file.getvalue()))
    assert [next(reader).predicted for _ in range(place)] == [False] * place
    with pytest.raises(BitstreamError, match=rf"record {place + 1} .*a predicted key frame has no reference"):
        next(reader)


def test_writer_refuses_what_readers_would() -> None:
    """The first GOP is one key frame, the other ones have a largest length, and nothing follows the end."""
    writer = StreamWriter(io.BytesIO(), CONFIG, "buffered")
    with pytest.raises(ValueError, match="must add 1 frames or fewer"):
        writer.write_gop(RECORDS[1])
    writer.write_gop(RECORDS[0])
    with pytest.raises(ValueError, match="must add 4 frames or fewer, got 5"):
        writer.write_gop(GopRecord(5, b"", False, b"", (b"",) * 4))
    with pytest.raises(BitstreamError, match="takes 67108865 bytes"):
        writer.write_gop(GopRecord(1, bytes(2**26)))
    writer.close()
    writer.close()
    with pytest.raises(ValueError, match="closed"):
        writer.write_gop(RECORDS[0])
    with pytest.raises(ValueError, match="compressed"):
        StreamWriter(io.BytesIO(), CONFIG, "compressed")


def test_failed_writing_leaves_no_end() -> None:
    file = io.BytesIO()

    def fail() -> None:
        with StreamWriter(file, CONFIG, "buffered") as writer:
            writer.write_gop(RECORDS[0])
            raise KeyError("stop")

    with pytest.raises(KeyError):
        fail()
    records, message = read_before_error(file.getvalue())
    assert records == RECORDS[:1]
    assert "ends without its end record" in message


@forms
def test_pipes_are_read_in_order(form: Form) -> None:
    read_end, write_end = os.pipe()

    def fill() -> None:
        with open(write_end, "wb") as file, StreamWriter(file, CONFIG, form) as writer:
            for record in in_form(form, RECORDS):
                writer.write_gop(record)

    thread = threading.Thread(target=fill)
    thread.start()
    with open(read_end, "rb") as file:
        reader = StreamReader(file)
        assert list(reader) == in_form(form, RECORDS)
        with pytest.raises(BitstreamError, match="pipe"):
            reader.seek_gop(0)
    thread.join()


class Dribble(io.RawIOBase):
    def __init__(self, data: bytes) -> None:
        self.data = data

    def readable(self) -> bool:
        return True

    def read(self, size: int = -1) -> bytes:
        part, self.data = self.data[: min(size, 3)], self.data[min(size, 3) :]
        return part


@forms
def test_every_cut_is_noticed(form: Form) -> None:
    data = write(form, RECORDS)
    entries = StreamReader(io.BytesIO(data)).index.entries
    assert list(StreamReader(cast(BinaryIO, Dribble(data)))) == in_form(form, RECORDS)
    for size in range(entries[0].offset):
        with pytest.raises(BitstreamError):
            StreamReader(io.BytesIO(data[:size]))
    for size in range(entries[0].offset, len(data)):
        records, message = read_before_error(data[:size])
        num_whole = sum(entry.offset + entry.size <= size for entry in entries)
        assert records == in_form(form, RECORDS[:num_whole])
        assert message.startswith(f"record {num_whole + 1} ")
        assert read_before_error(cast(BinaryIO, Dribble(data[:size])))[0] == records


@forms
def test_every_changed_byte_is_noticed(form: Form) -> None:
    data = write(form, RECORDS)
    entries = StreamReader(io.BytesIO(data)).index.entries
    for position in range(len(data)):
        for change in (0x01, 0x80, 0xFF):
            records, message = read_before_error(changed(data, position, change))
            num_whole = sum(entry.offset + entry.size <= position for entry in entries)
            assert message
            assert "\n" not in message
            assert records == in_form(form, RECORDS[:num_whole])


def test_messages_name_record_type_and_offset() -> None:
    data = write("buffered", RECORDS)
    offset = StreamReader(io.BytesIO(data)).index.entries[1].offset
    for damaged, message in (
        (changed(data, offset + 20, 4), f"record 2 (group of pictures) at byte {offset}: checksum mismatch"),
        (data[: offset + 40], "record 2 (group of pictures) at byte"),
        (changed(data, offset, 2 ^ 9), f"record 2 at byte {offset}: unknown type 9"),
        (data + b"!", "bytes follow the end record"),
    ):
        assert message in read_before_error(damaged)[1]


def head(form: Form) -> bytes:
    data = write(form, [])
    return data[: len(data) - (12 if form is Form.BUFFERED else 7)]


READS = "this program reads version 2"
START = head(Form.PUNCTURED)
FIRST = frame_record(RecordType.GOP, encode_gop(RECORDS[0]))
END = frame_record(RecordType.END, b"\x01")
group = partial(frame_record, RecordType.GOP)
configuration = partial(frame_record, RecordType.CONFIGURATION)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "not a dvc3d stream"),
        (b"RIFF" + START[4:], "not a dvc3d stream"),
        (START[:4], "format version missing"),
        (START[:4] + b"\x09" + START[5:], f"version 9; {READS}"),
        (START[:4] + b"\x01" + START[5:], f"1, made by .* dvc3d before 2; {READS}"),
        (START[:5] + FIRST + END, r"record 0 \(group of pictures\) .*must be the conf"),
        (START + START[5:] + END, r"record 1 \(configuration\) .*first and once"),
        (START + FIRST + FIRST, "ends without its end record"),
        (START + FIRST + END[:-1], "bytes promised"),
        (START + END, "1 frames promised, 0 found"),
        (START + FIRST + FIRST + END, "1 frames promised, 2 found"),
        (START + FIRST + END + END, "bytes follow"),
        (START + b"\2" + b"\xff" * 4 + b"\x7f", "bytes of payload, at most 67108864"),
        (START + b"\2" + b"\x80" * 5 + b"\1", "length: integer"),
        (START + b"\2", "length: data end"),
        (START + group(encode_gop(RECORDS[1])) + END, "4 frames, at most 1 are"),
        (START + FIRST + group(b"\x14" + bytes(9)) + END, "5 frames, at most 4 are"),
        (START + FIRST + frame_record(RecordType.END, b"\1\0"), "1 bytes are left over"),
        (START[:5] + configuration(b"\3"), "record 0 .*unknown form"),
        (START[:5] + configuration(b""), "record 0 .*unknown form"),
        (
            START[:5] + configuration(b"\x01\x7f"),
            r"record 0 \(configuration\) at byte 5: configuration: `configuration` must be an array",
        ),
    ],
)
def test_wrong_order_and_sizes_are_refused(data: bytes, message: str) -> None:
    """Records with a right checksum, but out of place or with wrong numbers, are refused by name."""
    with pytest.raises(BitstreamError, match=message):
        list(StreamReader(io.BytesIO(data)))


WRONG_INDICES = (
    "",
    "01",
    "01 01",
    "01 01 11 01",
    "01 01 11 01 00 00 00 00",
    "01 01 12 01 0e 00 00 00",
    "01 01 11 02 0e 00 00 00",
    "01 02 08 01 09 00 10 00 00 00",
    "01 ff ff ff ff 7f" + 30 * " 00",
)


@pytest.mark.parametrize("payload", [bytes.fromhex(digits) for digits in WRONG_INDICES])
def test_wrong_index_is_refused(payload: bytes) -> None:
    """An index that is cut or does not agree with the records is refused, read in order or from the end."""
    data = head(Form.BUFFERED) + FIRST + frame_record(RecordType.END, payload)
    assert read_before_error(data)[0] == RECORDS[:1]
    assert "record 2 (end)" in read_before_error(data)[1]
    with pytest.raises(BitstreamError):
        _ = StreamReader(io.BytesIO(data)).index


def test_index_of_damaged_streams_is_refused() -> None:
    for form in Form:
        data = write(form, RECORDS)
        for size in range(len(head(form)), len(data), 3):
            with pytest.raises(BitstreamError):
                _ = StreamReader(io.BytesIO(data[:size])).index
    extra = write("punctured", RECORDS)[:-7] + head(Form.PUNCTURED)[5:]
    with pytest.raises(BitstreamError, match="unexpected after 4 groups"):
        _ = StreamReader(io.BytesIO(extra)).index
    with pytest.raises(BitstreamError, match=r"record 1 .* 0 frames"):
        _ = StreamReader(io.BytesIO(head(Form.PUNCTURED) + frame_record(RecordType.GOP, b"\x00"))).index


def test_record_that_the_index_denies_is_refused() -> None:
    """After seeking, a record that is not as the index says is damage, not another frame in its place."""
    good = StreamReader(io.BytesIO(write(Form.BUFFERED, RECORDS))).index
    changed = (replace(good.entries[0], num_frames=2), replace(good.entries[1], num_frames=3))
    data = write(Form.BUFFERED, RECORDS)[: good.entries[-1].offset + good.entries[-1].size]
    end = encode_end(StreamIndex(good.num_frames, changed + good.entries[2:]), Form.BUFFERED)
    reader = StreamReader(io.BytesIO(data + frame_record(RecordType.END, end)))
    reader.seek_gop(1)
    with pytest.raises(BitstreamError, match=r"record 2 .* the index does not agree"):
        next(reader)


def test_unreadable_files_are_bitstream_errors(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "missing.dvc"):
        with pytest.raises(BitstreamError, match="cannot read"):
            StreamReader(path)


def test_random_mutations_raise_only_bitstream_errors() -> None:
    rng = np.random.default_rng(20)
    streams = [write(form, RECORDS) for form in Form]
    for trial in range(2000):
        data = bytearray(streams[trial % 2])
        for _ in range(rng.integers(1, 4)):
            first, last = sorted(rng.integers(0, len(data) + 1, 2))
            data[first : min(last, first + 4)] = rng.bytes(int(rng.integers(0, 5)))
        read_outcome(bytes(data))


@given(st.binary(max_size=60))
def test_arbitrary_payloads_behind_right_checksums(payload: bytes) -> None:
    for form in Form:
        for record_type in RecordType:
            read_outcome(head(form) + frame_record(record_type, payload))
    read_outcome(head(Form.PUNCTURED)[:5] + frame_record(RecordType.CONFIGURATION, b"\x01" + payload))


def read_outcome(data: bytes) -> None:
    """Read a stream in order and its index; let only errors other than `BitstreamError` escape."""
    with suppress(BitstreamError):
        reader = StreamReader(io.BytesIO(data))
        for action in (lambda: list(reader), lambda: reader.index, lambda: reader.seek_gop(0)):
            with suppress(BitstreamError):
                action()


@contextmanager
def allocating_at_most(max_bytes: int) -> Iterator[None]:
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < max_bytes
    finally:
        tracemalloc.stop()


def test_promises_cost_no_memory() -> None:
    """A length that the file does not hold is refused before memory is spent on it, also from a pipe."""
    data = head(Form.BUFFERED) + b"\x02" + encode_varint(2**26 - 1) + b"short"
    index = frame_record(RecordType.END, b"\x01" + encode_varint(2**20) + bytes(100))
    with allocating_at_most(2**20):
        for file in (io.BytesIO(data), Dribble(data), io.BytesIO(head(Form.BUFFERED) + index)):
            with pytest.raises(BitstreamError):
                list(StreamReader(cast(BinaryIO, file)))


def test_memory_is_that_of_one_gop() -> None:
    data = write("punctured", [GopRecord(1, bytes(2**18))] * 40)
    with allocating_at_most(2**21):
        for record in StreamReader(io.BytesIO(data)):
            assert len(record.key) == 2**18
