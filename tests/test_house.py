"""How long functions are, and how many arguments kernels take."""

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = "dvc", "sfm", "sequences", "encoder", "decoder", "benchmarks"
MOST_ARGUMENTS = 8
"""Of a kernel; what belongs together is a named tuple."""
MOST_LINES = 40
"""Of a function, without its docstring."""

Function = ast.FunctionDef | ast.AsyncFunctionDef


@cache
def _functions() -> list[tuple[str, Function]]:
    found = []
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            name = str(path.relative_to(ROOT))
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, Function):
                    found.append((f"{name}:{node.lineno} {node.name}", node))
    return found


def _num_arguments(function: Function) -> int:
    found = function.args
    return len(found.posonlyargs) + len(found.args) + len(found.kwonlyargs)


def _num_lines(function: Function) -> int:
    body = function.body[ast.get_docstring(function) is not None :]
    return (body[-1].end_lineno or 0) - body[0].lineno + 1 if body else 0


def _is_kernel(function: Function) -> bool:
    names = {ast.unparse(decorator) for decorator in function.decorator_list}
    return bool(names & {"kernel", "inlined_kernel"})


def test_kernels_take_few_arguments() -> None:
    """A call with more positions is read by nobody."""
    kernels = [(place, _num_arguments(node)) for place, node in _functions() if _is_kernel(node)]
    assert len(kernels) > 100
    assert [found for found in kernels if found[1] > MOST_ARGUMENTS] == []


def test_functions_are_short() -> None:
    """What is longer does several things."""
    functions = [(place, _num_lines(node)) for place, node in _functions()]
    assert [found for found in functions if found[1] > MOST_LINES] == []
