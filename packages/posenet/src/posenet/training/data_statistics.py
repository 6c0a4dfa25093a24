"""What the training images are like, for a model to know what it was trained for."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from evalkit.datasets.shard_folder import ShardDataset
from evalkit.depth.noise import depth_noise

FRAMES = 24  # looked at, spread over the set
SEEN = 0.2  # visibility from which an instance counts
RANGE = (2, 98)  # percentiles


@lru_cache(maxsize=2)
def data_statistics(dataset: ShardDataset) -> dict[str, Any]:
    """Distances (meters) and sizes (pixels of the stored images) of instances, noise (meters), share of holes on them.

    Of depth as it is stored; what augmentation adds is in the configuration.
    """
    model, camera = dataset.header.object, dataset.header.camera
    distances, noise, holes = [], [], []
    for number in np.unique(np.linspace(0, len(dataset) - 1, FRAMES).round().astype(int)):
        view = dataset[int(number)]
        seen = view.instances.visibility_geometric >= SEEN
        distances.append(model.centers(view.instances.cam_from_obj[seen])[:, 2])
        noise.append(depth_noise(view.depth))
        if view.instances.pixels_geometric.sum() > 0:
            holes.append(1.0 - float(view.instances.pixels_returned.sum() / view.instances.pixels_geometric.sum()))
    near, far = np.percentile(np.concatenate(distances), RANGE) if any(map(len, distances)) else (0.0, 0.0)
    pixels = [camera.fx * model.diameter / max(distance, 1e-6) for distance in (far, near)]
    return {
        "distance_m": [round(float(near), 4), round(float(far), 4)],
        "object_pixels": [round(float(size), 1) for size in pixels],
        "noise_m": round(float(np.median(noise)), 6),
        "holes": round(float(np.mean(holes)), 4) if holes else 0.0,
    }
