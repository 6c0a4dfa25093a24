"""The reference of each package, a chapter a folder: ``python docs/scripts/api_pages.py OUT_FOLDER``.

Which modules there are is read from the folders, so that a module that moves takes its place in the reference along.
What the pages name, mkdocstrings replaces by docstrings and signatures.
"""

from __future__ import annotations

import ast
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("evalkit", "simgen", "posenet")
INNER = {"commands", "drawing", "figures", "layers", "optimizers", "previews", "reports", "workers"}  # left out


def page(package: str) -> str:
    """One package's reference in Markdown."""
    source = ROOT / "packages" / package / "src" / package
    lines = [f"# {package}", "", docstring(source / "__init__.py"), ""]
    lines += [f"::: {package}.{name}\n" for name in functions(source / "__init__.py")]
    for path in sorted(source.glob("*.py")):
        lines += [] if path.stem.startswith("_") else [f"::: {package}.{path.stem}", ""]
    for folder in sorted({path.parent for path in source.rglob("*.py")} - {source}):
        name = folder.relative_to(source).as_posix()
        if name.partition("/")[0] in INNER:
            continue
        lines += [f"## {package}.{name.replace('/', '.')}", "", docstring(folder / "__init__.py"), ""]
        for path in sorted(folder.glob("*.py")):
            if not path.stem.startswith("_"):
                lines += [f"::: {package}.{name.replace('/', '.')}.{path.stem}", "    options:"]
                lines += ["      heading_level: 3", ""]
    return "\n".join(lines)


def docstring(path: Path) -> str:
    """A module's docstring, its first paragraph."""
    return (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").partition("\n\n")[0]


def functions(path: Path) -> list[str]:
    """The public functions that a module defines."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return [node.name for node in tree.body if isinstance(node, ast.FunctionDef) and not node.name.startswith("_")]


if __name__ == "__main__":
    out = Path(sys.argv[1])
    out.mkdir(parents=True, exist_ok=True)
    for name in PACKAGES:
        (out / f"{name}.md").write_text(page(name), encoding="utf-8")
