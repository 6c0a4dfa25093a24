"""Every sentence that refuses a user's input, out of the sources: ``error_catalogue.py OUT.md``.

The sentences are the arguments of ``InputError(...)`` and ``click.UsageError(...)``; what is filled in while the
program runs stands as a name in angle brackets. The part behind the last semicolon says what to do.
"""

from __future__ import annotations

import ast
import html
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("evalkit", "simgen", "posenet")
RAISED = ("InputError", "click.UsageError", "MeshFileError")
NO_NAMES = {"join", "str", "map", "sorted", "len", "repr", "list"}  # what formats a value, not what it is
NO_MEND = "put right what it names"
HEAD = """# Every error sentence

What the commands refuse, and what to do then: all sentences of the three packages, read from their sources when this
page was built. The commands print one such sentence after `Error:` and exit with code 2; nothing is written, or what
was written before is kept. In Python the same sentence is the message of `evalkit.errors.InputError`, a `ValueError`.

*Slanted* words are filled in when it happens: a file, a number, a name. Search this page for the words around them.

Trouble with the file system (no permission, no space, a missing file) is said in the same way. What is not said in one
sentence, but as a traceback, is a fault of ours: please report it.
"""


@dataclass(frozen=True)
class Sentence:
    """One sentence template: `file` relative to the package, `text` with ``<name>`` where something is filled in."""

    package: str
    file: str
    line: int
    text: str

    @property
    def room(self) -> str:
        """The folder of the package that it stands in; empty for the package itself."""
        return self.file.rpartition("/")[0].partition("/")[0]

    @property
    def parts(self) -> tuple[str, str]:
        """What is wrong, and what to do about it (empty where the sentence does not part them by a semicolon)."""
        wrong, _, mend = self.text.rpartition("; ")
        return (wrong, mend) if wrong else (mend, "")


def sentences() -> Iterator[Sentence]:
    """Every sentence in the sources, in the order of packages, files and lines."""
    for package in PACKAGES:
        source = ROOT / "packages" / package / "src" / package
        for path in sorted(source.rglob("*.py")):
            for node in sorted(raises(path), key=lambda call: call.lineno):
                for text in filter(_says_something, templates(node.args[0])):
                    yield Sentence(package, path.relative_to(source).as_posix(), node.lineno, text)


def raises(path: Path) -> Iterator[ast.Call]:
    """The calls in a file that make an error for the user."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and node.args and ast.unparse(node.func) in RAISED:
            yield node


def templates(node: ast.expr) -> Iterator[str]:
    """The sentences that an expression may come to; none where it only hands on somebody else's."""
    match node:
        case ast.Constant(value=str(text)):
            yield text
        case ast.JoinedStr():
            yield "".join(map(_filled_in, node.values))
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            for first in templates(left):
                yield from (first + second for second in templates(right))
        case ast.IfExp(body=body, orelse=orelse):
            yield from templates(body)
            yield from templates(orelse)


def _says_something(text: str) -> bool:
    """Whether a template has words of its own, and does not only hand on what is filled in."""
    return bool(re.search(r"[a-z]{2}", re.sub(r"<[^>]*>", "", text)))


def _filled_in(part: ast.expr) -> str:
    """A piece of a sentence; of what is filled in, a name: the first word of the expression that gives it."""
    expression = part.value if isinstance(part, ast.FormattedValue) else part
    if isinstance(expression, ast.Constant):
        return str(expression.value)
    words = (getattr(node, "attr", None) or getattr(node, "id", None) for node in ast.walk(expression))
    names = [word.lower().strip("_") for word in words if word and word not in NO_NAMES]
    return f"<{names[0] if names else '…'}>"


def _html(text: str) -> str:
    """A template as HTML inside a table: what is filled in is slanted."""
    escaped = html.escape(text, quote=False).replace("|", "&#124;").replace("*", "&#42;").replace("`", "&#96;")
    slanted = re.sub(r"&lt;([\w …]+)&gt;", lambda match: f"<em>{match[1].replace('_', ' ')}</em>", escaped)
    return " ".join(slanted.split())


def room_of(package: str, room: str) -> str:
    """What lives in a folder of a package: the first line of its docstring."""
    source = ROOT / "packages" / package / "src" / package / room / "__init__.py"
    return (ast.get_docstring(ast.parse(source.read_text(encoding="utf-8"))) or "").partition("\n")[0]


def page() -> str:
    """The catalogue in Markdown."""
    found = list(sentences())
    lines = [HEAD]
    for package in PACKAGES:
        lines += [f"\n## {package}\n"]
        mine = [sentence for sentence in found if sentence.package == package]
        for room in sorted({sentence.room for sentence in mine}):
            lines += [f"\n### {package}/{room}".rstrip("/"), f"\n{room_of(package, room)}\n"]
            lines += ["| what is wrong | what to do | said by |", "|---|---|---|"]
            rows = {sentence.text: sentence for sentence in mine if sentence.room == room}
            for sentence in rows.values():
                wrong, mend = map(_html, sentence.parts)
                lines.append(f"| {wrong} | {mend or NO_MEND} | `{sentence.file.removeprefix(room + '/')}` |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(), encoding="utf-8")
