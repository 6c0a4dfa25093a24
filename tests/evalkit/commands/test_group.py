"""How the commands meet the user: what a library logs is read on stderr, and no library writes there itself."""

from __future__ import annotations

import ast
import logging
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from evalkit.commands.group import Commands

PACKAGES = Path(__file__).parents[3] / "packages"
MAY_WRITE = ("commands", "workers/progress.py", "workers/local.py", "physics/bullet.py")  # the last two to silence C


@pytest.mark.parametrize("logger", ["evalkit.geometry.camera", "simgen.objects.prepare"])
def test_a_librarys_warning_is_printed_once_on_stderr(logger: str) -> None:
    @click.group(cls=Commands)
    def group() -> None:
        pass

    @group.command()
    def look() -> None:
        logging.getLogger(logger).warning("%s: looks odd.", "cup.stl")

    for _ in range(2):  # the second time in the same process, as well
        done = CliRunner().invoke(group, ["look"])
        assert (done.stderr, done.stdout) == ("Warning: cup.stl: looks odd.\n", "")


@pytest.mark.parametrize("package", ["evalkit", "simgen"])
def test_library_code_logs_and_never_prints(package: str) -> None:
    root = PACKAGES / package / "src" / package
    for source in sorted(root.rglob("*.py")):
        if str(source.relative_to(root)).startswith(MAY_WRITE):
            continue
        for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
            if not isinstance(node, (ast.Call, ast.Attribute)):
                continue
            name = ast.unparse(node.func if isinstance(node, ast.Call) else node)
            wrong = isinstance(node, ast.Call) and name in ("print", "click.echo", "warnings.warn", "tqdm.write")
            wrong |= isinstance(node, ast.Attribute) and name in ("sys.stderr", "sys.stdout")
            assert not wrong, f"{source.relative_to(PACKAGES)}:{node.lineno} writes to the terminal"
