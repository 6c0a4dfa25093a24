"""Write the version that VERSION states into every file that has to state it: `make version` after editing VERSION.

Metadata that pip and other tools read without running anything is worth a few copies; a test holds them together.
"""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
PYPROJECTS = [f"packages/{name}/pyproject.toml" for name in ("evalkit", "simgen", "posenet")]
# Where a version stands: the text before it, and whatever is there now.
PATTERNS = {path: re.compile(r'(^version = "|"binpose-evalkit==)[^"]+', re.MULTILINE) for path in PYPROJECTS}
PATTERNS["CITATION.cff"] = re.compile(r'(^version: ")[^"]+', re.MULTILINE)


def stated_version() -> str:
    return (ROOT / "VERSION").read_text(encoding="utf-8").strip()


def with_version(path: str, version: str) -> str:
    """The text of a file of the repository, stating that version."""
    text, places = PATTERNS[path].subn(rf"\g<1>{version}", (ROOT / path).read_text(encoding="utf-8"))
    if not places:
        raise LookupError(f"{path} states no version")
    return text


def main() -> None:
    for path in PATTERNS:
        (ROOT / path).write_text(with_version(path, stated_version()), encoding="utf-8")


if __name__ == "__main__":
    main()
