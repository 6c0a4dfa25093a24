"""Which distribution `import pybullet` comes from: PyBullet itself, or the fork that has wheels where it has none."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterator
from functools import cache
from importlib.metadata import Distribution, PackageNotFoundError, PackagePath, distribution
from importlib.util import find_spec
from pathlib import Path

BULLET_DISTRIBUTIONS = ("pybullet", "pybullet-arm64")  # both install the module `pybullet`; their poses are the same


@cache
def bullet_version() -> dict[str, str]:
    """Name and version of the distribution whose code `import pybullet` runs; nothing where there is none.

    Nothing is imported: rendering asks too, which needs no physics. Where both are installed into one place, the later
    has overwritten the earlier's files, so that the hash in the distribution's own record decides.
    """
    spec = find_spec("pybullet")
    if spec is None or spec.origin is None:
        return {}
    module = Path(spec.origin).resolve()
    claims = [(name, found, file) for name, found in _installed() if (file := _entry(found, module)) is not None]
    if len(claims) > 1:
        digest = _sha256(module)
        claims = [claim for claim in claims if claim[2].hash is not None and claim[2].hash.value == digest]
    return {name: found.version for name, found, _ in claims[:1]}


def _installed() -> Iterator[tuple[str, Distribution]]:
    for name in BULLET_DISTRIBUTIONS:
        try:
            yield name, distribution(name)
        except PackageNotFoundError:
            continue


def _entry(found: Distribution, module: Path) -> PackagePath | None:
    """The module in the distribution's list of its files."""
    named = (file for file in found.files or () if file.name == module.name)
    return next((file for file in named if Path(str(file.locate())).resolve() == module), None)


def _sha256(path: Path) -> str:
    """As wheels record it."""
    digest = hashlib.sha256(path.read_bytes()).digest()
    return base64.urlsafe_b64encode(digest).rstrip(b"=").decode()
