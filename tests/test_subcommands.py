"""Commands made of subcommands: help, options in any order, dispatch."""

import argparse
from types import ModuleType

import pytest

from dvc import subcommands


def _module() -> ModuleType:
    def _add(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("paths", nargs="+", metavar="FILE", help="any file")
        parser.add_argument("--lattice", nargs="+")

    module = ModuleType("package.merge")
    vars(module).update(
        SUMMARY="merge files",
        DESCRIPTION="Merge any files.",
        EXAMPLES="  tool merge a b\n",
        add_options=_add,
        run=lambda arguments: len(arguments.paths),
    )
    return module


def test_modules_are_subcommands(capsys: pytest.CaptureFixture[str]) -> None:
    main = subcommands.command("tool", "A tool.", "  tool merge x\n", subcommands.by_name([_module()]))
    assert main(["merge", "a", "b", "c"]) == 3
    assert main(["merge", "a", "--lattice", "-1,0", "0,0"]) == 1
    for arguments, text in ((["--help"], "merge files"), (["merge", "--help"], "Merge any files.")):
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        assert ended.value.code == 0
        shown = capsys.readouterr().out
        assert text in shown
        assert "examples:" in shown


@pytest.mark.parametrize("arguments", [[], ["split"], ["merge"]])
def test_wrong_use_is_one_line(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    """No subcommand, one that does not exist, or one without a required argument: status 2."""
    main = subcommands.command("tool", "A tool.", "", subcommands.by_name([_module()]))
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
