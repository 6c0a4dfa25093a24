"""From depth in meters to what the trunk sees, and to the raw crops of its regions."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from evalkit.geometry.camera import Camera, nearest_pixels
from posenet.config import NetworkConfig

EVERY = 4  # pixels, along rows and columns: enough for a median of the image
LEAST_PLAUSIBLE = 0.02  # of an image's depths; if fewer are where the object was in training, it is elsewhere
CROP_CHANNELS = 4  # relative depth, two normal components, has a return


def surface_normals(depth: Tensor, intrinsics: Tensor) -> Tensor:
    """Unit normals toward the camera (B, 3, H, W) from depth (B, H, W) in meters, 0 = no return.

    Central differences where both neighbors have a return, one-sided where one has, zero vectors elsewhere.
    """
    valid = depth > 0
    slope_u = _slope(depth, valid, 2)
    slope_v = _slope(depth, valid, 1)
    fx, fy, cx, cy = (intrinsics[:, i, None, None] for i in range(4))
    height, width = depth.shape[-2:]
    u = torch.arange(width, device=depth.device, dtype=depth.dtype) - cx
    v = torch.arange(height, device=depth.device, dtype=depth.dtype)[:, None] - cy
    x, y, z = fx * slope_u, fy * slope_v, -(depth + u * slope_u + v * slope_v)
    # Written out, for a norm over the channel dimension takes ten times as long.
    scale = torch.where(valid, torch.rsqrt((x * x + y * y + z * z).clamp(min=1e-18)), 0.0)
    return torch.stack([x * scale, y * scale, z * scale], 1)


def _slope(depth: Tensor, valid: Tensor, dim: int) -> Tensor:
    step = torch.diff(depth, dim=dim)
    known = (valid.narrow(dim, 1, valid.shape[dim] - 1) & valid.narrow(dim, 0, valid.shape[dim] - 1)).to(depth.dtype)
    step = step * known
    pad = (1, 0) if dim == 2 else (0, 0, 1, 0)
    after = (0, 1) if dim == 2 else (0, 0, 0, 1)
    total = F.pad(step, pad) + F.pad(step, after)
    return total / (F.pad(known, pad) + F.pad(known, after)).clamp(min=1.0)


def scene_depth(depth: Tensor, depth_range: tuple[float, float], diameter: float) -> Tensor:
    """The depth (B,) about which each image (B, H, W) shows objects; 1 for an image of holes.

    It is the median of the depths where the object may be by the training set's range of centroids, so that a floor
    far below the bin does not shift it; where hardly any lies there, the median of all.
    """
    seen = depth[:, ::EVERY, ::EVERY].flatten(1)
    near, far = depth_range[0] - diameter, depth_range[1] + diameter
    plausible = torch.where((seen > near) & (seen < far), seen, 0.0)
    enough = (plausible > 0).sum(1) > LEAST_PLAUSIBLE * (seen > 0).sum(1)
    median = _median_of_returns(torch.where(enough[:, None], plausible, seen))
    return torch.where(median > 0, median, torch.ones_like(median))


def network_input(
    depth: Tensor,
    normals: Tensor,
    config: NetworkConfig,
    diameter: float,
    depth_range: tuple[float, float],
    shift: Tensor | None = None,
) -> Tensor:
    """The trunk's three channels (B, 3, H, W).

    depth-holes: depth over the training set's range, holes, and slant (the normal's z). Depth is absolute, as the
    paper's depth bins need it. depth-normals: depth about the scene's in diameters, and the normal's x and y; `shift`
    (B,) in diameters is added to the scene's depth.
    """
    valid = (depth > 0).to(depth.dtype)
    if config.input == "depth-holes":
        middle, half = sum(depth_range) / 2, max(depth_range[1] - depth_range[0], diameter) / 2
        scaled = ((depth - middle) / half).clamp(-3.0, 3.0) * valid
        return torch.stack([scaled, 1.0 - valid, normals[:, 2]], 1)
    reference = scene_depth(depth, depth_range, diameter)
    if shift is not None:
        reference = reference + shift * diameter
    reference = reference[:, None, None]
    scaled = ((depth - reference) / diameter).clamp(-4.0, 4.0) * valid
    return torch.stack([scaled, normals[:, 0], normals[:, 1]], 1)


def resample(depth: Tensor, camera: Camera) -> Tensor:
    """Depth (H, W) on the pixel grid of `camera`, of the same view (see :meth:`Camera.sampled`).

    Nearest, for the mean of two depths is the depth of nothing. What is computed of neighbors afterwards, normals say,
    looks as far as the new pixels are wide, which on a noisy camera's depth is better than next door.
    """
    if depth.shape == (camera.height, camera.width):
        return depth
    rows, columns = (
        torch.from_numpy(nearest_pixels(count, of)).to(depth.device)
        for count, of in zip((camera.height, camera.width), depth.shape, strict=True)
    )
    return depth[rows[:, None], columns]


def pad_to_multiple(images: Tensor, stride: int) -> Tensor:
    """Images (B, H, W) with rows and columns of no return at the bottom and right, so that cells cover every pixel."""
    height, width = images.shape[-2:]
    return F.pad(images, (0, -width % stride, 0, -height % stride))


def median_depth(depth: Tensor, boxes: Tensor, image_index: Tensor, grid: int = 16) -> Tensor:
    """Median of the depth returned inside each box: (B, H, W), (n, 4), (n,) -> (n,); 0 where nothing returned."""
    return _median_of_returns(sample_nearest(depth[:, None], boxes, image_index, grid)[:, 0].flatten(1))


def _median_of_returns(values: Tensor) -> Tensor:
    """The (lower) median of the positive numbers of each row, (n, k) -> (n,); 0 where there are none."""
    if not torch.compiler.is_exporting():
        return torch.nanmedian(torch.where(values > 0, values, torch.nan), dim=1).values.nan_to_num(nan=0.0)
    # ONNX has no median, but it sorts: holes come first, and are as many as values - count.
    ordered, count = values.sort(dim=1).values, (values > 0).sum(1)
    middle = values.shape[1] - count + (count - 1).clamp(min=0) // 2
    found = ordered.gather(1, middle.clamp(max=values.shape[1] - 1)[:, None])[:, 0]
    return found * (count > 0)


def sample_nearest(images: Tensor, windows: Tensor, image_index: Tensor, size: int) -> Tensor:
    """Nearest samples (n, C, size, size) on a grid inside each window; 0 beyond the frame.

    Nearest, because a mean of depths across an edge or a hole is the depth of nothing.

    Args:
        images: (B, C, H, W). windows: (n, 4) half-open pixel boxes. image_index: (n,).
    """
    height, width = images.shape[-2:]
    steps = (torch.arange(size, device=images.device, dtype=windows.dtype) + 0.5) / size
    u = (windows[:, 0, None] + steps * (windows[:, 2] - windows[:, 0])[:, None]).floor().long()
    v = (windows[:, 1, None] + steps * (windows[:, 3] - windows[:, 1])[:, None]).floor().long()
    inside = ((v >= 0) & (v < height))[:, :, None] & ((u >= 0) & (u < width))[:, None, :]
    rows, columns = v.clamp(0, height - 1)[:, :, None], u.clamp(0, width - 1)[:, None, :]
    picked = images.permute(0, 2, 3, 1)[image_index[:, None, None], rows, columns]
    return (picked * inside[..., None]).permute(0, 3, 1, 2)


def raw_crops(
    depth: Tensor,
    normals: Tensor,
    windows: Tensor,
    reference_depth: Tensor,
    image_index: Tensor,
    size: int,
    scale: float,
) -> Tensor:
    """Crops (n, 4, size, size): depth relative to the region's median over `scale` meters, normal x and y, return."""
    stacked = torch.cat([depth[:, None], normals[:, :2]], 1)
    crops = sample_nearest(stacked, windows, image_index, size)
    valid = (crops[:, :1] > 0).to(crops.dtype)
    relative = ((crops[:, :1] - reference_depth[:, None, None, None]) / scale).clamp(-1.5, 1.5) * valid
    return torch.cat([relative, crops[:, 1:], valid], 1)


def intrinsics_of(camera: Camera) -> torch.Tensor:
    """fx, fy, cx, cy as a tensor (4,)."""
    return torch.tensor([camera.fx, camera.fy, camera.cx, camera.cy], dtype=torch.float32)
