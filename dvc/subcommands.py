"""Commands that are made of subcommands."""

import argparse
from collections.abc import Callable, Mapping, Sequence
from types import ModuleType
from typing import Any, NamedTuple

from dvc import cli


class Subcommand(NamedTuple):
    """Help, options and action of a subcommand."""

    summary: str  # line in the help of the command
    description: str  # first lines of its own help
    add_options: Callable[[argparse.ArgumentParser], None]  # adds its options to a parser
    run: Callable[[argparse.Namespace], int]  # returns the exit status
    examples: str = ""  # last lines of its own help


def by_name(modules: Sequence[ModuleType]) -> dict[str, Subcommand]:
    """Return the subcommands that modules define, by name."""
    names = [module.__name__.rpartition(".")[2].replace("_", "-") for module in modules]
    return {
        name: Subcommand(module.SUMMARY, module.DESCRIPTION, module.add_options, module.run, module.EXAMPLES)
        for name, module in zip(names, modules, strict=True)
    }


def command(
    prog: str,
    description: str,
    examples: str,
    subcommands: Mapping[str, Subcommand],
    extra: str | None = None,
) -> Callable[..., int]:
    """Return the `main` of a command with subcommands; see `dvc.cli.command`."""

    def _parser() -> argparse.ArgumentParser:
        parser = cli.ArgumentParser(prog, description, examples)
        names = f"{{{','.join(subcommands)}}}"
        parsers = parser.add_subparsers(dest="command", required=True, metavar=names)
        for name, one in subcommands.items():
            text: dict[str, Any] = {"description": one.description, "examples": one.examples}
            one.add_options(parsers.add_parser(name, prog=f"{prog} {name}", help=one.summary, **text))
        return parser

    def _work(arguments: argparse.Namespace) -> int:
        return subcommands[arguments.command].run(arguments)

    return cli.command(prog, _parser, _work, has_subcommands=True, extra=extra)
