"""Ground truth out of our own shards, and the predictions that would be perfect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from evalkit.datasets.documents import GroundTruth, GroundTruthImage, PredictionImage, Predictions
from evalkit.datasets.scene import Share
from evalkit.datasets.shard_folder import ShardDataset
from evalkit.datasets.shard_format import OLD_SCHEMA
from evalkit.datasets.shard_reader import ShardReader
from evalkit.datasets.visibility_share import with_share

COUNTED = (
    f"the shards are of schema {OLD_SCHEMA}, which holds returned visibility alone; geometric visibility was counted "
    "from their instance_id, exactly."
)


def read_ground_truth(
    source: Path | str | Sequence[Path | str], object_name: str | None = None, visibility: Share | None = None
) -> GroundTruth:
    """The labels of all frames of a folder of shards, hidden instances included.

    Args:
        object_name: calls the object otherwise than the shards do.
        visibility: the share that scores go by where they are not asked for another, geometric by default; the document
            holds both.

    Raises:
        InputError: there is no shard, or one is missing or damaged, or `visibility` is no share.
    """
    dataset = ShardDataset(source)
    images = [
        image(reader, frame)
        for reader in (dataset.reader(shard) for shard in range(len(dataset.paths)))
        for frame in range(len(reader))
    ]
    model = dataset.header.object
    truth = GroundTruth(replace(model, name=object_name or model.name), images, source=str(source), share="geometric")
    truth = with_share(truth, visibility)
    counted = truth.share == "geometric" and dataset.reader(0).schema == OLD_SCHEMA
    return replace(truth, remarks=(COUNTED,)) if counted else truth


def image(reader: ShardReader, frame: int) -> GroundTruthImage:
    """The labels of one frame, by geometric visibility."""
    labels = reader.labels(frame)
    return GroundTruthImage(
        reader.image_id(frame),
        reader.header.camera,
        labels.cam_from_obj,
        labels.visibility("geometric"),
        labels.visibility("returned"),
    )


def read_predictions(source: Path | str | Sequence[Path | str], object_name: str | None = None) -> Predictions:
    """The labels themselves as hypotheses, scored by visibility: what a method without errors would say.

    Raises:
        InputError: as :func:`read_ground_truth`.
    """
    truth = read_ground_truth(source, object_name)
    images = [PredictionImage(view.id, view.cam_from_obj, view.visibility) for view in truth.images]
    return Predictions(truth.object.reference, images, source=truth.source)
