"""Every option of every command, from the parsers of the commands themselves."""

import argparse
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from textwrap import dedent
from unittest.mock import patch

from docutils import nodes
from docutils.parsers.rst import Directive
from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[2]


class _Built(Exception):
    """A parser, when it is about to read arguments."""


def parsers() -> dict[str, argparse.ArgumentParser]:
    """Return the parsers of all commands."""
    import dvc3d

    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]

    def _catch(parser: argparse.ArgumentParser, _: object = None) -> None:
        raise _Built(parser)

    found = {}
    with (
        patch.object(argparse.ArgumentParser, "parse_args", _catch),
        patch.object(argparse.ArgumentParser, "parse_intermixed_args", _catch),
    ):
        for command in sorted(scripts):
            try:
                with patch.object(sys, "argv", [command]):
                    dvc3d.main()
            except _Built as built:
                found[command] = built.args[0]
    assert dvc3d.foreign_folder() is None
    return found


def subparsers(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """Yield the parsers of subcommands."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            yield from action.choices.values()


class Commands(Directive):
    """A section of each command, and of each subcommand."""

    def run(self) -> list[nodes.Node]:
        """Write the sections."""
        return [_section(command, parser) for command, parser in parsers().items()]


def _section(name: str, parser: argparse.ArgumentParser) -> nodes.section:
    section = nodes.section(ids=[nodes.make_id(name)], names=[name])
    section += nodes.title(text=name)
    if parser.description:
        section += nodes.paragraph(text=" ".join(parser.description.split()))
    usage = parser.format_usage().removeprefix("usage: ")
    section += nodes.literal_block(text=usage.rstrip(), classes=["usage"])
    for group in parser._action_groups:
        actions = [action for action in group._group_actions if _is_shown(action)]
        if actions:
            section += nodes.rubric(text=(group.title or "").capitalize())
            section += nodes.option_list("", *(_option(parser, action) for action in actions))
    if parser.epilog:
        section += nodes.rubric(text="Examples")
        section += nodes.literal_block(text=dedent(parser.epilog.partition("\n")[2]).rstrip())
    for inner in subparsers(parser):
        section += _section(inner.prog, inner)
    return section


def _is_shown(action: argparse.Action) -> bool:
    hidden = isinstance(action, (argparse._HelpAction, argparse._SubParsersAction))
    return not hidden and action.help is not argparse.SUPPRESS


def _option(parser: argparse.ArgumentParser, action: argparse.Action) -> nodes.option_list_item:
    """Write an option or argument as the help of its command has it."""
    formatter = parser._get_formatter()
    names = formatter._format_action_invocation(action)
    text = formatter._expand_help(action) if action.help else ""
    option = nodes.option("", nodes.option_string(text=names))
    described = nodes.description("", nodes.paragraph(text=text))
    return nodes.option_list_item("", nodes.option_group("", option), described)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    app.add_directive("commands", Commands)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
