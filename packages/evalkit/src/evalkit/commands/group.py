"""How the three commands meet the user: one clear sentence and exit code 2 instead of a traceback."""

from __future__ import annotations

import errno
import logging
import os
import shlex
import sys
from pathlib import Path
from typing import Any

import click

from evalkit.commands.command import Command
from evalkit.errors import InputError

EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130


class Commands(click.Group):
    """A click group whose commands report :class:`InputError` and file-system trouble in one sentence."""

    command_class = Command

    def main(self, *args: Any, **kwargs: Any) -> Any:
        show_warnings()
        try:
            return super().main(*args, **kwargs)
        except InputError as error:
            _fail(str(error))
        except OSError as error:
            _fail(describe_os_error(error))

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            click.echo("\nInterrupted; what was finished is kept, run the same command again to go on.", err=True)
            ctx.exit(EXIT_INTERRUPTED)


class _Sentences(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        word = "Warning" if record.levelno >= logging.WARNING else "Note"
        click.echo(f"{word}: {record.getMessage()}", err=True)


def show_warnings() -> None:
    """Print what the libraries that a command calls log as warnings, each as a sentence on stderr."""
    for library in ("evalkit", "simgen"):
        log = logging.getLogger(library)
        if not any(isinstance(handler, _Sentences) for handler in log.handlers):
            log.addHandler(_Sentences())


def show_notes(library: str) -> None:
    """Print what a library says of its work, too, not only its warnings."""
    logging.getLogger(library).setLevel(logging.INFO)


def suggest_next(*words: str | Path) -> None:
    """Print the command to type next, on stderr, so that what a command prints as its result can be piped on."""
    click.echo(f"Next: {shlex.join(map(str, words))}", err=True)


def describe_os_error(error: OSError) -> str:
    """One sentence for a file-system error: what happened to which file, and what to do about it."""
    name = error.filename if error.filename is not None else "a file"
    sentences = {
        errno.ENOENT: f"{name} does not exist; check the path.",
        errno.EACCES: f"{name} cannot be accessed: no permission; change its permissions or choose another place.",
        errno.EPERM: f"{name} cannot be accessed: not permitted; change its permissions or choose another place.",
        errno.EROFS: f"{name} is on a read-only file system; choose another place with -o.",
        errno.ENOSPC: f"no space left on the disk that holds {name}; free some and run the same command again.",
        errno.EISDIR: f"{name} is a folder, but a file is needed here.",
        errno.ENOTDIR: f"{name} lies below something that is not a folder; check the path.",
        errno.EDQUOT: f"the disk quota is used up for {name}; free some space and run the same command again.",
    }
    reason = os.strerror(error.errno) if error.errno else error.strerror or error  # h5py's strerror is a paragraph
    return sentences.get(error.errno or 0, f"{name}: {reason}.")


def _fail(sentence: str) -> None:
    click.echo(f"Error: {' '.join(sentence.split())}", err=True)
    sys.exit(EXIT_BAD_INPUT)
