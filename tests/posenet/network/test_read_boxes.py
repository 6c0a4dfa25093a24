"""What the heads say about given boxes is what they say about the same boxes when the detector found them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from posenet.models.model_file import load_model
from posenet.network import hypotheses
from posenet.training.dataset import Frames


def test_the_detectors_own_boxes_give_the_predicted_poses(run_folder: Path, debug_shards: Path) -> None:
    network = load_model(run_folder).network.eval()
    batch = Frames(debug_shards).batch(np.arange(2))
    found = network.predict(batch.depth, batch.intrinsics)
    assert all(len(image.score) for image in found)
    index = torch.cat([torch.full((len(image.score),), i) for i, image in enumerate(found)])
    with torch.no_grad():
        images = network.encode(batch.depth, batch.intrinsics)
        regions = network.regions(images, torch.cat([image.box for image in found]), index)
        outputs = network.read(images, regions)
    assert regions.valid.all()
    best = hypotheses.generate(outputs, regions, network.codec, network.distance, network.config.network.hypotheses)
    for row, center in enumerate(torch.cat([image.center for image in found])):
        same = best.center[best.detection == row]
        assert (same - center).norm(dim=1).min() < 1e-4
