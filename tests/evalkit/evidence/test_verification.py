"""Verdicts on poses agree with the truth, whatever the depth images' files look like; nobody tells them the truth."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from evalkit.commands.cli import main
from evalkit.datasets.documents import PredictionImage, Predictions, write_predictions
from evalkit.datasets.ground_truth import read_ground_truth
from evalkit.datasets.shard_folder import ShardDataset
from evalkit.depth.noise import depth_noise
from evalkit.depth.sources import DepthSource, open_source
from evalkit.errors import InputError
from evalkit.evidence.ray_tracer import RayTracer
from evalkit.evidence.verdict import PoseEvidence, Verdict, Verifier
from evalkit.evidence.verification import Verification, verify, verify_image
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.meshes.write import write_obj
from evalkit.objects.model import ObjectModel
from evalkit.scoring.distances import Sym

CAMERA = Camera(160, 120, 150.0, 150.0, 80.0, 60.0)
BOX = np.array([[x, y, z] for x in (-0.03, 0.03) for y in (-0.02, 0.02) for z in (-0.01, 0.01)])
FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
     [1, 5, 7], [1, 7, 3]]
)  # fmt: skip

PART = ("--units", "m", "--symmetry", "none", "--mesh")


def box() -> ObjectModel:
    return ObjectModel.from_mesh("box", BOX, FACES)


def at(x: float, y: float, z: float) -> np.ndarray:
    return poses.from_rotation_translation(poses.from_axis_angle([1.0, 0.4, 0.2], 0.7), [x, y, z])


def scene(*cam_from_obj: np.ndarray, floor: float = 0.6) -> np.ndarray:
    """The depth image (height, width) of boxes over a floor."""
    depth = np.full((CAMERA.height, CAMERA.width), floor, np.float32)
    tracer = RayTracer(box())
    for pose in cam_from_obj:
        seen = tracer.trace(pose, CAMERA)
        depth[seen.v, seen.u] = np.minimum(depth[seen.v, seen.u], seen.depth)
    return depth


def examined(depth: np.ndarray, *cam_from_obj: np.ndarray) -> list[PoseEvidence]:
    return Verifier(box()).examine(depth, CAMERA, np.stack(cam_from_obj))


@pytest.mark.parametrize("z", [0.3, 3.0, 300.0])
def test_a_face_toward_the_camera_is_as_deep_as_it_is_however_far_away(z: float) -> None:
    pose, camera = (
        poses.from_rotation_translation(np.eye(3), [0.0, 0.0, z]),
        replace(CAMERA, fx=500.0 * z, fy=500.0 * z),
    )
    traced = RayTracer(box()).trace(pose, camera)
    assert len(traced) > 500
    middle = np.abs(traced.u - CAMERA.cx) + np.abs(traced.v - CAMERA.cy) < 10
    np.testing.assert_allclose(traced.depth[middle], z - 0.01, atol=1e-6 * max(z, 1.0))
    np.testing.assert_allclose(traced.normal[middle], [[0.0, 0.0, -1.0]] * middle.sum(), atol=1e-6)


def test_faces_wound_either_way_look_toward_the_camera() -> None:
    model = box()
    flipped = replace(model, faces=model.mesh[1][:, ::-1])
    one, other = (RayTracer(some).trace(at(0, 0, 0.4), CAMERA) for some in (model, flipped))
    np.testing.assert_allclose(one.normal, other.normal, atol=1e-9)


def test_the_pose_that_made_the_image_is_verified_and_another_contradicted() -> None:
    here, there = at(-0.05, 0.0, 0.45), at(0.06, 0.02, 0.45)
    found = examined(scene(here), here, there)
    assert [part.verdict for part in found] == [Verdict.VERIFIED, Verdict.CONTRADICTED]
    assert found[0].agreeing > 0.95 and found[0].moved < 1e-4
    assert found[1].through > 0.9


@pytest.mark.parametrize(("tilt", "above"), [(0.05, 0.005), (0.1, 0.008), (0.2, 0.005)])
def test_a_thin_part_on_its_edge_is_verified_with_another_lying_across_it(tilt: float, above: float) -> None:
    """Few of its pixels hold the pose, and those of the part across must not draw it away from what it explains."""
    cube, camera = np.sign(BOX), Camera(320, 240, 300.0, 300.0, 160.0, 120.0)
    plates = [cube * [0.03, 0.02, 0.002], cube * [0.002, 0.02, 0.025] + [-0.028, 0.0, 0.025]]
    model = ObjectModel.from_mesh("bracket", np.concatenate(plates), np.concatenate([FACES, FACES + 8]))
    standing = poses.from_axis_angle([1.0, 0.3, 0.2], tilt) @ poses.from_axis_angle([1.0, 0.0, 0.0], np.pi / 2)
    on_edge = poses.from_rotation_translation(standing, [0.0, 0.0, 0.5])
    across = poses.from_rotation_translation(np.eye(3), [0.03, 0.0, 0.478 - above])
    depth = np.full((camera.height, camera.width), 0.54, np.float32)
    for pose in (on_edge, across):
        seen = RayTracer(model).trace(pose, camera, most=10**6)
        depth[seen.v, seen.u] = np.minimum(depth[seen.v, seen.u], seen.depth)
    (part,) = Verifier(model).examine(depth, camera, on_edge[None])
    assert part.verdict is Verdict.VERIFIED, part.reason


@pytest.mark.parametrize("turn", [0.0, 0.5])
def test_a_face_in_the_plane_of_a_floor_or_a_wall_verifies_nothing(turn: float) -> None:
    """A box sunk into the floor up to its top explains all that is measured, but so it does anywhere on the floor."""
    pose = poses.from_rotation_translation(poses.from_axis_angle([1.0, 0.0, 0.0], turn), [0.0, 0.0, 0.45])
    on_plane, normal = pose[:3, 3] - 0.01 * pose[:3, 2], pose[:3, 2]
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], -1)
    floor = (normal @ on_plane / (rays @ normal)).astype(np.float32)
    (sunk,) = examined(floor, pose)
    assert sunk.verdict is Verdict.UNDECIDED and "goes on beyond" in sunk.reason
    lying, seen = floor + np.float32(0.02), RayTracer(box()).trace(pose, CAMERA)
    lying[seen.v, seen.u] = seen.depth
    assert examined(lying, pose)[0].verdict is Verdict.VERIFIED


def test_a_pose_is_right_within_a_tenth_of_the_diameter_as_sym_has_it() -> None:
    """Its surface may be off by several times what a depth camera is; the fit tells by how much."""
    model, pose = box(), at(0.0, 0.0, 0.45)
    depth, sym = scene(pose), Sym(box())
    for share, verdict in ((0.08, Verdict.VERIFIED), (0.115, Verdict.CONTRADICTED)):
        off = pose.copy()
        off[2, 3] -= share * model.diameter
        (part,) = examined(depth, off)
        assert part.verdict is verdict, part.reason
        assert abs(part.moved - sym(off[None], pose[None])[0]) < 0.01 * model.diameter


def test_what_is_hidden_or_did_not_return_says_nothing() -> None:
    pose = at(0.0, 0.0, 0.45)
    depth = scene(pose)
    hidden, lost = np.where(depth < 0.55, 0.3, depth).astype(np.float32), np.where(depth < 0.55, 0, depth)
    for image, share in ((hidden, "hidden"), (lost, "missing")):
        (part,) = examined(image, pose)
        assert part.verdict is Verdict.UNDECIDED
        assert getattr(part, share) > 0.9
    half = depth.copy()
    half[:, :80] = 0.0
    assert examined(half, pose)[0].verdict is Verdict.VERIFIED


def test_what_lies_outside_the_image_or_behind_the_camera_is_contradicted() -> None:
    depth = scene()
    for pose in (at(5.0, 0.0, 0.45), at(0.0, 0.0, -0.45), at(0.0, 0.0, 0.005)):
        assert examined(depth, pose)[0].verdict is Verdict.CONTRADICTED


def test_of_two_poses_of_one_part_one_counts() -> None:
    pose, other = at(0.0, 0.0, 0.45), at(0.001, 0.0, 0.45)
    image = PredictionImage("a", np.stack([other, pose]), np.array([0.7, 0.9]))
    found = verify_image(image, scene(pose), CAMERA, Verifier(box()))
    assert found.duplicate_of == [None, 0]
    whole = Verification([found], 0.5, box())
    assert (whole.count(Verdict.VERIFIED), whole.duplicates, whole.precision) == (1, 1, 0.5)


def test_noise_is_measured_where_the_surface_is_smooth() -> None:
    noise = np.random.default_rng(0).normal(0, 0.002, (120, 160))
    assert 0.0015 < depth_noise((scene(at(0, 0, 0.45)) + noise).astype(np.float32)) < 0.0025
    assert depth_noise(np.zeros((10, 10), np.float32)) == 0.0


def perturbed(truth: np.ndarray, model: ObjectModel, rng: np.random.Generator, share: float) -> np.ndarray:
    """Poses (n, 4, 4) turned and moved by up to `share` of the diameter."""
    turn = poses.from_axis_angle(rng.standard_normal((len(truth), 3)), rng.uniform(0, 2.2 * share, len(truth)))
    center = model.centers(truth)
    shift = rng.standard_normal((len(truth), 3))
    shift *= share * model.diameter * rng.random((len(truth), 1)) / np.linalg.norm(shift, axis=1, keepdims=True)
    moved = poses.from_rotation_translation(turn, center + shift - np.einsum("nij,nj->ni", turn, center))
    return moved @ truth


def test_verdicts_agree_with_the_truth_of_simulated_scenes(debug_shards: Path) -> None:
    source, truth, rng = open_source(debug_shards), read_ground_truth(debug_shards), np.random.default_rng(0)
    verifier, sym = Verifier(truth.object), Sym(truth.object)
    agreed = []
    for number, image in enumerate(truth.images):
        seen = image.cam_from_obj[image.visibility >= 0.4]
        given = np.concatenate([perturbed(seen, truth.object, rng, share) for share in (0.0, 0.06, 0.3, 0.8)])
        found = verifier.examine(source.depth(number), source.cameras[number], given)
        for pose, part in zip(given, found, strict=True):
            off = sym(np.repeat(pose[None], len(image.visibility), 0), image.cam_from_obj).min()
            if part.verdict is not Verdict.UNDECIDED:
                agreed.append((off <= truth.object.threshold) == (part.verdict is Verdict.VERIFIED))
    assert len(agreed) > 40
    assert np.mean(agreed) >= 0.98


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two images in millimeters whose holes are 65535, the camera, the mesh, and a right and a wrong pose on each."""
    right, wrong = at(-0.05, 0.0, 0.45), at(0.06, 0.02, 0.45)
    for name in ("a", "b"):
        raw = np.round(scene(right) * 1000).astype(np.uint16)
        raw[:40] = 65535
        cv2.imwrite(str(tmp_path / f"{name}.png"), raw)
    (tmp_path / "camera.json").write_text(json.dumps(CAMERA.to_json()))
    write_obj(tmp_path / "part.obj", BOX, FACES)
    images = [PredictionImage(name, np.stack([right, wrong]), np.array([0.9, 0.8])) for name in ("a", "b")]
    write_predictions(tmp_path / "preds.json", Predictions({"name": "box", "diameter": box().diameter}, images))
    return tmp_path


def test_a_folder_of_images_is_verified_as_it_is_predicted_on(folder: Path) -> None:
    words = ["verify", str(folder / "preds.json"), str(folder), *PART, str(folder / "part.obj")]
    words += ["--depth-unit", "0.001", "--json", str(folder / "verdicts.json")]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 0, done.output
    for line in ("verified      2 instances", "contradicted  2", "precision     0.500", "a: hypothesis 1, scored 0.80"):
        assert line in done.output
    assert "65535" in done.output
    document = json.loads((folder / "verdicts.json").read_text())
    assert document["format"] == "binpose-verification/1"
    assert (document["verified"], document["contradicted"], document["precision"]) == (2, 2, 0.5)
    assert [row["verdict"] for row in document["poses_by_image"]["a"]] == ["verified", "contradicted"]


def test_every_kind_of_reading_serves_verification(folder: Path) -> None:
    depth = scene(at(-0.05, 0.0, 0.45))
    along_ray = np.linalg.norm(CAMERA.point_map(depth), axis=-1)
    kinds = [
        (np.rot90(depth, 1), ["--rotate", "90"]),
        (along_ray, ["--depth-along", "ray"]),
        (depth * 1000, ["--depth-unit", "0.001"]),
        (np.where(depth < 0.5, depth, 9.0), ["--no-return", "9"]),
    ]
    for values, options in kinds:
        for name in ("a", "b"):
            (folder / f"{name}.png").unlink(missing_ok=True)
            np.save(folder / f"{name}.npy", values.astype(np.float32))
        words = ["verify", folder / "preds.json", folder, *PART, folder / "part.obj", *options]
        done = CliRunner().invoke(main, list(map(str, words)))
        assert "verified      2 instances" in done.output, (options, done.output)


def test_shards_need_no_mesh(debug_shards: Path) -> None:
    source, truth = open_source(debug_shards), read_ground_truth(debug_shards)
    image = truth.images[0]
    predictions = Predictions("", [PredictionImage(image.id, image.cam_from_obj, image.visibility)])
    assert source.model is not None
    found = verify(predictions, source, source.model, min_score=0.5)
    assert found.count(Verdict.VERIFIED) == (image.visibility >= 0.5).sum()
    assert len(ShardDataset(debug_shards)) == len(source.names)


def test_what_cannot_be_verified_is_refused_in_one_sentence(folder: Path) -> None:
    write_obj(folder / "large.obj", 3 * BOX, FACES)
    images = [PredictionImage("c", at(0, 0, 0.4)[None], np.ones(1))]
    write_predictions(folder / "others.json", Predictions("box", images))
    write_predictions(folder / "world.json", Predictions("box", [replace(images[0], id="a")], "world"))
    part = [*PART, str(folder / "part.obj")]
    mesh = [*part, "--depth-unit", "0.001"]
    refusals: list[tuple[str, list[str], str]] = [
        ("preds.json", ["--depth-unit", "0.001"], "give --mesh"),
        ("preds.json", ["--units", "mm", "--depth-unit", "0.001"], "give --mesh"),
        ("preds.json", [*PART, str(folder / "large.obj"), "--depth-unit", "0.001"], "mm across"),
        ("others.json", mesh, "image 'c' is not among"),
        ("world.json", mesh, "world's frame"),
        ("preds.json", part, "--depth-unit 0.001"),
        ("absent.json", mesh, r"absent.json"),
    ]
    for preds, options, says in refusals:
        done = CliRunner().invoke(main, ["verify", str(folder / preds), str(folder), *options])
        assert done.exit_code == 2, done.output
        assert says in done.output and done.output.rstrip().count("Error") == 1, done.output


def test_the_source_of_an_image_cleans_its_depth() -> None:
    raw = scene().astype(np.float64)
    raw[0, :4] = [np.nan, np.inf, -1.0, 0.0]
    source = DepthSource(Path("somewhere"), ["a"], [CAMERA], lambda _: raw.astype(np.float32))
    assert (source.depth(0)[0, :4] == 0).all()
    with pytest.raises(InputError, match=r"image 'a' is 160 x 120"):
        DepthSource(Path("somewhere"), ["a"], [replace(CAMERA, width=99)], source.read).depth(0)
