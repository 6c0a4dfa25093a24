"""Box and region operations: torchvision's kernels where they import, else ours in plain PyTorch.

Boxes are x0, y0, x1, y1 in pixels of the input image, half-open as the labels are: pixel u covers [u, u + 1), so
the box of the single pixel (u, v) is (u, v, u + 1, v + 1). A region of interest (RoI) is the index of an image and a
box in it.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor

try:
    from torchvision.ops import nms as _torchvision_nms
    from torchvision.ops import roi_align as _torchvision_roi_align
except Exception:  # beside a torch of another build it fails with OSError, RuntimeError or AttributeError as well
    _torchvision_nms = _torchvision_roi_align = None

BOXES_AT_ONCE = 1024  # of a suppression without torchvision, whose memory goes by their square

# Faster R-CNN's guard: one step of refinement enlarges a box at most 62.5 times, so exp() cannot overflow.
MAX_LOG_SCALE = math.log(1000.0 / 16.0)


def box_area(
    boxes: Tensor,  # [..., 4]
) -> Tensor:
    """Areas (...) in square pixels; 0 for boxes that are turned inside out."""
    return (boxes[..., 2:] - boxes[..., :2]).clamp(min=0).prod(-1)


def box_iou(
    a: Tensor,  # [N, 4]
    b: Tensor,  # [M, 4]
) -> Tensor:
    """Intersection over union of every pair, (N, M); 0 where both boxes are empty."""
    overlap = box_intersection(a, b)
    union = box_area(a)[:, None] + box_area(b)[None] - overlap
    return torch.where(union > 0, overlap / union, torch.zeros_like(union))


def box_intersection(
    a: Tensor,  # [N, 4]
    b: Tensor,  # [M, 4]
) -> Tensor:
    """Area (N, M) that each pair has in common."""
    ax0, ay0, ax1, ay1 = a[:, None].unbind(-1)
    bx0, by0, bx1, by1 = b[None].unbind(-1)  # axis by axis: twice as fast as on the (N, M, 2) of both
    across = (torch.minimum(ax1, bx1) - torch.maximum(ax0, bx0)).clamp_(min=0)
    down = (torch.minimum(ay1, by1) - torch.maximum(ay0, by0)).clamp_(min=0)
    return across * down


def clip_boxes(
    boxes: Tensor,  # [..., 4]
    height: int,
    width: int,
) -> Tensor:
    """The part of each box (..., 4) that lies in the image."""
    x, y = boxes[..., 0::2].clamp(0, width), boxes[..., 1::2].clamp(0, height)
    return torch.stack([x, y], -1).flatten(-2)


def encode_boxes(
    boxes: Tensor,  # [..., 4]
    anchors: Tensor,  # [..., 4]
) -> Tensor:
    """Deltas (dx, dy, dw, dh) (..., 4) that lead from anchors to boxes (Ren et al. 2015, Faster R-CNN, eq. 2)."""
    center, size = _center_size(boxes)
    anchor_center, anchor_size = _center_size(anchors)
    return torch.cat([(center - anchor_center) / anchor_size, torch.log(size / anchor_size)], -1)


def decode_boxes(
    deltas: Tensor,  # [..., 4]
    anchors: Tensor,  # [..., 4]
) -> Tensor:
    """Boxes (..., 4) where the deltas lead from the anchors: the inverse of :func:`encode_boxes`.

    The logarithms of the scales are held below `MAX_LOG_SCALE`.
    """
    anchor_center, anchor_size = _center_size(anchors)
    center = anchor_center + deltas[..., :2] * anchor_size
    half = anchor_size * deltas[..., 2:].clamp(max=MAX_LOG_SCALE).exp() / 2
    return torch.cat([center - half, center + half], -1)


def _center_size(boxes: Tensor) -> tuple[Tensor, Tensor]:
    return (boxes[..., :2] + boxes[..., 2:]) / 2, (boxes[..., 2:] - boxes[..., :2]).clamp(min=1e-3)


def nms(
    boxes: Tensor,  # [N, 4]
    scores: Tensor,  # [N]
    iou_threshold: float,
) -> Tensor:
    """Greedy non-maximum suppression: indices (K,) of the boxes kept, best score first.

    A box falls to a better one that is kept and overlaps it by more than `iou_threshold`.
    """
    if _torchvision_nms is not None:
        return _torchvision_nms(boxes.float(), scores.float(), iou_threshold)
    order = scores.argsort(descending=True, stable=True)
    kept = order[:0]
    for portion in order.split(BOXES_AT_ONCE):
        free = ~(box_iou(boxes[portion].float(), boxes[kept].float()) > iou_threshold).any(1)
        portion = portion[free]
        ranked = boxes[portion].float()
        kept = torch.cat([kept, portion[_kept_greedily(box_iou(ranked, ranked) > iou_threshold)]])
    return kept


def _kept_greedily(overlaps: Tensor) -> Tensor:
    """Which rows (N,) survive when each, in order, falls to any earlier survivor that it overlaps: overlaps (N, N).

    The greedy answer is the only fixed point of "kept = no earlier kept row overlaps me": row i is right after i rounds
    at most, and all are after the few rounds of the longest chain; a loop over boxes would take hundreds.
    """
    earlier = overlaps.triu(diagonal=1).float()
    kept = earlier.new_ones(len(earlier))
    while True:
        again = (kept @ earlier == 0).float()
        if torch.equal(again, kept):
            return kept.bool()
        kept = again


def roi_align(
    features: Tensor,  # [B, C, H, W]
    rois: Tensor,  # [R, 5]: index of the image, x0, y0, x1, y1 in image pixels
    output_size: int,
    spatial_scale: float,
    sampling_ratio: int = 2,
    aligned: bool = True,
) -> Tensor:
    """Features of each region on a grid of its own, (R, C, output_size, output_size) (He et al. 2017, Mask R-CNN).

    Each bin is the mean of sampling_ratio² bilinear samples. With `aligned`, feature cell j covers the pixels
    [j, j + 1) / spatial_scale; without, it is taken half a cell too far, as the first implementations did.
    Differentiable with respect to the features, not the regions. Computed in float32, returned in the features' type.
    """
    if _torchvision_roi_align is not None and not torch.compiler.is_exporting():
        pooled = _torchvision_roi_align(
            features.float(), rois.float(), output_size, spatial_scale, sampling_ratio, aligned
        )
        return pooled.to(features.dtype)
    return _roi_align(features, rois, output_size, spatial_scale, sampling_ratio, aligned)


def _roi_align(
    features: Tensor, rois: Tensor, size: int, spatial_scale: float, sampling_ratio: int, aligned: bool
) -> Tensor:
    """Every bin is a weighted sum of a few feature cells: that is an embedding bag, whose kernel is fast everywhere.

    In float32 on two CPU cores, forward and backward, 2.6 to 4 times as fast as dense weights a region and 5 to 9 times
    as fast as grid_sample (8 to 64 regions an image, 128 channels, 30 x 40 cells, 8 x 8 bins).
    """
    batch, channels, height, width = features.shape
    boxes = rois[:, 1:].float() * spatial_scale
    if not aligned:  # the old form also counts from the cells' centers and makes every region a cell wide at least
        boxes = torch.cat([boxes[:, :2], torch.maximum(boxes[:, 2:], boxes[:, :2] + 1)], -1) + 0.5
    column, column_weight = _axis_samples(boxes[:, 0], boxes[:, 2], size, sampling_ratio, width)
    row, row_weight = _axis_samples(boxes[:, 1], boxes[:, 3], size, sampling_ratio, height)
    row = row + rois[:, 0].long()[:, None, None] * height
    cells = row[:, :, None, :, None] * width + column[:, None, :, None, :]
    weights = row_weight[:, :, None, :, None] * column_weight[:, None, :, None, :]
    per_bin = (2 * sampling_ratio) ** 2
    flat = features.permute(0, 2, 3, 1).reshape(batch * height * width, channels).float()
    cells, weights = cells.reshape(-1, per_bin), weights.reshape(-1, per_bin)
    if torch.compiler.is_exporting():  # ONNX has no weighted embedding bag
        pooled = (flat[cells] * weights[..., None]).sum(1)
    else:
        pooled = F.embedding_bag(cells, flat, mode="sum", per_sample_weights=weights)
    return pooled.view(rois.shape[0], size, size, channels).permute(0, 3, 1, 2).to(features.dtype)


def _axis_samples(low: Tensor, high: Tensor, size: int, ratio: int, cells: int) -> tuple[Tensor, Tensor]:
    """Along one axis, the cells that each bin of [low, high) (R,) reads, and their weights: (R, size, 2 * ratio) each.

    A sample more than half a cell beyond the outermost cells' edges weighs nothing; within that, the edge is repeated.
    """
    steps = (torch.arange(size * ratio, device=low.device) + 0.5) / (size * ratio)
    position = torch.nan_to_num(low[:, None] + (high - low)[:, None] * steps - 0.5, nan=-2.0)
    inside = ((position >= -1) & (position <= cells)).float() / ratio
    position = position.clamp(0, cells - 1)
    first = position.floor()
    fraction = position - first
    index = torch.stack([first, (first + 1).clamp(max=cells - 1)], -1).long()
    weight = torch.stack([(1 - fraction) * inside, fraction * inside], -1)
    return index.view(-1, size, 2 * ratio), weight.view(-1, size, 2 * ratio)
