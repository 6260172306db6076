"""Commands that are made of subcommands, and what each of these says, takes and does."""

import argparse
from collections.abc import Callable, Mapping, Sequence
from types import ModuleType
from typing import Any, NamedTuple, Self

from dvc import cli


class Subcommand(NamedTuple):
    """What `--help` says of a subcommand, what it takes, and what it does.

    Attributes
    ----------
    summary : str
        Its line in the help of the command.
    description : str
        Begins its own help.
    add_options : callable
        Adds what it takes to its parser.
    run : callable
        Does it, and returns the exit status.
    examples : str, optional
        End its own help.
    """

    summary: str
    description: str
    add_options: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], int]
    examples: str = ""

    @classmethod
    def of(cls, module: ModuleType) -> Self:
        """Return the subcommand that a module is.

        Parameters
        ----------
        module : module
            With `SUMMARY`, `DESCRIPTION`, `EXAMPLES`, `add_options` and `run`.

        Returns
        -------
        Subcommand
            Made of these.
        """
        return cls(module.SUMMARY, module.DESCRIPTION, module.add_options, module.run, module.EXAMPLES)


def by_name(modules: Sequence[ModuleType]) -> dict[str, Subcommand]:
    """Return the subcommands that modules are.

    Parameters
    ----------
    modules : sequence of module
        As `Subcommand.of` takes them.

    Returns
    -------
    dict of str to Subcommand
        By the names of the modules without their packages, with dashes.
    """
    names = [module.__name__.rpartition(".")[2].replace("_", "-") for module in modules]
    return {name: Subcommand.of(module) for name, module in zip(names, modules, strict=True)}


def command(
    prog: str, description: str, examples: str, subcommands: Mapping[str, Subcommand]
) -> Callable[..., int]:
    """Make the `main` of a command that has subcommands.

    Parameters
    ----------
    prog : str
        Name shown before messages.
    description, examples : str
        Begin and end its help.
    subcommands : mapping of str to Subcommand
        By name, in the order of the help.

    Returns
    -------
    callable
        As `dvc.cli.command` returns it.
    """

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

    return cli.command(prog, _parser, _work, has_subcommands=True)
