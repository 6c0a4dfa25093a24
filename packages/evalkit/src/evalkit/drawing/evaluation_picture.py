"""One picture of an evaluation: some images with what was found, false and missed, beside the curve and its rules."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.patches import Patch
from numpy.typing import NDArray

from evalkit.datasets.documents import GroundTruth, GroundTruthImage, PredictionImage, Predictions
from evalkit.datasets.scene import View
from evalkit.datasets.shard_folder import ShardDataset
from evalkit.drawing.overlays import BLUE, GRAY, GREEN, RED, WHITE, Color, draw_poses
from evalkit.drawing.plots import INK, new_figure, save
from evalkit.drawing.precision_recall_plot import draw_precision_recall
from evalkit.errors import InputError
from evalkit.objects.model import ObjectModel
from evalkit.scoring.evaluation import average_precision
from evalkit.scoring.matching import DUPLICATE, FALSE, IGNORED, TRUE
from evalkit.scoring.result import ImageOutcome, Result

Image = NDArray[np.uint8]
Array = NDArray[np.float64]
OUTCOME_COLORS = ((IGNORED, GRAY), (FALSE, RED), (DUPLICATE, RED), (TRUE, GREEN))  # later ones are drawn on top
LEGEND = (("ground truth, found", WHITE), ("missed", BLUE), ("true", GREEN), ("false", RED), ("ignored", GRAY))
SHORTEST_SIDE = 480  # pixels; smaller depth images are enlarged
SAME_PLACE = 0.01  # diameters; instances of one image are stored exactly
WORDS_WIDTH = 68  # characters beside the images


@dataclass(frozen=True, eq=False)
class Confident:
    """The hypotheses with at least the score of the best F1, evaluated: those that a robot would act on."""

    predictions: Predictions
    truth: GroundTruth
    result: Result
    score: float

    @classmethod
    def cut(cls, predictions: Predictions, truth: GroundTruth, result: Result) -> Confident:
        score = float(result.curve.score[int(result.curve.f1.argmax())])
        kept = replace(predictions, images=[_at_least(image, score) for image in predictions.images])
        return cls(kept, truth, average_precision(kept, truth, **vars(result.settings)), score)

    @cached_property
    def truths(self) -> dict[str, GroundTruthImage]:
        return {image.id: image for image in self.truth.images}

    @cached_property
    def hypotheses(self) -> dict[str, PredictionImage]:
        return {image.id: image for image in self.predictions.images}

    @cached_property
    def outcomes(self) -> dict[str, ImageOutcome]:
        return {outcome.id: outcome for outcome in self.result.images()}

    def draw(self, view: View, model: ObjectModel, name: str) -> Image:
        """One image with its outcome.

        Raises:
            InputError: the view is another image, which has the same name in another dataset.
        """
        labeled, there = (model.centers(image.cam_from_obj) for image in (self.truths[name], view.instances))
        apart = np.linalg.norm(labeled[:, None] - there[None], axis=2).min(1, initial=np.inf)
        if (apart > SAME_PLACE * model.diameter).any():
            raise InputError(
                f"the shards' image '{name}' shows other instances than {self.truth.source} has there; give the shards "
                "that the ground truth is of."
            )
        return draw_outcome(view, model, self.truths[name], self.hypotheses.get(name), self.outcomes[name])


def save_picture(
    path: Path | str,
    predictions: Predictions,
    truth: GroundTruth,
    shards: Path | str | Sequence[Path | str],
    image_ids: Sequence[str] = (),
    count: int = 4,
    **rules: Any,
) -> Result:
    """Draw `count` images (or those named) with outlines over their depth, and the precision-recall curve.

    Args:
        rules: as :func:`evalkit.scoring.evaluation.average_precision` takes them.

    Raises:
        InputError: the documents do not belong together, or the shards lack an image.
    """
    result = average_precision(predictions, truth, **rules)
    confident = Confident.cut(predictions, truth, result)
    dataset = ShardDataset(shards)
    frames = frames_by_id(dataset)
    chosen = list(image_ids) or spread([name for name in result.image_ids if name in frames], count)
    unknown = next((name for name in chosen if name not in frames or name not in result.image_ids), None)
    if unknown is not None or not chosen:
        raise InputError(
            f"{shards}: image '{unknown or result.image_ids[0]}' must be both there and in {truth.source}."
        )
    model = with_mesh_of(dataset, truth.object)
    panels = [confident.draw(dataset[frames[name]], model, name) for name in chosen]
    _compose(path, dict(zip(chosen, panels, strict=True)), confident, result)
    return result


def draw_outcome(
    view: View, model: ObjectModel, truth: GroundTruthImage, hypotheses: PredictionImage | None, outcome: ImageOutcome
) -> Image:
    """One image's depth with its ground truth (found white, missed blue) and its hypotheses (true, false, ignored)."""
    scale = max(1, -(-SHORTEST_SIDE // min(view.camera.width, view.camera.height)))
    found = ~outcome.missed & ~outcome.ignored
    picture = draw_poses(view.depth, view.camera, model, truth.cam_from_obj[found], WHITE, scale)
    layers: list[tuple[Array, Color]] = [(truth.cam_from_obj[outcome.missed], BLUE)]
    if hypotheses is not None:
        layers += [(hypotheses.cam_from_obj[outcome.outcome == kind], color) for kind, color in OUTCOME_COLORS]
    for pose, color in layers:
        picture = draw_poses(view.depth, view.camera, model, pose, color, scale, thickness=2, canvas=picture)
    return picture


def frames_by_id(dataset: ShardDataset) -> dict[str, int]:
    """Which frame of the dataset is the image of that id."""
    readers = [dataset.reader(shard) for shard in range(len(dataset.paths))]
    names = [reader.image_id(frame) for reader in readers for frame in range(len(reader))]
    return {name: index for index, name in enumerate(names)}


def with_mesh_of(dataset: ShardDataset, model: ObjectModel) -> ObjectModel:
    """The object of a gt.json with the mesh that only the shards hold."""
    return replace(model, vertices=dataset.header.object.vertices, faces=dataset.header.object.faces)


def spread(names: list[str], count: int) -> list[str]:
    """`count` names from all over the list, in order."""
    rows = np.linspace(0, len(names) - 1, min(count, len(names))).round().astype(int)
    return [names[row] for row in rows]


def _compose(path: Path | str, panels: dict[str, Image], confident: Confident, result: Result) -> None:
    figure = new_figure(15.0, 7.6)
    left, right = figure.subfigures(1, 2, width_ratios=[1.75, 1.0], squeeze=False)[0]
    columns = int(np.ceil(np.sqrt(len(panels))))
    grid = left.subplots(int(np.ceil(len(panels) / columns)), columns, squeeze=False)
    for axes in grid.flat:
        axes.axis("off")
    for axes, (name, picture) in zip(grid.flat, panels.items(), strict=False):
        axes.imshow(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB))
        axes.set_title(name, fontsize=9, loc="left", color=INK, parse_math=False)
    handles = [
        Patch(facecolor=[c / 255 for c in color[::-1]], edgecolor=INK, linewidth=0.6, label=label)
        for label, color in LEGEND
    ]
    left.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=9)
    curve, words = right.subplots(2, 1, height_ratios=[1.0, 0.5])
    draw_precision_recall(curve, result)
    words.axis("off")
    style = {"va": "top", "fontsize": 9, "color": INK, "linespacing": 1.35, "in_layout": False, "parse_math": False}
    words.text(0, 1, _words(result, confident), **style)
    save(figure, path)


def _words(result: Result, confident: Confident) -> str:
    counts, drawn = result.counts, confident.result.counts
    paragraphs = (
        f"{result.object_title}: {counts['images']} images, {counts['instances_to_find']} of {counts['instances']} "
        f"instances to find, {counts['hypotheses']} hypotheses. Drawn are those with a score of at least "
        f"{confident.score:.3g}, where F1 is best: {drawn['true']} true, {drawn['false']} false, "
        f"{drawn['ignored']} ignored, {drawn['missed']} missed.",
        result.protocol,
    )
    return "\n\n".join(textwrap.fill(paragraph, WORDS_WIDTH) for paragraph in paragraphs)


def _at_least(image: PredictionImage, score: float) -> PredictionImage:
    kept = image.score >= score
    return replace(image, cam_from_obj=image.cam_from_obj[kept], score=image.score[kept])
