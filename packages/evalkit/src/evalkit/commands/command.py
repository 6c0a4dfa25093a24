"""What every command refuses before it begins: a thing named twice, a number that is none, an output that is read."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import click

from evalkit.commands.output_file import OutputFile, require_apart
from evalkit.errors import InputError

MAY_BE_NAN = ("no_return",)  # images of floats mark so what did not return


class Command(click.Command):
    """A command that takes what its options say, or refuses it."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse as click does, then refuse what no command can mean.

        Raises:
            InputError: an option names two things for one, a number is not finite, or an output is also read.
        """
        if not ctx.resilient_parsing:
            self._require_once(ctx, args)
        rest = super().parse_args(ctx, args)
        if not ctx.resilient_parsing:
            self._require_finite(ctx)
            self._require_apart(ctx)
        return rest

    def _require_once(self, ctx: click.Context, args: list[str]) -> None:
        """Of two names the last would count, silently: two meshes, of which one would be simulated.

        Of two numbers it may: who appends an option to a command means the latter.
        """
        _, _, order = self.make_parser(ctx).parse_args(list(args))
        seen: set[str] = set()
        for param in order:
            if not isinstance(param, click.Option) or param.is_flag or param.multiple or param.count:
                continue
            if not isinstance(param.type, (click.Path, click.types.StringParamType)):
                continue
            if param.name in seen:
                raise InputError(f"{param.opts[-1]} is given twice; give it once.")
            seen.add(str(param.name))

    def _require_finite(self, ctx: click.Context) -> None:
        """Ranges let NaN pass, for it is neither below nor above their ends."""
        for param in self.params:
            value = ctx.params.get(str(param.name))
            if isinstance(value, float) and not math.isfinite(value) and param.name not in MAY_BE_NAN:
                raise InputError(f"{param.opts[-1]} {value}: must be a number, and finite.")

    def _require_apart(self, ctx: click.Context) -> None:
        given = [(param, ctx.params.get(str(param.name))) for param in self.params]
        written = {param.opts[-1]: path for param, path in given if isinstance(param.type, OutputFile) and path}
        read = [path for param, value in given if not isinstance(param.type, OutputFile) for path in _paths(value)]
        require_apart(written, read)


def _paths(value: Any) -> list[Path]:
    """The paths that a parameter's value may be; meshes are given as text, for they may be names as well."""
    values = value if isinstance(value, tuple) else (value,)
    return [Path(one) for one in values if isinstance(one, (Path, str)) and one and "\0" not in str(one)]
