"""The files that a command computed from, as its JSON names them."""

from __future__ import annotations

from pathlib import Path

from evalkit.atomic import sha256_of_file


def described_inputs(**paths: Path) -> dict[str, dict[str, str]]:
    """Names and hashes of the files that a result was computed from."""
    return {key: {"file": path.name, "sha256": sha256_of_file(path)} for key, path in paths.items()}
