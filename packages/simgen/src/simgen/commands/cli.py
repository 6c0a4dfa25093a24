"""The `simgen` command."""

from __future__ import annotations

import click

from evalkit.commands.group import Commands
from simgen.commands.build_commands import build_command, render_command, simulate_command
from simgen.commands.export_commands import export_command
from simgen.commands.inspect_commands import object_command, preview_command, verify_command, view_command
from simgen.commands.sensor_commands import sensor_group


@click.group(cls=Commands)
@click.version_option(package_name="binpose-simgen")
def cli() -> None:
    """From a CAD mesh to labeled bin-picking depth images."""


cli.add_command(build_command)
cli.add_command(simulate_command)
cli.add_command(render_command)
cli.add_command(export_command)
cli.add_command(object_command)
cli.add_command(preview_command)
cli.add_command(sensor_group)
cli.add_command(verify_command)
cli.add_command(view_command)


def main() -> None:
    """Entry point of the `simgen` command."""
    cli()
