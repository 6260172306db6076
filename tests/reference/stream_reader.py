"""A reader of streams, written from the bitstream and decoding pages of docs/spec; it imports no package."""

import struct
import zlib
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import zip_longest
from math import ceil

from tests.reference.entropy import Context

Bits = list[int]

MASK = 2**64 - 1
NEEDED = object()
FIELDS: list[tuple[str, object]] = [
    (
        "video",
        [
            ("width", NEEDED),
            ("height", NEEDED),
            ("frame_rate_num", NEEDED),
            ("frame_rate_den", NEEDED),
            ("luma_only", False),
        ],
    ),
    ("codec", "3d-te"),
    ("gop", [("gop_length", 8), ("references", "hierarchical")]),
    ("key", [("key_qp", 30), ("key_lossless", False), ("intra_period", 96), ("parameter_sets", b"")]),
    (
        "wyner_ziv",
        [("levels", []), ("noise_model", "local"), ("qp", 30), ("priors", "learned"), ("limited", False)],
    ),
    ("coder", [("coder", "cascade"), ("batch_percent", 20)]),
    ("side_information", [("method", "depth"), ("track_corrections", True), ("fallback", "tracks")]),
    ("geometry", [("backend", "native"), ("path_regularity", 0.0)]),
    ("tracks", [("tracks_kind", "encoder"), ("num_points", 128), ("subpixel_bits", 1)]),
    ("seed", 0),
]
"""Sections and their fields in order, with defaults; names are those of this reader."""
SINGLE = {0xC0: None, 0xC2: False, 0xC3: True}
NUMBERS = {0xCC: 1, 0xCD: 2, 0xCE: 4, 0xCF: 8}
COUNTED = {0xC4: ("bytes", 1), 0xC5: ("bytes", 2), 0xD9: ("str", 1), 0xDC: ("array", 2)}
"""Codes of MessagePack, with sizes of what follows them."""
ZIGZAG = (0, 1, 4, 8, 5, 2, 3, 6, 9, 12, 13, 10, 7, 11, 14, 15)


class Bytes:
    """Data that are read from the front."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def take(self, count: int) -> bytes:
        """Return the next bytes."""
        self.at += count
        assert self.at <= len(self.data)
        return self.data[self.at - count : self.at]

    def varint(self) -> int:
        """Read 7 bits a byte, lowest first."""
        value, shift = 0, 0
        while True:
            (byte,) = self.take(1)
            value |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                return value

    def counted(self) -> bytes:
        """Read a number of bytes, and these."""
        return self.take(self.varint())

    @property
    def is_over(self) -> bool:
        """Whether nothing is left."""
        return self.at == len(self.data)


@dataclass
class Group:
    """A GOP record."""

    num_frames: int
    predicted: bool
    tracks: bytes = b""
    wyner_ziv: list[bytes] = field(default_factory=list)
    key: bytes = b""


@dataclass
class Frame:
    """The planes of a Wyner-Ziv frame."""

    steps: list[float | None]  # of the bands that are sent
    counts: list[int]  # planes of each band
    planes: list[Bits]


def read_stream(data: bytes) -> tuple[dict[str, object], list[Group]]:
    """Return the configuration and the groups of pictures of a stream without digests."""
    file = Bytes(data)
    assert file.take(5) == b"DV3D\2"
    records = list(_records(file))
    assert [kind for kind, _ in records] == [1] + [2] * (len(records) - 2) + [3]
    config = read_configuration(records[0][1])
    groups = [read_group(payload) for _, payload in records[1:-1]]
    end = Bytes(records[-1][1])
    assert end.varint() == sum(group.num_frames for group in groups)
    assert end.is_over or end.varint() == len(groups)
    return config, groups


def _records(file: Bytes) -> Iterator[tuple[int, bytes]]:
    while not file.is_over:
        start = file.at
        (kind,) = file.take(1)
        payload = file.counted()
        checked = file.data[start : file.at]
        assert struct.unpack("<I", file.take(4)) == (zlib.crc32(checked),)
        yield kind, payload


def read_configuration(payload: bytes) -> dict[str, object]:
    """Read form and fields."""
    values = Bytes(payload)
    assert values.take(1) in (b"\0", b"\2")
    found = _named(FIELDS, _message_pack(values))
    assert values.is_over
    return found


def _named(fields: list[tuple[str, object]], values: object) -> dict[str, object]:
    """Return fields by name, those of sections among the others."""
    given: list[object] = [] if values is None else values  # type: ignore[assignment]
    assert len(given) <= len(fields)
    assert not given or given[-1] is not None
    found: dict[str, object] = {}
    for (name, default), value in zip_longest(fields, given):
        if default and isinstance(default, list):
            found |= _named(default, value)
        else:
            found[name] = default if value is None else value
            assert found[name] is not NEEDED
            assert value is None or value != default
    return found


def _message_pack(values: Bytes) -> object:
    """Read a value of MessagePack, of those that there are in a configuration."""
    (code,) = values.take(1)
    if code < 0x80:
        return code
    if code in SINGLE:
        return SINGLE[code]
    if code == 0xCB:
        return struct.unpack(">d", values.take(8))[0]
    if code in NUMBERS:
        return int.from_bytes(values.take(NUMBERS[code]))
    if 0x90 <= code < 0xC0:
        kind, count = ("array" if code < 0xA0 else "str"), code & (15 if code < 0xA0 else 31)
    else:
        kind, size = COUNTED[code]
        count = int.from_bytes(values.take(size))
    if kind == "array":
        return [_message_pack(values) for _ in range(count)]
    return values.take(count).decode("ascii") if kind == "str" else values.take(count)


def read_group(payload: bytes) -> Group:
    """Read a GOP record, in which there are no digests."""
    values = Bytes(payload)
    head = values.varint()
    group = Group((head & 2047) >> 2, bool(head & 2))
    if head & 2048:
        for _ in range(1 + group.num_frames):
            values.varint()
    if head & 1:
        group.tracks = values.counted()
    group.wyner_ziv = [values.counted() for _ in range(group.num_frames - 1)]
    group.key = values.take(len(payload) - values.at)
    return group


def key_chains(config: dict[str, object], groups: list[Group]) -> list[list[bytes]]:
    """Return the NAL units of the key frames, without start codes, by chains."""
    chains: list[list[bytes]] = []
    num_frames = 0
    for group in groups:
        if not group.predicted:
            chains.append([])
        chains[-1].append((b"\x41" if group.predicted else b"\x65") + group.key)
        num_frames = num_frames + group.num_frames if group.predicted else 1
        assert not group.predicted or num_frames <= config["intra_period"]  # type: ignore[operator]
    return chains


def num_blocks(config: dict[str, object]) -> int:
    """Return the bits of a plane."""
    return ceil(config["width"] / 4) * ceil(config["height"] / 4)  # type: ignore[operator]


def read_frame(config: dict[str, object], payload: bytes) -> Frame:
    """Read a Wyner-Ziv payload of the buffered form."""
    steps, counts, begin = _header(config, _text(payload[:100]))
    coder, contexts = (
        RangeReader(payload[begin:]),
        defaultdict[tuple[object, ...], Context](lambda: Context(50)),
    )
    columns = ceil(config["width"] / 4)  # type: ignore[operator]
    planes, sizes = list[Bits](), [0] * num_blocks(config)
    for band, count in enumerate(counts):
        zero = 4 ** ceil(count / 2) // 3 if not config["levels"] else 2**count // 2 - 1
        bins = dict.fromkeys(
            [(y, x) for y in range(-1, len(sizes) // columns) for x in range(-1, columns)],
            zero if band else 0,
        )
        for n in range(len(sizes) if count else 0):
            y, x = divmod(n, columns)
            left, above, base = bins[y, x - 1], bins[y - 1, x], zero
            predicted = zero
            if band == 0:
                base = bins[y - 1, x - 1]
                predicted = sorted((left, above, left + above - base))[1]
            around = abs(left - base) + abs(above - base)
            difference = _read_difference(coder, contexts, (min(around, 2), min(sizes[n], 2)))
            bins[y, x] = predicted + difference
            assert 0 <= bins[y, x] < 2**count
            sizes[n] += abs(difference) if band else 0
        found = [bins[divmod(n, columns)] for n in range(len(sizes))]
        planes += [[number >> k & 1 for number in found] for k in reversed(range(count))]
    return Frame(steps, counts, planes)


def _read_difference(
    coder: "RangeReader", contexts: dict[tuple[object, ...], Context], surroundings: tuple[int, int]
) -> int:
    """Read a number with a sign."""

    def decision(*kind: object) -> int:
        context = contexts[surroundings, *kind]
        decided = coder.decision(float(context.probability()))
        context.see(decided)
        return decided

    if not decision("zero"):
        return 0
    positive, exponent = decision("sign"), 1
    while decision("exponent", min(exponent, 11)):
        exponent += 1
    size = 2 + decision("mantissa", min(exponent, 11))
    for _ in range(exponent - 1):
        size = 2 * size + coder.decision(0.5)
    return size - 1 if positive else 1 - size


def _text(data: bytes) -> str:
    return "".join(f"{byte:08b}" for byte in data)


def _header(config: dict[str, object], text: str) -> tuple[list[float | None], list[int], int]:
    """Read steps and planes of the bands, and where the header ends, in bytes."""
    levels: list[int] = config["levels"]  # type: ignore[assignment]
    if not levels:
        counts, at = _plane_counts(text, 6)
        return [2 ** (int(text[:6], 2) / 6)] * 16, counts, ceil(at / 8) + bool(config["limited"])
    at, steps = 0, list[float | None]([None] * 16)
    counts = [level.bit_length() - 1 if level else 0 for level in levels]
    for band, count in enumerate(counts):
        if count and band:
            steps[band], at = 2 ** (int(text[at : at + 6], 2) / 6), at + 6
    return steps, counts, ceil(at / 8)


def _plane_counts(text: str, at: int) -> tuple[list[int], int]:
    """Read how many planes the bands have; return where that ends, too."""
    counts = [int(text[at : at + 4], 2)]
    at += 4
    for _ in range(15):
        zeros = text.index("1", at) - at
        at += zeros + 1
        counts.append(counts[-1] + (-(zeros + 1) // 2 if zeros % 2 else zeros // 2))
    return counts, at


def keys(seed: int, count: int) -> list[int]:
    """Return pseudo-random numbers of 64 bits."""
    found = []
    for i in range(1, count + 1):
        z = (i * 0x9E3779B97F4A7C15 + seed * 0xD1B54A32D192ED03 + 0x9E3779B97F4A7C15) & MASK
        z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9 & MASK
        z = (z ^ z >> 27) * 0x94D049BB133111EB & MASK
        found.append(z ^ z >> 31)
    return found


def permutation(seed: int, count: int) -> list[int]:
    """Return the places of keys in increasing order."""
    found = keys(seed, count)
    return sorted(range(count), key=found.__getitem__)


def check_bits(bits: Bits) -> Bits:
    """Return the CRC of 16 bits."""
    register = 0
    for bit in bits:
        register = (register << 1) ^ (0x11021 if (register >> 15 & 1) ^ bit else 0)
    return [register >> 15 - k & 1 for k in range(16)]


def cascade_parities(bits: Bits, seed: int, order: int) -> Bits:
    """Return the parities of all bits up to each position of an order."""
    found, parity = [], 0
    for place in permutation((seed + 1) * 256 + order, len(bits)):
        parity ^= bits[place]
        found.append(parity)
    return found


def turbo_parities(bits: Bits, seed: int) -> Bits:
    """Return the parity bits of both codes in order of release."""
    codes = []
    for places in (range(len(bits)), permutation(2 * seed + 2, len(bits))):
        register, parity = [0, 0, 0, 0], []  # w(-1) to w(-4)
        for place in places:
            w = bits[place] ^ register[2] ^ register[3]
            parity.append(w ^ register[0] ^ register[2] ^ register[3])
            register = [w, *register[:3]]
        codes.append(parity)
    offsets = [int(f"{number:06b}"[::-1], 2) for number in range(64)]
    released = [code[offset::48] for offset in offsets if offset < 48 for code in codes]
    return [bit for some in released for bit in some][: len(bits)]


def transform(block: list[list[int]]) -> list[float]:
    """Return the coefficients of a 4x4 block in zigzag order."""
    core = (1, 1, 1, 1), (2, 1, -1, -2), (1, -1, -1, 1), (1, -2, 2, -1)
    norms = 4**0.5, 10**0.5, 4**0.5, 10**0.5
    found = [
        sum(core[i][y] * core[j][x] * block[y][x] for y in range(4) for x in range(4)) / (norms[i] * norms[j])
        for i in range(4)
        for j in range(4)
    ]
    return [found[place] for place in ZIGZAG]


def interval(config: dict[str, object], frame: Frame, band: int, number: int) -> tuple[float, float]:
    """Return the borders of a bin."""
    step, count = frame.steps[band], frame.counts[band]
    if not config["levels"]:
        assert step is not None
        origin = 4 ** ceil(count / 2) / 3 if band else 0.0
        return (number - origin) * step, (number + 1 - origin) * step
    levels = 1 << count
    if band == 0:
        return 1024 * number / levels, 1024 * (number + 1) / levels
    assert step is not None
    borders = [k * step for k in range(-levels // 2, levels // 2 + 1) if k]
    return borders[min(number, levels - 1)], borders[min(number + 1, levels - 1)]


class RangeReader:
    """Reads decisions and numbers."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 8
        self._above = int.from_bytes(data[:8].ljust(8, b"\0"))
        self._size = MASK

    def decision(self, probability: float) -> int:
        """Read a decision."""
        zeros = int((1.0 - probability) * (2**24 - 2)) + 1
        one = self._above // (self._size >> 24) >= zeros
        self._take(*((zeros, 2**24 - zeros) if one else (0, zeros)))
        return int(one)

    def number(self, bound: int) -> int:
        """Read a number."""
        if bound == 1:
            return 0
        width = 2**24 // bound
        value = min(self._above // (self._size >> 24) // width, bound - 1)
        self._take(value * width, width if value < bound - 1 else 2**24 - value * width)
        return value

    def _take(self, first: int, count: int) -> None:
        part = self._size >> 24
        self._above, self._size = self._above - part * first, part * count
        if self._size < 2**32:
            word = self._data[self._at : self._at + 4].ljust(4, b"\0")
            self._above, self._size = (self._above << 32) + int.from_bytes(word), self._size << 32
            self._at += 4


def sides(config: dict[str, object]) -> tuple[int, int]:
    """Return how many positions points may have, across and down."""
    across, down = ((config[side] - 1) * 2 ** config["subpixel_bits"] + 1 for side in ("width", "height"))  # type: ignore[operator]
    return across, down


def read_points(config: dict[str, object], data: bytes, num_frames: int) -> list[list[tuple[int, int]]]:
    """Read the points of the Wyner-Ziv frames of a group, in positions."""
    if not data:
        return [[] for _ in range(num_frames)]
    coder, found = RangeReader(data), []
    exponent, apart = coder.number(8), coder.number(256)
    columns, rows = ((side - 1 >> exponent) + 1 for side in sides(config))
    for _ in range(num_frames):
        count = coder.number(config["num_points"] + 1)  # type: ignore[operator]
        points = read_point_set(coder, count, columns, rows, apart)
        found.append([(x << exponent, y << exponent) for x, y in points])
    return found


def read_point_set(
    coder: RangeReader, count: int, columns: int, rows: int, apart: int
) -> list[tuple[int, int]]:
    """Read points of a grid in column scan."""
    column, places = 0, list[int]()
    for k in range(count):
        while column < columns - 1:
            right = columns - 1 - column
            if not coder.decision(right / (right + count - k)):
                break
            column += 1
        places.append(column)
    points: list[tuple[int, int]] = []
    for x in places:
        free = [
            y
            for y in range(rows)
            if all((x - px) ** 2 + (y - py) ** 2 >= apart**2 and (px < x or y >= py) for px, py in points)
        ]
        points.append((x, free[coder.number(len(free))]))
    return points
