"""Small changes of a source: drawn from operators, or named ones that tests must notice."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

OPERATORS = {
    "constant": "a number above a thousandth is doubled or halved, a truth negated, `and` is `or`",
    "comparison": "`<` is `>=`, `==` is `!=`, and so on",
    "sign": "`+` is `-`, and a minus before a value is dropped",
    "off by one": "an integer is one more, `<` is `<=`, `>` is `>=`, and back",
}
_SYMBOLS: dict[type[ast.AST], str] = {
    ast.Lt: "<",
    ast.LtE: "<=",
    ast.Gt: ">",
    ast.GtE: ">=",
    ast.Eq: "==",
    ast.NotEq: "!=",
    ast.Add: "+",
    ast.Sub: "-",
    ast.And: "and",
    ast.Or: "or",
}
_OPPOSITE = {"<": ">=", ">=": "<", ">": "<=", "<=": ">", "==": "!=", "!=": "=="}
_BORDER = {"<": "<=", "<=": "<", ">": ">=", ">=": ">"}
_OTHER = {"+": "-", "-": "+"}
_LEAST = 1e-3
"""Smallest constant that is changed: smaller ones guard divisions or end iterations."""


class Change(NamedTuple):
    """A position in a source, its text and the replacement."""

    operator: str
    path: str
    line: int
    column: int  # in bytes, as those of `ast` are
    before: str
    after: str

    def applied(self, source: bytes) -> bytes:
        """Return the source with the change."""
        lines = source.splitlines(keepends=True)
        line = lines[self.line - 1]
        end = self.column + len(self.before)
        assert line[self.column : end] == self.before.encode()
        lines[self.line - 1] = line[: self.column] + self.after.encode() + line[end:]
        return b"".join(lines)


def changes(path: str, source: bytes) -> Iterator[Change]:
    """List possible changes of a source, except in messages, types and decorators."""
    lines = source.splitlines()
    for node in _computing(ast.parse(source)):
        for operator, line, column, before, after in _of_node(node, lines):
            yield Change(operator, path, line, column, before, after)


def _computing(node: ast.AST) -> Iterator[ast.AST]:
    """Walk through nodes that compute."""
    if isinstance(node, ast.Raise | ast.JoinedStr | ast.Assert):
        return
    if isinstance(node, ast.keyword) and node.arg == "strict":
        return
    yield node
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield from _computing(child)


_Found = tuple[str, int, int, str, str]


def _is_no_number(node: ast.expr) -> bool:
    return isinstance(node, ast.JoinedStr | ast.List | ast.Tuple) or isinstance(
        getattr(node, "value", 0), str
    )


def _of_node(node: ast.AST, lines: list[bytes]) -> Iterator[_Found]:
    match node:
        case ast.Constant():
            yield from _of_constant(node)
        case ast.UnaryOp(op=ast.USub()):
            yield "sign", node.lineno, node.col_offset, "-", ""
        case ast.Compare(ops=[sign], comparators=[right]):
            for line, column, symbol in _between(node.left, sign, right, lines):
                if symbol in _OPPOSITE:
                    yield "comparison", line, column, symbol, _OPPOSITE[symbol]
                if symbol in _BORDER:
                    yield "off by one", line, column, symbol, _BORDER[symbol]
        case ast.BinOp() if not any(map(_is_no_number, (node.left, node.right))):
            for line, column, symbol in _between(node.left, node.op, node.right, lines):
                if symbol in _OTHER:
                    yield "sign", line, column, symbol, _OTHER[symbol]
        case ast.BoolOp(values=[left, right]):
            for line, column, symbol in _between(left, node.op, right, lines):
                yield "constant", line, column, symbol, "or" if symbol == "and" else "and"


def _of_constant(node: ast.Constant) -> Iterator[_Found]:
    value, text = node.value, repr(node.value)
    if node.end_col_offset is None or node.lineno != node.end_lineno:
        return
    if isinstance(value, bool):
        yield "constant", node.lineno, node.col_offset, text, repr(not value)
    elif isinstance(value, int | float) and node.end_col_offset - node.col_offset == len(text):
        if isinstance(value, int):
            yield "off by one", node.lineno, node.col_offset, text, repr(value + 1)
        if value >= (_LEAST if isinstance(value, float) else 3):
            yield "constant", node.lineno, node.col_offset, text, repr(2 * value)
            if isinstance(value, float):
                yield "constant", node.lineno, node.col_offset, text, repr(value / 2)


def _between(
    left: ast.expr, sign: ast.AST, right: ast.expr, lines: list[bytes]
) -> Iterator[tuple[int, int, str]]:
    """Find the sign between two operands of one line."""
    symbol, end = _SYMBOLS.get(type(sign), ""), left.end_col_offset
    if symbol and end is not None and left.end_lineno == right.lineno:
        place = lines[right.lineno - 1].find(symbol.encode(), end, right.col_offset)
        if place >= 0:
            yield right.lineno, place, symbol


class Named(NamedTuple):
    """A change by its source line."""

    package: str
    line: str  # the beginning of one line of the package, without indent
    before: str  # in that line
    after: str


NAMED = (
    Named("encoder", "return error * frames[0].size >", "ALONE_COST", "2.0 * ALONE_COST"),
    Named("encoder", "return error * frames[0].size >", "SHORT_COST", "0.5 * SHORT_COST"),
    Named("encoder", "NUM_NEAREST, NEAR_PX2 =", "16.0", "64.0"),
    Named("dvc/config", "LAMBDA_PER_KEY_LAMBDA =", "6.0", "9.0"),
    Named("dvc/wynerziv", "LAMBDA_PER_SQUARED_STEP =", "0.1", "0.2"),
    Named("dvc/slepian_wolf", "SWEEPS, LAST_SWEEPS =", "4", "2"),
    Named("dvc/slepian_wolf", "CHANGE =", "0.02", "0.1"),
    Named(
        "dvc/wynerziv", "return MIN_SCALE + 0.3 * band + 0.5 * neighbourhood", " + 0.5 * neighbourhood", ""
    ),
    Named(
        "dvc/wynerziv",
        "shape = scale * np.sqrt(np.sqrt(texture",
        "np.sqrt(np.sqrt(texture",
        "np.sqrt((texture",
    ),
    Named("sfm", "TUKEY_TUNING =", "5.5", "11.0"),
    Named("sfm", "JERK_PX =", "1.0", "4.0"),
    Named("sfm", "MIN_SHARE_AHEAD =", "0.8", "0.5"),
)
"""Constants and terms of rates and cameras."""


def named_change(named: Named, root: Path) -> Change:
    """Find the position of a named change."""
    found = []
    for path in sorted((root / named.package).rglob("*.py")):
        for number, line in enumerate(path.read_bytes().splitlines(), 1):
            if re.match(rb"\s*" + re.escape(named.line.encode()), line):
                found.append((path.relative_to(root).as_posix(), number, line.find(named.before.encode())))
    if len(found) != 1 or found[0][2] < 0:
        raise LookupError(f"{named.line!r} begins {len(found)} lines of {named.package}: see {__name__}")
    return Change("named", *found[0], named.before, named.after)
