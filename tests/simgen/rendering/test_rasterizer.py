"""The compiled renderer against a plain one of a few lines, and against embreex's rays."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from simgen.rendering.outward import faces_outward
from simgen.rendering.rasterizer import Rasterizer, Rendering

CAMERA = Camera(160, 120, 150.0, 155.0, 78.3, 60.9)
FLOOR = (np.array([[-3.0, -3, 0], [3, -3, 0], [3, 3, 0], [-3, 3, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
OVERHEAD = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.6], [0, 0, 0, 1]])


def random_poses(rng: np.random.Generator, count: int, depth: tuple[float, float] = (0.3, 0.6)) -> NDArray[np.float64]:
    z = rng.uniform(*depth, count)
    aside = rng.uniform(-0.4, 0.4, (count, 2)) * z[:, None]
    return poses.from_rotation_translation(poses.random_rotations(rng, count), np.column_stack([aside, z]))


def triangles_in_camera(mesh: trimesh.Trimesh, cam_from_obj: NDArray[np.float64]) -> NDArray[np.float64]:
    """(instances, faces, 3 corners, 3)."""
    return np.stack([poses.apply(pose, mesh.vertices)[mesh.faces] for pose in cam_from_obj])


def plain_depth(triangles: NDArray[np.float64], camera: Camera) -> NDArray[np.float64]:
    """Depth (height, width) of triangles (F, 3, 3) in the camera's frame: every pixel's ray against every one."""
    rays = camera.point_map(np.ones((camera.height, camera.width)))
    depth = np.full(rays.shape[:2], np.inf)
    for a, b, c in triangles:
        normal = np.cross(b - a, c - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            z = (normal @ a) / (rays @ normal)
        hit = z[..., None] * rays
        sides = [np.cross(q - p, hit - p) @ normal for p, q in ((a, b), (b, c), (c, a))]
        inside = (np.min(sides, axis=0) >= 0) & (z > 0)
        depth = np.where(inside & (z < depth), z, depth)
    return np.where(np.isfinite(depth), depth, 0.0)


def embree_image(triangles: NDArray[np.float64], camera: Camera) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Depth and instance ids of (instances, faces, 3, 3), by rays through the pixels' centers."""
    from embreex import rtcore_scene
    from embreex.mesh_construction import TriangleMesh

    scene = rtcore_scene.EmbreeScene(robust=True)
    flat = triangles.reshape(-1, 3, 3)
    TriangleMesh(scene, flat.astype(np.float32))
    rays = camera.point_map(np.ones((camera.height, camera.width))).reshape(-1, 3).astype(np.float32)
    result = scene.run(np.zeros_like(rays), rays, output=True)
    hit = result["primID"] >= 0
    depth = np.where(hit, result["tfar"], 0.0)  # the rays' z is 1, so their length is depth
    ids = np.where(hit, result["primID"] // triangles.shape[1] + 1, 0)
    return depth.reshape(camera.height, camera.width), ids.reshape(camera.height, camera.width)


def away_from_edges(ids: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Pixels whose eight neighbors show the same instance."""
    padded = np.pad(ids, 1, mode="edge")
    neighbors = [padded[1 + dy : padded.shape[0] - 1 + dy, 1 + dx : padded.shape[1] - 1 + dx]
                  for dy in (-1, 0, 1) for dx in (-1, 0, 1)]  # fmt: skip
    return np.all(np.stack(neighbors) == ids, axis=0)


def render(mesh: trimesh.Trimesh, cam_from_obj: NDArray[np.float64], camera: Camera = CAMERA) -> Rendering:
    return Rasterizer(camera, mesh.vertices, mesh.faces).render(cam_from_obj, np.eye(4))


@pytest.mark.parametrize("closed", [True, False])
def test_ids_and_depth_agree_with_embree(closed: bool) -> None:
    rng = np.random.default_rng(3)
    mesh = trimesh.creation.torus(0.06, 0.025, major_sections=48, minor_sections=24)
    if not closed:
        mesh = trimesh.Trimesh(mesh.vertices, mesh.faces[rng.permutation(len(mesh.faces))[:1700]])
    cam_from_obj = random_poses(rng, 15)
    rendering = render(mesh, cam_from_obj)
    depth, ids = embree_image(triangles_in_camera(mesh, cam_from_obj), CAMERA)
    inner = away_from_edges(ids) & away_from_edges(rendering.instance_id)
    assert inner.mean() > 0.5
    assert np.array_equal(rendering.instance_id[inner], ids[inner])
    assert np.abs(rendering.depth - depth)[inner].max() < 1e-4
    assert (rendering.instance_id != ids).mean() < 1e-3


def test_depth_agrees_with_the_plain_renderer() -> None:
    rng = np.random.default_rng(0)
    mesh = trimesh.creation.icosphere(1, 0.08)
    cam_from_obj = random_poses(rng, 4)
    rendering = render(mesh, cam_from_obj)
    plain = plain_depth(triangles_in_camera(mesh, cam_from_obj).reshape(-1, 3, 3), CAMERA)
    agree = np.isclose(rendering.depth, plain, atol=1e-5)
    assert (~agree).mean() < 1e-3
    assert (plain > 0).mean() > 0.05


def test_the_whole_silhouette_is_counted_beyond_the_frame_and_behind_others() -> None:
    mesh = trimesh.creation.icosphere(2, 0.1)
    larger = Camera(480, 360, CAMERA.fx, CAMERA.fy, CAMERA.cx + 160, CAMERA.cy + 120)
    pose = np.eye(4)[None].repeat(2, 0)
    pose[:, :3, 3] = [[0.25, -0.15, 0.5], [0.25, -0.15, 0.9]]
    rendering = render(mesh, pose)
    for row in range(2):
        alone = render(mesh, pose[row : row + 1], larger)
        ys, xs = np.nonzero(alone.instance_id)
        assert rendering.pixels_full[row] == len(xs) > 0
        assert rendering.box_full[row].tolist() == [
            xs.min() - 160, ys.min() - 120, xs.max() + 1 - 160, ys.max() + 1 - 120
        ]  # fmt: skip


@pytest.mark.parametrize("seed", range(5))
def test_shared_edges_leave_no_gap_and_no_pixel_twice(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = np.vstack([rng.uniform(-0.2, 0.2, (60, 2)), [[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2], [-0.2, 0.2]]])
    from scipy.spatial import Delaunay

    faces = Delaunay(points).simplices
    vertices = np.column_stack([points, np.full(len(points), 0.5)])
    whole = render(trimesh.Trimesh(vertices, faces, process=False), np.eye(4)[None])
    parts = sum(
        int(render(trimesh.Trimesh(vertices, face[None], process=False), np.eye(4)[None]).pixels_full[0])
        for face in faces
    )
    assert whole.pixels_full[0] == parts
    ys, xs = np.nonzero(whole.instance_id)
    assert len(xs) == (np.ptp(xs) + 1) * (np.ptp(ys) + 1)


def test_what_lies_behind_the_near_plane_is_cut_off() -> None:
    rendering = Rasterizer(CAMERA, *NOTHING_BUT_A_CUBE, FLOOR).render(
        np.zeros((0, 4, 4)), tilted_camera(height=0.5, tilt=1.2)
    )
    plain = plain_depth(np.stack([poses.apply(tilted_camera(0.5, 1.2), FLOOR[0])[face] for face in FLOOR[1]]), CAMERA)
    assert 0.2 < (plain > 0).mean() < 1
    assert np.allclose(rendering.depth, plain, rtol=1e-5)


def test_an_instance_around_the_camera_is_drawn_where_it_is_in_front() -> None:
    mesh = trimesh.creation.box([0.2, 0.2, 2.0])
    pose = np.eye(4)[None].copy()
    pose[0, 2, 3] = 0.5  # from 0.5 m behind the camera to 1.5 m before it; the camera is inside
    rendering = render(trimesh.Trimesh(mesh.vertices, mesh.faces[:, ::-1], process=False), pose)
    plain = plain_depth(triangles_in_camera(mesh, pose)[0], CAMERA)
    assert (plain > 0).all()
    assert np.allclose(rendering.depth, plain, rtol=1e-5)


def test_more_than_255_instances_keep_their_ids() -> None:
    rng = np.random.default_rng(1)
    mesh = trimesh.creation.icosphere(0, 0.01)
    rendering = render(mesh, random_poses(rng, 700))
    _, ids = embree_image(triangles_in_camera(mesh, random_poses(np.random.default_rng(1), 700)), CAMERA)
    inner = away_from_edges(ids) & (ids > 0)
    assert rendering.instance_id.max() > 255
    assert np.array_equal(rendering.instance_id[inner], ids[inner])


def test_the_background_hides_what_is_below_it_and_has_id_zero() -> None:
    mesh = trimesh.creation.icosphere(2, 0.1)
    world_from_obj = np.eye(4)[None].repeat(2, 0)
    world_from_obj[:, :3, 3] = [[-0.1, 0, 0.1], [0.1, 0, -0.2]]
    rendering = Rasterizer(CAMERA, mesh.vertices, mesh.faces, FLOOR).render(OVERHEAD @ world_from_obj, OVERHEAD)
    assert set(np.unique(rendering.instance_id)) == {0, 1}
    assert rendering.pixels_full[1] > 0
    assert np.allclose(rendering.depth[rendering.instance_id == 0], 0.6)


def test_wide_images_and_long_thin_triangles_agree_with_embree() -> None:
    camera = Camera(640, 64, 300.0, 300.0, 320.0, 32.0)
    mesh = trimesh.creation.box([0.6, 0.01, 0.01])
    cam_from_obj = random_poses(np.random.default_rng(5), 12)
    rendering = render(mesh, cam_from_obj, camera)
    depth, ids = embree_image(triangles_in_camera(mesh, cam_from_obj), camera)
    assert (rendering.instance_id != ids).mean() < 2e-3
    same = (rendering.instance_id == ids) & away_from_edges(ids)
    assert np.abs(rendering.depth - depth)[same].max() < 1e-4


@pytest.mark.parametrize(
    ("spoil", "outward"),
    [
        (lambda faces: faces, True),
        (lambda faces: faces[:, ::-1], False),
        (lambda faces: faces[1:], False),
        (lambda faces: np.vstack([faces[:1, ::-1], faces[1:]]), False),
    ],
)
def test_back_faces_are_skipped_only_where_nobody_can_see_them(spoil, outward) -> None:  # type: ignore[no-untyped-def]
    mesh = trimesh.creation.icosphere(2, 0.1)
    faces = spoil(mesh.faces)
    assert faces_outward(mesh.vertices, faces) == outward
    pose = random_poses(np.random.default_rng(2), 1)
    expected = plain_depth(triangles_in_camera(trimesh.Trimesh(mesh.vertices, faces, process=False), pose)[0], CAMERA)
    seen = Rasterizer(CAMERA, mesh.vertices, faces).render(pose, np.eye(4))
    assert (~np.isclose(seen.depth, expected, atol=1e-5)).mean() < 1e-3


@pytest.mark.parametrize("offset", [(3.0, 0, 0), (0, 0, -3.0), (-2.0, 40.0, 5.0)])
def test_the_files_origin_changes_neither_the_pictures_nor_how_they_are_drawn(offset: tuple[float, ...]) -> None:
    mesh = trimesh.creation.torus(0.06, 0.025, major_sections=24, minor_sections=12)
    pose = random_poses(np.random.default_rng(7), 12)
    new_from_old = poses.from_rotation_translation(np.eye(3), -np.array(offset))
    here = Rasterizer(CAMERA, mesh.vertices, mesh.faces)
    there = Rasterizer(CAMERA, mesh.vertices + offset, mesh.faces)
    clipped = [
        [renderer._needs_clipping(one) for one in at] for renderer, at in ((here, pose), (there, pose @ new_from_old))
    ]
    assert clipped[1] == clipped[0] and not all(clipped[0])
    expected, seen = here.render(pose, np.eye(4)), there.render(pose @ new_from_old, np.eye(4))
    assert (seen.instance_id != expected.instance_id).mean() < 1e-3
    assert np.abs(seen.pixels_full - expected.pixels_full).max() <= 2


def test_two_bodies_of_which_one_is_inside_out_are_drawn_right() -> None:
    ball = trimesh.creation.icosphere(2, 0.05)
    vertices = np.vstack([ball.vertices - [0.08, 0, 0], 2 * ball.vertices + [0.08, 0, 0]])
    faces = np.vstack([ball.faces[:, ::-1], ball.faces + len(ball.vertices)])
    assert not faces_outward(vertices, faces)


def tilted_camera(height: float, tilt: float) -> NDArray[np.float64]:
    """`cam_from_world` of a camera `height` above the floor's middle, turned by `tilt` from looking straight down."""
    cam_from_world = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, height], [0, 0, 0, 1]])
    turn = np.eye(4)
    turn[:3, :3] = poses.from_axis_angle([1.0, 0, 0], tilt)
    return turn @ cam_from_world


_CUBE = trimesh.creation.box([0.1, 0.1, 0.1])
NOTHING_BUT_A_CUBE = (_CUBE.vertices, _CUBE.faces)
