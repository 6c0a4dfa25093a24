"""Ground truth out of our own shards."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from evalkit.documents import GroundTruth, GroundTruthImage
from evalkit.shards import ShardDataset, ShardReader


def read_ground_truth(source: Path | str | Sequence[Path | str]) -> GroundTruth:
    """The labels of all frames of a folder of shards, hidden instances included; pixels are not read.

    Raises:
        InputError: there is no shard, or one is missing or damaged.
    """
    dataset = ShardDataset(source)
    images = [
        image(reader, frame)
        for reader in (dataset.reader(shard) for shard in range(len(dataset.paths)))
        for frame in range(len(reader))
    ]
    return GroundTruth(dataset.header.object, images, source=str(source))


def image(reader: ShardReader, frame: int) -> GroundTruthImage:
    """The labels of one frame."""
    labels = reader.labels(frame)
    return GroundTruthImage(
        reader.image_id(frame), reader.header.camera, labels.cam_from_obj, labels.visibility.astype(float)
    )
