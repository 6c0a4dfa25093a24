"""What every command takes, as `--help` says it: ``python docs/scripts/command_reference.py OUT.md``."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import click

import evalkit.commands.cli
import posenet.commands.cli
import simgen.commands.cli

COMMANDS = {
    "simgen": simgen.commands.cli.cli,
    "posenet": posenet.commands.cli.main,
    "evalkit": evalkit.commands.cli.main,
}
HEAD = "# Commands\n\nWhat `--help` says of every command, read from the commands when this page was built.\n"


def helps(command: click.Command, name: str, parent: click.Context | None = None) -> Iterator[tuple[str, str]]:
    """(name, help) of a command and of all below it."""
    context = click.Context(command, info_name=name.rpartition(" ")[2], parent=parent, max_content_width=100)
    yield name, command.get_help(context)
    if isinstance(command, click.Group):
        for below in command.list_commands(context):
            found = command.get_command(context, below)
            assert found is not None
            yield from helps(found, f"{name} {below}", context)


def page() -> str:
    """The reference in Markdown."""
    lines = [HEAD]
    for name, command in COMMANDS.items():
        for title, text in helps(command, name):
            lines += [f"\n{'##' if title == name else '###'} {title}\n", "```text", text, "```"]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(), encoding="utf-8")
