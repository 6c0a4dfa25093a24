"""The `simgen` command."""

from __future__ import annotations

import click
from evalkit.command import Commands


@click.group(cls=Commands)
@click.version_option(package_name="binpose-simgen")
def cli() -> None:
    """From a CAD mesh to labelled bin-picking depth images."""


def main() -> None:
    """Entry point of the `simgen` command."""
    cli()
