"""What a model file says of its training."""

from __future__ import annotations

from typing import Any

from evalkit.datasets.shard_folder import ShardDataset
from evalkit.scoring.rules import at_least
from posenet.runs.provenance import data_hash, git_version, software_versions
from posenet.training.data_statistics import data_statistics
from posenet.training.fit_options import FitOptions
from posenet.training.validation import SHARE


def training_record(
    options: FitOptions, dataset: ShardDataset, validation_images: int, ap: float | None, **position: float
) -> dict[str, Any]:
    """The record of a model that was trained on `dataset` up to `position` (step, images, minutes).

    `ap` is that of its last validation, None before the first.
    """
    return {
        "preset": options.config.preset,
        "seed": options.seed,
        "step": position["step"],
        "images": position["images"],
        "minutes": round(position["minutes"], 2),
        "validation_ap": ap,
        "validation_images": validation_images,
        "protocol": f"Sym, Siléane protocol, {at_least(0.5, SHARE)}, scenes held out of the training shards",
        "data_sha256": data_hash(dataset),
        "data": data_statistics(dataset),
        "command": options.command,
        "git": git_version(),
        "software": software_versions(),
    }
