"""Training images that end within the heap."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from posenet.augmentation.framing import SIDES, frame_size, framed
from posenet.network.targets import Batch


def batch_of(boxes: list[list[float]], images: int = 1) -> Batch:
    """Images of 40 x 60 whose depth says which pixel it was."""
    depth = torch.arange(40 * 60, dtype=torch.float32).view(1, 40, 60).repeat(images, 1, 1)
    return Batch(
        depth=depth,
        intrinsics=torch.tensor([[100.0, 110.0, 29.5, 19.5]]).expand(images, 4),
        poses=[torch.eye(4).repeat(len(boxes), 1, 1)] * images,
        boxes=[torch.tensor(boxes)] * images,
        visibility=[torch.full((len(boxes),), 0.8)] * images,
        seeds=tuple(range(images)),
    )


def drawing(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


@pytest.mark.parametrize("seed", range(5))
def test_a_point_keeps_its_ray(seed: int) -> None:
    whole = batch_of([[10, 10, 30, 30]])
    part = framed(whole, (24, 36), [drawing(seed)])
    pixel = int(part.depth[0, 5, 7])
    fx, fy, cx, cy = whole.intrinsics[0].tolist()
    ray = (pixel % 60 - cx) / fx, (pixel // 60 - cy) / fy
    fx, fy, cx, cy = part.intrinsics[0].tolist()
    assert ((7 - cx) / fx, (5 - cy) / fy) == pytest.approx(ray, abs=1e-6)


def test_boxes_show_the_same_pixels_and_end_at_the_frame() -> None:
    whole = batch_of([[20, 15, 28, 22]])
    for seed in range(20):
        part = framed(whole, (24, 36), [drawing(seed)])
        x0, y0, x1, y1 = (int(side) for side in part.boxes[0][0])
        shown = part.depth[0, y0:y1, x0:x1]
        assert torch.isin(shown, whole.depth[0, 15:22, 20:28]).all()
        assert part.visibility[0][0] == pytest.approx(0.8 * shown.numel() / 56)


def test_what_the_window_leaves_out_does_not_train() -> None:
    part = framed(batch_of([[0, 0, 4, 4], [56, 36, 60, 40]]), (20, 30), [drawing(0)])
    assert (part.visibility[0] < 0.8).any()
    outside = part.visibility[0] == 0
    x0, y0, x1, y1 = part.boxes[0][outside].unbind(1)
    assert ((x1 <= x0) | (y1 <= y0)).all()


def test_each_image_has_a_window_of_its_own_and_all_one_size() -> None:
    part = framed(batch_of([[0, 0, 60, 40]], images=6), (24, 36), [drawing(seed) for seed in range(6)])
    assert part.depth.shape == (6, 24, 36)
    assert len({float(image[0, 0]) for image in part.depth}) > 3


def test_some_steps_show_whole_images() -> None:
    sizes = {frame_size(40, 60, drawing(seed)) for seed in range(200)}
    assert (40, 60) in sizes
    assert len(sizes) == len(set(SIDES)) ** 2
    whole = batch_of([[0, 0, 60, 40]])
    assert framed(whole, (40, 60), [drawing(0)]) is whole
