"""Images that end within the heap, as a camera has them that does not see the whole bin.

Simulated cameras mostly see all of it, so parts that the frame cuts would never train; yet their visible boxes, and the
windows about them, lie otherwise about their centers than those of parts that others hide.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from posenet.layers.ops import box_area
from posenet.network.targets import Batch

# Shares of a side that an image keeps, equally likely. Few, for each new size of image costs its convolutions a start.
SIDES = (1.0, 1.0, 0.8, 0.6)


def frame_size(height: int, width: int, draw: np.random.Generator) -> tuple[int, int]:
    """Rows and columns of what a step shows of its images."""
    rows, columns = draw.choice(SIDES, 2)
    return max(1, round(rows * height)), max(1, round(columns * width))


def framed(batch: Batch, size: tuple[int, int], draws: Sequence[np.random.Generator]) -> Batch:
    """The batch seen through a window of `size` rows and columns, for each image where its own generator puts it.

    Visible boxes end at the window. How much of an instance is seen falls with the area of its box, for where in the
    box its visible pixels are is not in a batch; what lies outside altogether has a box without area.
    """
    height, width = size
    if batch.depth.shape[1:] == size:
        return batch
    corners = [_corner(batch.depth.shape[1:], size, draw) for draw in draws]
    depth = [image[y : y + height, x : x + width] for image, (x, y) in zip(batch.depth, corners, strict=True)]
    shift = batch.intrinsics.new_tensor([[0, 0, x, y] for x, y in corners])
    boxes, visibility = [], []
    for whole, seen, (x, y) in zip(batch.boxes, batch.visibility, corners, strict=True):
        moved = whole - whole.new_tensor([x, y, x, y])
        inside = moved.clamp(min=0).minimum(moved.new_tensor([width, height, width, height]))
        boxes.append(inside)
        visibility.append(seen * (box_area(inside) / box_area(whole).clamp(min=1e-6)).clamp(max=1).to(seen))
    return batch._replace(
        depth=torch.stack(depth), intrinsics=batch.intrinsics - shift, boxes=boxes, visibility=visibility
    )


def _corner(shape: Sequence[int], size: tuple[int, int], draw: np.random.Generator) -> tuple[int, int]:
    y, x = (int(draw.integers(0, whole - part + 1)) for whole, part in zip(shape, size, strict=True))
    return x, y
