"""What the network sees of a depth image."""

from __future__ import annotations

import math

import torch

from posenet.config import NetworkConfig
from posenet.network import depth_input
from posenet.network.regions import make_regions
from posenet.network.targets import reference_shift

INTRINSICS = torch.tensor([[100.0, 110.0, 31.5, 23.5]])


def plane(normal: torch.Tensor, distance: float, height: int = 48, width: int = 64) -> torch.Tensor:
    """Depth (1, H, W) of the plane normal . p = distance."""
    fx, fy, cx, cy = INTRINSICS[0]
    v, u = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    ray = torch.stack([(u - cx) / fx, (v - cy) / fy, torch.ones_like(u, dtype=torch.float32)], -1)
    return (distance / (ray @ normal))[None]


def test_normals_of_a_plane_are_the_planes() -> None:
    for tilt in (0.0, 0.3, 0.7):
        normal = torch.tensor([math.sin(tilt) * 0.6, math.sin(tilt) * 0.8, math.cos(tilt)])
        found = depth_input.surface_normals(plane(normal, 0.5), INTRINSICS)[0]
        inner = found[:, 2:-2, 2:-2].flatten(1).T
        assert (inner + normal).abs().max() < 0.02  # it points at the camera


def test_holes_have_no_normal_and_do_not_bend_their_neighbors() -> None:
    normal = torch.tensor([0.2, 0.1, 0.97])
    depth = plane(normal, 0.5)
    whole = depth_input.surface_normals(depth, INTRINSICS)
    holed = depth.clone()
    holed[:, 20:24, 30:34] = 0.0
    found = depth_input.surface_normals(holed, INTRINSICS)
    assert (found[:, :, 20:24, 30:34] == 0).all()
    seen = (holed > 0)[:, None].expand_as(found)
    assert (found - whole)[seen].abs().max() < 0.02


def test_an_image_of_holes_is_finite_input() -> None:
    depth = torch.zeros(2, 48, 64)
    normals = depth_input.surface_normals(depth, INTRINSICS.expand(2, 4))
    for kind in ("depth-normals", "depth-holes"):
        image = depth_input.network_input(depth, normals, NetworkConfig(input=kind), 0.1, (0.3, 0.6))
        assert image.shape == (2, 3, 48, 64)
        assert torch.isfinite(image).all()


def test_relative_input_does_not_depend_on_the_cameras_distance_beyond_scale() -> None:
    depth = plane(torch.tensor([0.0, 0.0, 1.0]), 0.5)
    normals = depth_input.surface_normals(depth, INTRINSICS)
    config = NetworkConfig(input="depth-normals")
    near = depth_input.network_input(depth, normals, config, 0.1, (0.3, 0.6))
    far = depth_input.network_input(depth + 0.2, normals, config, 0.1, (0.3, 0.6))
    torch.testing.assert_close(near[:, 0], far[:, 0])


def test_an_image_shown_about_another_depth_moves_in_depth_alone_and_by_so_many_diameters() -> None:
    depth = plane(torch.tensor([0.1, 0.0, 1.0]), 0.5).expand(2, -1, -1)
    normals = depth_input.surface_normals(depth, INTRINSICS.expand(2, 4))
    shift = torch.tensor([0.0, 1.5])
    as_it_is, moved = (
        depth_input.network_input(depth, normals, NetworkConfig(), 0.1, (0.3, 0.6), about) for about in (None, shift)
    )
    torch.testing.assert_close(moved[:, 0], as_it_is[:, 0] - shift[:, None, None], atol=1e-5, rtol=0)
    torch.testing.assert_close(moved[:, 1:], as_it_is[:, 1:])


def test_half_of_the_images_train_about_another_depth_by_the_draws_of_their_own_seeds() -> None:
    def shift(seeds: range, largest: float = 3.0) -> torch.Tensor:
        return reference_shift([torch.Generator().manual_seed(seed) for seed in seeds], largest)

    many = shift(range(1000))
    assert 400 < int((many != 0).sum()) < 600
    assert many.abs().max() <= 3.0 and many.min() < -2.7 and many.max() > 2.7
    torch.testing.assert_close(shift(range(40, 60)), many[40:60])
    assert not shift(range(100), 0.0).any()


def test_nearest_samples_are_pixels_of_the_image_or_zero_outside() -> None:
    image = torch.arange(48 * 64, dtype=torch.float32).view(1, 1, 48, 64) + 1
    windows = torch.tensor([[10.0, 10.0, 18.0, 18.0], [-8.0, -8.0, 8.0, 8.0]])
    found = depth_input.sample_nearest(image, windows, torch.zeros(2, dtype=torch.long), 8)
    torch.testing.assert_close(found[0, 0], image[0, 0, 10:18, 10:18])
    assert (found[1, 0, :4, :] == 0).all() and (found[1, 0, :, :4] == 0).all()
    assert (found[1, 0, 4:, 4:] > 0).all()


def test_the_median_depth_ignores_holes_and_is_zero_where_nothing_returned() -> None:
    depth = torch.full((1, 48, 64), 0.5)
    depth[:, :24] = 0.0
    boxes = torch.tensor([[10.0, 10.0, 40.0, 40.0], [10.0, 2.0, 40.0, 20.0]])
    found = depth_input.median_depth(depth, boxes, torch.zeros(2, dtype=torch.long))
    torch.testing.assert_close(found, torch.tensor([0.5, 0.0]))


def test_a_metric_region_has_one_size_in_meters_at_any_distance_and_occlusion() -> None:
    config = NetworkConfig(roi="metric", roi_scale=1.0)
    for depth_value in (0.4, 0.8):
        depth = torch.full((1, 48, 64), depth_value)
        boxes = torch.tensor([[20.0, 15.0, 30.0, 30.0], [24.0, 20.0, 26.0, 25.0]])
        regions = make_regions(depth, INTRINSICS, boxes, torch.zeros(2, dtype=torch.long), config, 0.1)
        sides = (regions.windows[:, 2:] - regions.windows[:, :2]) * depth_value / INTRINSICS[:, :2]
        torch.testing.assert_close(sides, torch.full((2, 2), 0.1))
        torch.testing.assert_close(regions.windows.view(2, 2, 2).mean(1), boxes.view(2, 2, 2).mean(1))
