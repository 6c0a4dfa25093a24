"""What distinguishes datasets, and in which entry two of them differ."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.datasets.shard_format import ShardHeader

TELLING = ("engine", "rules")  # entries that explain why others differ


def fingerprint(geometry: Iterable[Iterable[NDArray[Any]]]) -> str:
    """SHA-256 of the arrays: the mesh that is drawn, then the hulls that fall, or the poses where none do."""
    digest = hashlib.sha256()
    for array in (array for part in geometry for array in part):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def identity_of(header: ShardHeader) -> dict[str, Any]:
    """What all files of the header's dataset have in common."""
    return identity(header.config, header.object.to_json())


def identity(config: Any, model: Any) -> dict[str, Any]:
    """The same, from the JSON forms of config and object."""
    known = model if isinstance(model, dict) else {}
    return {"config": config, "object": {key: known.get(key) for key in ("name", "diameter", "symmetry")}}


def first_difference(theirs: Any, ours: Any, name: str = "") -> str | None:
    """The first entry in which two JSON documents differ, in words; None if there is none."""
    if isinstance(theirs, dict) and isinstance(ours, dict):
        for key in sorted({*theirs, *ours}, key=lambda key: (key not in TELLING, key)):
            found = first_difference(theirs.get(key), ours.get(key), f"{name}.{key}" if name else key)
            if found is not None:
                return found
        return None
    return None if theirs == ours else f"{name} is {theirs} there and {ours} here"
