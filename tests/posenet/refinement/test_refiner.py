"""Refinement finds the truth from nearby, and tells right from wrong by the image alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel
from posenet.refinement import refiner as refine
from posenet.refinement.competition import settled
from posenet.refinement.depth_evidence import ALREADY_EXPLAINED, FOOTPRINT, depth_evidence, explained_before
from posenet.refinement.fits import Fits
from posenet.refinement.icp import DAMPING, LEAST_NORMAL_COSINE, icp
from posenet.refinement.judge import FORMAT, Judge, Regression, probability
from posenet.refinement.observed import observed
from posenet.refinement.refiner import Fitting, Refiner

CAMERA = Camera(160, 120, 180.0, 180.0, 79.5, 59.5)
FLOOR = 0.62
CREDULOUS = Judge(FORMAT, Regression(2.0, {}), Regression(2.0, {}))


def wedge() -> ObjectModel:
    """A slanted 60 x 40 x 30 mm box without symmetry: convex, so that its depth is that of its front planes."""
    x, y, z = 0.03, 0.02, 0.015
    vertices = np.array(
        [[-x, -y, -z], [x, -y, -z], [x, y, -z], [-x, y, -z], [-x, -y, z], [x / 3, -y, z], [x / 2, y, z / 2], [-x, y, z]]
    )
    faces = ConvexHull(vertices).simplices
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = (normal * (corners[:, 0] - vertices.mean(0))).sum(1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return ObjectModel.from_mesh("wedge", vertices, faces)


def render(model: ObjectModel, cam_from_obj: np.ndarray) -> np.ndarray:
    """Depth of one convex object over a floor: a ray hits it if it enters the last front plane before it leaves any."""
    assert model.vertices is not None and model.faces is not None
    depth = np.full((CAMERA.height, CAMERA.width), FLOOR)
    rays = CAMERA.point_map(np.ones((CAMERA.height, CAMERA.width)))
    corners = poses.apply(cam_from_obj, model.vertices)[model.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    slope = rays @ normal.T
    with np.errstate(divide="ignore"):
        crossing = (normal * corners[:, 0]).sum(-1) / slope
    enter = np.where(slope < 0, crossing, -np.inf).max(-1)
    leave = np.where(slope > 0, crossing, np.inf).min(-1)
    return np.where(enter < leave, np.minimum(enter, depth), depth).astype(np.float32)


@pytest.fixture(scope="module")
def scene() -> tuple[ObjectModel, np.ndarray, np.ndarray]:
    model = wedge()
    turn = poses.from_axis_angle([0.6, 0.7, 0.2], 2.2)
    pose = poses.from_rotation_translation(turn, [0.01, -0.02, 0.5])
    return model, pose, render(model, pose)


def distance(model: ObjectModel, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.linalg.norm(model.representatives(a) - model.representatives(b)[..., :1, :], axis=-1).min(-1)


def disturbed(pose: np.ndarray, rng: np.random.Generator, count: int, meters: float, radians: float) -> np.ndarray:
    turn = poses.from_axis_angle(rng.standard_normal((count, 3)), np.full(count, radians))
    shift = pose[:3, 3] + rng.uniform(-meters, meters, (count, 3))
    return poses.from_rotation_translation(turn @ pose[:3, :3], shift)


def test_the_truth_stays_and_is_seen(scene: tuple[ObjectModel, np.ndarray, np.ndarray]) -> None:
    model, pose, depth = scene
    found = Refiner(model).refine(depth, CAMERA, pose[None], np.ones(1))
    assert distance(model, found.cam_from_obj, pose[None]) < 2e-4
    assert found.agreement[0] > 0.7 and found.violation[0] < 0.05 and found.score[0] > 0.95


@pytest.mark.parametrize(("degrees", "share"), [(8, 0.95), (35, 0.8)])
def test_what_starts_off_the_truth_comes_to_it(
    scene: tuple[ObjectModel, np.ndarray, np.ndarray], degrees: float, share: float
) -> None:
    model, pose, depth = scene
    starts = disturbed(pose, np.random.default_rng(0), 20, 0.003, np.radians(degrees))
    refiner = Refiner(model)
    found = np.concatenate([refiner.refine(depth, CAMERA, start[None], np.ones(1)).cam_from_obj for start in starts])
    assert (distance(model, found, pose[None]) < 0.2 * model.threshold).mean() >= share


def test_turned_starts_reach_what_one_start_does_not(scene: tuple[ObjectModel, np.ndarray, np.ndarray]) -> None:
    model, pose, depth = scene
    starts = disturbed(pose, np.random.default_rng(5), 30, 0.003, np.radians(55))
    refiner = Refiner(model)

    def reached() -> int:
        found = [refiner.refine(depth, CAMERA, start[None], np.ones(1)).cam_from_obj for start in starts]
        return int((distance(model, np.concatenate(found), pose[None]) < model.threshold).sum())

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(refine, "SEARCH", ())
        once = reached()
    assert reached() >= once + 5


def test_the_image_tells_right_poses_from_wrong_ones(scene: tuple[ObjectModel, np.ndarray, np.ndarray]) -> None:
    model, pose, depth = scene
    rng = np.random.default_rng(1)
    wrong = poses.from_rotation_translation(poses.random_rotations(rng, 40), pose[:3, 3])
    wrong = wrong[distance(model, wrong, pose[None]) > model.threshold]
    some = np.concatenate([pose[None], wrong])
    fitting, fits = unfitted(Refiner(model), some, depth)
    sureness = probability(fitting.refiner.judge.alone.logit(fitting.judged(fits, fits).alone))
    assert len(wrong) > 30
    assert sureness[0] > 0.95 and sureness[1:].max() < 0.8 and (sureness[1:] < 0.5).mean() > 0.8


def unfitted(refiner: Refiner, some: np.ndarray, depth: np.ndarray) -> tuple[Fitting, Fits]:
    """Poses (n, 4, 4) as if ICP had ended there, each from a detection of its own."""
    fitting = Fitting(refiner, depth, CAMERA, some, np.ones(len(some)), np.arange(len(some)))
    agreement, violation = evidence(refiner, some, depth)
    return fitting, Fits(some, np.arange(len(some)), agreement, violation, agreement - violation / 2 + 0.3)


def evidence(refiner: Refiner, cam_from_obj: np.ndarray, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    intrinsics = np.array([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy])
    normals = observed(depth, intrinsics)[..., 1:]
    tolerance = refine.TOLERANCE * refiner.model.diameter
    return depth_evidence(cam_from_obj, refiner.points, refiner.normals, depth, normals, intrinsics, tolerance)


def test_an_instance_is_explained_once(scene: tuple[ObjectModel, np.ndarray, np.ndarray]) -> None:
    model, pose, depth = scene
    start = disturbed(pose, np.random.default_rng(2), 6, 0.001, np.radians(2))
    found = Refiner(model).refine(depth, CAMERA, start, np.linspace(1, 0.5, 6))
    assert len(found.score) == 1


@pytest.mark.parametrize("pixels", [1, 4])
def test_a_surface_is_explained_however_many_pixels_lie_between_two_points(
    scene: tuple[ObjectModel, np.ndarray, np.ndarray], pixels: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    fine = Camera(
        CAMERA.width * pixels, CAMERA.height * pixels, CAMERA.fx * pixels, CAMERA.fy * pixels,
        (CAMERA.cx + 0.5) * pixels - 0.5, (CAMERA.cy + 0.5) * pixels - 0.5,
    )  # fmt: skip
    monkeypatch.setitem(globals(), "CAMERA", fine)
    model, pose, _ = scene
    some = np.concatenate([pose[None], disturbed(pose, np.random.default_rng(2), 6, 0.002, np.radians(4))])
    assert shares(Refiner(model), some, render(model, pose))[1:].min() > 0.8


def shares(refiner: Refiner, some: np.ndarray, depth: np.ndarray) -> np.ndarray:
    intrinsics = np.array([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy])
    tolerance, order = refine.TOLERANCE * refiner.model.diameter, np.arange(len(some))
    return explained_before(
        some, order, np.zeros(len(some), np.int64), refiner.points[None], refiner.normals[None], depth, intrinsics,
        np.array([tolerance]), np.array([refiner.spacing]),
    )  # fmt: skip


def test_a_detection_becomes_one_pose_and_tells_which_hypothesis_it_was(
    scene: tuple[ObjectModel, np.ndarray, np.ndarray],
) -> None:
    model, pose, depth = scene
    aside = pose.copy()
    aside[0, 3] += 2 * model.diameter  # over the bare floor
    upside_down = pose @ poses.from_rotation_translation(poses.from_axis_angle([1.0, 0, 0], np.pi), np.zeros(3))
    hypotheses = np.stack([aside, upside_down, pose, aside])
    found = Refiner(model).refine(depth, CAMERA, hypotheses, np.ones(4), np.array([7, 3, 3, 7]))
    assert found.hypothesis[0] == 2
    assert len(found.score) <= 2 and set(found.hypothesis[1:].tolist()) <= {0, 3}


def test_no_hypotheses_and_no_depth_are_no_trouble(scene: tuple[ObjectModel, np.ndarray, np.ndarray]) -> None:
    model, pose, depth = scene
    assert len(Refiner(model).refine(depth, CAMERA, np.zeros((0, 4, 4)), np.zeros(0)).score) == 0
    empty = Refiner(model).refine(np.zeros_like(depth), CAMERA, pose[None], np.ones(1))
    assert len(empty.score) == 0


def test_turns_keep_the_center_and_go_to_all_sides(scene: tuple[ObjectModel, np.ndarray, np.ndarray]) -> None:
    _, pose, _ = scene
    center = np.array([0.01, 0.02, -0.03])
    turned = refine.turns(np.stack([pose, pose @ pose]), center, 8, 0.3)
    assert turned.shape == (16, 4, 4)
    middle = poses.apply(turned, center[None])[:, 0]
    np.testing.assert_allclose(middle[:8], np.tile(poses.apply(pose, center[None]), (8, 1)), atol=1e-12)
    np.testing.assert_allclose(poses.rotation_angle(pose[:3, :3], turned[:8, :3, :3]), 0.3, atol=1e-9)


def plain_evidence(
    model_points: np.ndarray, normals: np.ndarray, pose: np.ndarray, depth: np.ndarray, tolerance: float
) -> tuple[float, float]:
    """Agreement and violation of one pose, in plain NumPy."""
    points, turned = poses.apply(pose, model_points), normals @ pose[:3, :3].T
    weight = -(points * turned).sum(1) / np.linalg.norm(points, axis=1)
    facing = weight > 0
    u, v = np.floor(CAMERA.project(points) + 0.5).astype(int).T
    inside = (u >= 0) & (v >= 0) & (u < CAMERA.width) & (v < CAMERA.height)
    seen = np.where(inside, depth[v.clip(0, CAMERA.height - 1), u.clip(0, CAMERA.width - 1)], 0.0)
    known, gap = facing & inside & (seen > 0), (seen - points[:, 2]) / tolerance
    slopes = observed(depth, np.array([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy]))[..., 1:]
    cosine = (slopes[v.clip(0, CAMERA.height - 1), u.clip(0, CAMERA.width - 1)] * turned).sum(1)
    agreeing = np.where(known & (abs(gap) <= 1), (1 - gap**2) * np.clip((cosine - 0.5) / 0.5, 0, None), 0.0)
    total = weight[facing].sum()
    return float((weight * agreeing).sum() / total), float(weight[known & (gap > 1)].sum() / total)


def test_the_evidence_is_that_of_a_plain_reading(scene: tuple[ObjectModel, np.ndarray, np.ndarray]) -> None:
    model, pose, depth = scene
    depth = depth.copy()
    depth[52:58, 76:84] = 0.0
    refiner = Refiner(model)
    some = np.concatenate([pose[None], disturbed(pose, np.random.default_rng(3), 20, 0.01, 0.3)])
    some[5, 0, 3] += 0.16  # beyond the image, partly
    found = evidence(refiner, some, depth)
    tolerance = refine.TOLERANCE * model.diameter
    plain = [plain_evidence(refiner.points, refiner.normals, one, depth, tolerance) for one in some]
    np.testing.assert_allclose(np.stack(found, 1), plain, atol=1e-5)
    assert found[0].max() > 0.5 and found[1].max() > 0.1


def plain_shares(refiner: Refiner, some: np.ndarray, depth: np.ndarray) -> list[float]:
    """Share of each pose's support that the poses before it explain, with sets of pixels."""
    tolerance = refine.TOLERANCE * refiner.model.diameter
    explained: set[tuple[int, int]] = set()
    shares = []
    for pose in some:
        points, normals = poses.apply(pose, refiner.points), refiner.normals @ pose[:3, :3].T
        pixels = np.floor(CAMERA.project(points) + 0.5).astype(int).tolist()
        support = [
            (u, v, point[2])
            for (u, v), point, normal in zip(pixels, points, normals, strict=True)
            if point @ normal < 0
            and 0 <= u < CAMERA.width
            and 0 <= v < CAMERA.height
            and abs(depth[v, u] - point[2]) <= tolerance
        ]
        shares.append(sum((u, v) in explained for u, v, _ in support) / len(support) if support else 1.0)
        if shares[-1] > ALREADY_EXPLAINED:
            continue
        for u, v, z in support:
            reach = max(1, round(FOOTPRINT * refiner.spacing * CAMERA.fx / z))
            window = depth[max(v - reach, 0) : v + reach + 1, max(u - reach, 0) : u + reach + 1]
            for y, x in np.argwhere(abs(window - z) <= tolerance).tolist():
                explained.add((x + max(u - reach, 0), y + max(v - reach, 0)))
    return shares


@pytest.fixture(scope="module")
def row() -> tuple[ObjectModel, np.ndarray, np.ndarray]:
    """Two wedges in one plane, and a third pose that lies across both."""
    model, turn = wedge(), poses.from_axis_angle([1.0, 0, 0], 2.9)
    places = [[-0.035, 0, 0.5], [0.035, 0, 0.5], [0.012, 0, 0.5]]
    some = np.stack([poses.from_rotation_translation(turn, place) for place in places])
    return model, some, np.minimum(render(model, some[0]), render(model, some[1]))


def test_what_is_explained_already_is_that_of_a_plain_count(row: tuple[ObjectModel, np.ndarray, np.ndarray]) -> None:
    model, some, depth = row
    refiner = Refiner(model)
    some = np.concatenate([some, disturbed(some[0], np.random.default_rng(4), 20, 0.05, 0.5)])
    some[7, 0, 3] += 1.0  # beyond the image
    some = some[[0, 2, 1, *range(3, len(some))]]
    found = shares(refiner, some, depth)
    np.testing.assert_allclose(found, plain_shares(refiner, some, depth), atol=0.03)  # rounding
    assert found[0] == 0 and found[7] == 1 and 0.1 < found[1] < ALREADY_EXPLAINED


def test_a_pixel_speaks_for_one_pose_only(row: tuple[ObjectModel, np.ndarray, np.ndarray]) -> None:
    model, some, depth = row
    fitting, fits = unfitted(Refiner(model), some, depth)
    kept = fitting.verified(fitting.judged(fits, fits))
    score = dict(zip(kept.hypothesis.tolist(), kept.score, strict=True))
    assert score.keys() >= {0, 1}
    assert min(score[0], score[1]) > 0.8 and score.get(2, 0.0) < 0.3


def test_two_poses_inside_each_other_are_never_both_believed(row: tuple[ObjectModel, np.ndarray, np.ndarray]) -> None:
    model, some, depth = row
    some = np.concatenate([some, disturbed(some[0], np.random.default_rng(4), 30, 0.03, 0.4)])
    fitting, fits = unfitted(Refiner(model, CREDULOUS), some, depth)
    finalists = fitting.judged(fits, fits)
    kept = fitting.verified(finalists)
    score = np.zeros(len(some))
    score[kept.hypothesis] = kept.score
    touching = finalists.pairs[finalists.deep > 1.0]
    assert len(touching) > 50 and (kept.score > 0.5).sum() >= 2
    assert not (score[touching] > 0.5).all(1).any()


def test_parts_in_one_bin_compete_for_what_the_image_shows(row: tuple[ObjectModel, np.ndarray, np.ndarray]) -> None:
    """A smaller box fits the front of a wedge; where the wedge explains it, the box is not believed."""
    model, some, depth = row
    small = ObjectModel.from_mesh("small", 0.8 * np.asarray(model.vertices), np.asarray(model.faces))
    judge = Judge(
        FORMAT, Regression(0.0, {"agreement": (0.5, 0.1, 2.0)}), Regression(2.0, {"explained": (0.3, 0.1, -1.0)})
    )
    boxes = some[:2].copy()
    boxes[:, 2, 3] -= 0.2 * 0.015
    wedges, smalls = unfitted(Refiner(model, judge), some[:2], depth), unfitted(Refiner(small, judge), boxes, depth)
    fittings, finalists = zip(
        *((fitting, fitting.judged(fits, fits)) for fitting, fits in (wedges, smalls)), strict=True
    )
    alone = smalls[0].verified(finalists[1])
    assert len(alone.score) == 2 and alone.score.min() > 0.5
    of_wedges, of_smalls = settled(fittings, finalists)
    assert len(of_wedges.score) == 2 and of_wedges.score.min() > 0.5
    assert (of_smalls.score > 0.5).sum() == 0
    swapped = settled(fittings[::-1], finalists[::-1])[::-1]  # in whatever order the parts are given
    for found, other in zip((of_wedges, of_smalls), swapped, strict=True):
        np.testing.assert_array_equal(found.hypothesis, other.hypothesis)
        np.testing.assert_allclose(found.score, other.score)


def test_the_best_of_each_group_are_those_of_a_plain_loop() -> None:
    rng = np.random.default_rng(6)
    evidence, group = rng.standard_normal(60), rng.integers(0, 9, 60)
    for count in (1, 2, 9):
        plain = {
            int(row)
            for one in set(group.tolist())
            for row in sorted(np.nonzero(group == one)[0], key=lambda row: -evidence[row])[:count]
        }
        assert sorted(refine._best_of_each(evidence, group, count).tolist()) == sorted(plain)


def plain_step(
    pose: np.ndarray, refiner: Refiner, depth: np.ndarray, normals: np.ndarray, reach: float
) -> tuple[np.ndarray, int]:
    """One step of ICP as the formulas have it, in NumPy, and how many points drew."""
    size, center = refiner.model.diameter, refiner.model.centroid
    turned = (refiner.points - center) @ pose[:3, :3].T
    middle = pose[:3, :3] @ center + pose[:3, 3]
    where, facing = turned + middle, refiner.normals @ pose[:3, :3].T
    u, v = np.floor(CAMERA.project(where) + 0.5).astype(int).T
    u, v = np.clip(u, 0, CAMERA.width - 1), np.clip(v, 0, CAMERA.height - 1)
    seen, slope = depth[v, u], normals[v, u]
    drawn = ((facing * where).sum(1) < 0) & (seen > 0) & (np.abs(seen - where[:, 2]) <= reach)
    drawn &= (slope * facing).sum(1) >= LEAST_NORMAL_COSINE
    surface = CAMERA.point_map(depth)[v, u]
    residual = ((surface - where) * slope).sum(1)[drawn] / size
    weight = 1.0 / (1.0 + (residual * size / (0.3 * reach)) ** 2)
    rows = np.concatenate([np.cross(turned, slope) / size, slope], 1)[drawn]
    a = (weight[:, None] * rows).T @ rows
    step = np.linalg.solve(a + DAMPING * np.trace(a) * np.eye(6), (weight[:, None] * rows).T @ residual)
    turn = poses.from_axis_angle(step[:3], np.linalg.norm(step[:3]))
    rotation = turn @ pose[:3, :3]
    return poses.from_rotation_translation(rotation, middle + step[3:] * size - rotation @ center), int(drawn.sum())


def test_the_kernel_takes_the_step_that_the_formulas_take(scene: tuple[ObjectModel, np.ndarray, np.ndarray]) -> None:
    model, pose, depth = scene
    refiner, intrinsics = Refiner(model), np.array([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy])
    seen, reach = observed(depth, intrinsics), 0.1 * model.diameter
    starts = disturbed(pose, np.random.default_rng(3), 10, 0.002, np.radians(6))
    moved = starts.copy()
    icp(
        moved, refiner.points - model.centroid, refiner.normals, model.centroid, seen, intrinsics,
        np.array([reach]), model.diameter,
    )  # fmt: skip
    for start, one in zip(starts, moved, strict=True):
        wanted, drawn = plain_step(start, refiner, depth, seen[..., 1:], reach)
        assert drawn > 50
        np.testing.assert_allclose(one, wanted, atol=1e-6)
        assert np.abs(one - start).max() > 1e-4
