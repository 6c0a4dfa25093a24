"""However many instances an image shows, all of them are looked at, and memory does not grow with their number."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from evalkit.datasets.shard_folder import ShardDataset
from posenet.detectors.base import DetectionLimits
from posenet.detectors.heatmap import HeatmapDetector, HeatmapOutputs
from posenet.detectors.limits import greatest_density
from posenet.models.model_file import load_model
from posenet.network import pose_network
from posenet.network.depth_input import intrinsics_of

LIMITS = DetectionLimits(min_score=0.1, nms_iou=0.65, least=64, density=1 / 2000)


def crowd(height: int, width: int, side: int) -> HeatmapOutputs:
    """A heatmap at stride 8 that shows one instance of `side` pixels beside the other, each in several cells."""
    rows, columns = height // 8, width // 8
    logits = torch.full((1, rows, columns), -9.0)
    boxes = torch.zeros(1, rows, columns, 4)
    for y in range(side // 2, height - side // 2 + 1, side):
        for x in range(side // 2, width - side // 2 + 1, side):
            for row, column in ((y // 8, x // 8), (y // 8 + 1, x // 8), (y // 8, x // 8 + 1)):
                logits[0, row, column] = 3.0
                boxes[0, row, column] = torch.tensor([x, y, x, y]) + torch.tensor([-1, -1, 1, 1]) * side / 2
    return HeatmapOutputs(logits, boxes, (height, width))


@pytest.mark.parametrize(("height", "width"), [(240, 320), (1200, 1920)])
def test_a_bin_full_of_small_parts_is_detected_whole(height: int, width: int) -> None:
    side = 48
    (found,) = HeatmapDetector(64, 8, object_size=side, limits=LIMITS).detect(crowd(height, width, side))
    assert len(found.scores) == (height // side) * (width // side)


def test_a_small_image_may_hold_no_fewer_than_before_and_a_large_one_more() -> None:
    assert LIMITS.most((240, 320)) == 64
    assert LIMITS.most((1200, 1920)) == 1152


def test_thin_objects_may_lie_more_densely_than_round_ones(run_folder: Path) -> None:
    import dataclasses

    model = load_model(run_folder).network.model
    assert model.vertices is not None
    thin = dataclasses.replace(model, vertices=model.vertices * [1.0, 0.1, 0.1])
    assert greatest_density(thin, 60.0) > 3 * greatest_density(model, 60.0)
    assert greatest_density(model, 120.0) == pytest.approx(greatest_density(model, 60.0) / 4)


def test_regions_read_in_portions_say_what_they_say_at_once(
    run_folder: Path, debug_shards: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    network = load_model(run_folder).network
    dataset = ShardDataset(debug_shards)
    depth = torch.stack([torch.from_numpy(dataset[i].depth) for i in range(2)])
    intrinsics = intrinsics_of(dataset.header.camera).expand(2, 4)
    with torch.no_grad():
        images = network.encode(depth, intrinsics)
        whole = network.propose(images)
        monkeypatch.setattr(pose_network, "REGIONS_AT_ONCE", 2)
        parts = network.propose(images)
    for a, b in zip(whole, parts, strict=True):
        assert len(a.detections.scores) > 2
        assert torch.equal(a.hypotheses.detection, b.hypotheses.detection)
        torch.testing.assert_close(a.hypotheses.center, b.hypotheses.center, atol=1e-4, rtol=1e-3)
        assert int(a.hypotheses.detection.max()) < len(a.detections.scores)
