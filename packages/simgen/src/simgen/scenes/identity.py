"""What tells datasets apart, and in which entry two differ."""

from __future__ import annotations

from typing import Any

from simgen.scenes.job import Job


def own_identity(job: Job) -> dict[str, Any]:
    """What all files of a job's dataset have in common."""
    header = job.header()
    return identity(header.config, header.object.to_json())


def identity(config: Any, model: Any) -> dict[str, Any]:
    """What tells datasets apart, from the JSON forms of config and object."""
    known = model if isinstance(model, dict) else {}
    return {"config": config, "object": {key: known.get(key) for key in ("name", "diameter", "symmetry")}}


def first_difference(theirs: Any, ours: Any, name: str = "") -> str | None:
    """The first entry in which two JSON documents differ, in words; None if there is none."""
    if isinstance(theirs, dict) and isinstance(ours, dict):
        for key in sorted({*theirs, *ours}):
            found = first_difference(theirs.get(key), ours.get(key), f"{name}.{key}" if name else key)
            if found is not None:
                return found
        return None
    return None if theirs == ours else f"{name} is {theirs} there and {ours} here"
