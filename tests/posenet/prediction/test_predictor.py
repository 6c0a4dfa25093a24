"""Prediction takes what users have, and says in one sentence what it cannot take."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from evalkit.datasets.documents import read_predictions
from evalkit.datasets.shard_folder import ShardDataset
from evalkit.depth.images import read_depth
from evalkit.depth.sources import open_source
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from posenet.commands.cli import main
from posenet.config import preset
from posenet.models.model_file import load_model, save_model
from posenet.network.pose_network import PoseNetwork
from posenet.prediction.predictor import Predictor

Command = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="module")
def predictor(run_folder: Path) -> Predictor:
    return Predictor.load(run_folder, "cpu")


def test_poses_come_sorted_in_front_of_the_camera(predictor: Predictor, debug_shards: Path) -> None:
    view = ShardDataset(debug_shards)[0]
    found = predictor.predict(view.depth, view.camera)
    assert len(found.score) > 0
    assert (np.diff(found.score) <= 0).all() and found.score.min() >= 0 and found.score.max() <= 1
    assert (predictor.model.centers(found.cam_from_obj)[:, 2] > 0).all()


def test_a_batch_gives_what_single_images_give(predictor: Predictor, debug_shards: Path) -> None:
    dataset = ShardDataset(debug_shards)
    depths = [dataset[i].depth for i in range(2)]
    together = predictor.predict_batch(depths, dataset.header.camera)
    alone = [predictor.predict(depth, dataset.header.camera) for depth in depths]
    for a, b in zip(together, alone, strict=True):
        assert abs(len(a.score) - len(b.score)) <= 5  # bf16 sums in another order near the detector's threshold


def test_holes_and_nan_are_no_return(predictor: Predictor, debug_shards: Path) -> None:
    view = ShardDataset(debug_shards)[0]
    empty = predictor.predict(np.zeros_like(view.depth), view.camera)
    assert len(empty.score) == 0
    holed, broken = view.depth.copy(), view.depth.copy()
    holed[:20], broken[:20] = 0.0, np.nan
    a, b = predictor.predict(holed, view.camera), predictor.predict(broken, view.camera)
    np.testing.assert_array_equal(a.cam_from_obj, b.cam_from_obj)


def test_millimeters_read_as_meters_are_refused(predictor: Predictor, debug_shards: Path) -> None:
    view = ShardDataset(debug_shards)[0]
    with pytest.raises(InputError, match="--depth-unit"):
        predictor.predict(view.depth * 1000, view.camera)


def test_an_image_of_another_size_than_its_camera_is_refused(predictor: Predictor, debug_shards: Path) -> None:
    view = ShardDataset(debug_shards)[0]
    with pytest.raises(InputError, match="pixels but the camera says"):
        predictor.predict(view.depth[:50], view.camera)


def test_refinement_returns_fewer_poses_each_once(run_folder: Path, predictor: Predictor, debug_shards: Path) -> None:
    view = ShardDataset(debug_shards)[0]
    refined = Predictor.load(run_folder, "cpu", refine=True).predict(view.depth, view.camera)
    assert 0 < len(refined.score) < len(predictor.predict(view.depth, view.camera).score)
    assert (np.diff(refined.score) <= 0).all()


def test_two_predictors_on_one_network_predict_what_each_does_alone(run_folder: Path, debug_shards: Path) -> None:
    view = ShardDataset(debug_shards)[0]
    network = load_model(run_folder).network
    network.train()
    alone = [Predictor.load(run_folder, "cpu", refine).predict(view.depth, view.camera) for refine in (False, True)]
    sharing = [Predictor(network, refine=refine) for refine in (False, True)]
    for _ in range(2):
        for predictor, wanted in zip(sharing, alone, strict=True):
            found = predictor.predict(view.depth, view.camera)
            np.testing.assert_array_equal(found.cam_from_obj, wanted.cam_from_obj)
            np.testing.assert_array_equal(found.score, wanted.score)
    assert network.training and not network.bf16


def test_poses_of_one_detection_have_one_number_and_one_box(run_folder: Path, debug_shards: Path) -> None:
    view = ShardDataset(debug_shards)[0]
    alone, refined = (
        Predictor.load(run_folder, "cpu", bool(refine)).predict(view.depth, view.camera) for refine in (0, 1)
    )
    for number in np.unique(alone.detection):
        assert len(np.unique(alone.boxes[alone.detection == number], axis=0)) == 1
    assert np.bincount(alone.detection).max() > 1
    assert len(np.unique(refined.detection)) == len(refined.detection) > 0


def test_labels_of_the_shards_are_not_read(
    run_folder: Path, debug_shards: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from evalkit.datasets.shard_reader import ShardReader
    from posenet.commands.predict import predict

    def forbidden(*_: object) -> None:
        raise AssertionError("prediction looked at the labels")

    monkeypatch.setattr(ShardReader, "labels", forbidden)
    monkeypatch.setattr(ShardReader, "__getitem__", forbidden)
    predict(run_folder, open_source(debug_shards), tmp_path / "preds.json", device="cpu", max_images=2)
    assert len(read_predictions(tmp_path / "preds.json").images) == 2


def write_image(view: object, folder: Path, suffix: str) -> Path:
    path = folder / f"depth{suffix}"
    depth = view.depth  # type: ignore[attr-defined]
    if suffix == ".npy":
        np.save(path, depth)
    elif suffix == ".tiff":
        cv2.imwrite(str(path), depth)
    else:
        cv2.imwrite(str(path), np.round(depth * 1000).astype(np.uint16))
    return path


@pytest.mark.parametrize("suffix", [".png", ".tiff", ".npy"])
def test_every_kind_of_depth_image_reads_as_meters(debug_shards: Path, tmp_path: Path, suffix: str) -> None:
    view = ShardDataset(debug_shards)[0]
    path = write_image(view, tmp_path, suffix)
    depth = read_depth(path, 0.001 if suffix == ".png" else None)
    assert np.abs(depth - view.depth).max() <= 0.00051


def test_one_image_on_the_command_line_gives_poses_and_a_picture(
    run_folder: Path, debug_shards: Path, tmp_path: Path, run_command: Command
) -> None:
    view = ShardDataset(debug_shards)[0]
    image = write_image(view, tmp_path, ".png")
    camera = tmp_path / "camera.json"
    camera.write_text(json.dumps(view.camera.to_json()))
    done = run_command(
        "posenet", "predict", run_folder, image, "--camera", camera, "--depth-unit", 0.001, "-o",
        tmp_path / "preds.json", "--picture", tmp_path / "out.png",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert len(read_predictions(tmp_path / "preds.json").images[0].score) > 0
    picture = cv2.imread(str(tmp_path / "out.png"))
    assert picture is not None and picture.std() > 5


def test_a_folder_of_images_gives_what_its_shards_give(
    run_folder: Path, debug_shards: Path, tmp_path: Path, run_command: Command
) -> None:
    """One command for both, with every ablation at once."""
    dataset = ShardDataset(debug_shards)
    folder, camera = tmp_path / "images", tmp_path / "camera.json"
    folder.mkdir()
    camera.write_text(json.dumps(dataset.header.camera.to_json()))
    for view in dataset:
        cv2.imwrite(str(folder / f"{view.image_id}.png"), view.depth_raw)
    ablations = ("--no-registration", "--no-offset", "--hypotheses", 2)
    described = ("--camera", camera, "--depth-unit", dataset.header.depth_unit)
    found = []
    for number, source in enumerate([(debug_shards,), (folder, *described)]):
        out = tmp_path / f"{number}.json"
        done = run_command("posenet", "predict", run_folder, *source, *ablations, "-o", out)
        assert done.returncode == 0, done.stderr
        found.append(read_predictions(out).images)
    assert [image.id for image in found[0]] == [image.id for image in found[1]] == [view.image_id for view in dataset]
    for a, b in zip(*found, strict=True):
        np.testing.assert_allclose(a.cam_from_obj, b.cam_from_obj, atol=1e-4)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["predict", "nowhere", "{shards}"], "nowhere"),
        (["predict", "{run}", "nowhere"], "nowhere"),
        (["predict", "{run}", "{text}", "--camera", "{camera}", "--depth-unit", "0.001"], "text.png"),
        (["predict", "{run}", "{image}"], "--camera"),
        (["predict", "{run}", "{image}", "--camera", "{camera}"], "--depth-unit"),
        (["predict", "{run}", "{image}", "--camera", "{camera}", "--depth-unit", "1.0"], "--depth-unit"),
        (["predict", "{run}", "{image}", "--camera", "{text}", "--depth-unit", "0.001"], "text.png"),
        (["info", "{text}"], "text.png"),
        (["fit", "{run}", "-o", "{out}"], "shards"),
        (["fit", "{shards}", "-o", "{out}", "--device", "abacus"], "--device"),
    ],
)
def test_wrong_input_gets_one_sentence_and_exit_code_2(
    run_folder: Path, debug_shards: Path, tmp_path: Path, run_command: Command, arguments: list[str], says: str
) -> None:
    view = ShardDataset(debug_shards)[0]
    text, camera = tmp_path / "text.png", tmp_path / "camera.json"
    text.write_text("no picture")
    camera.write_text(json.dumps(view.camera.to_json()))
    image = write_image(view, tmp_path, ".png")
    places = dict(run=run_folder, shards=debug_shards, text=text, camera=camera, image=image, out=tmp_path / "out")  # noqa: C408
    done = run_command("posenet", *[argument.format(**places) for argument in arguments])
    assert done.returncode == 2
    assert says in done.stderr and "Traceback" not in done.stderr
    assert len([line for line in done.stderr.splitlines() if line.startswith("Error:")]) == 1


def test_an_unknown_camera_field_is_named(tmp_path: Path) -> None:
    path = tmp_path / "camera.json"
    path.write_text(json.dumps({"width": 10, "height": 10, "fx": 1.0, "fy": 1.0, "cx": 1.0}))
    with pytest.raises(InputError, match="'cy'"):
        Camera.load(path)


def test_parts_in_one_bin_are_predicted_together_and_each_surface_is_one_parts(
    run_folder: Path, debug_shards: Path, tmp_path: Path
) -> None:
    """The twin of a part, named second, finds nothing that the part has not explained."""
    trained = load_model(run_folder)
    trained.network.model = replace(trained.network.model, name="its twin")
    save_model(tmp_path / "twin.pt", trained.network, trained.record)
    words = ["predict", run_folder, debug_shards, "--max-images", "2", "--device", "cpu", "-o"]
    for more in (["alone.json", "--refine"], ["both.json", "--also", tmp_path / "twin.pt"]):
        done = CliRunner().invoke(main, [str(word) for word in [*words, tmp_path / more[0], *more[1:]]])
        assert done.exit_code == 0, done.output
    alone, both, twin = (read_predictions(tmp_path / f"{n}.json") for n in ("alone", "both", "both-its_twin"))
    assert twin.object_name == "its twin"
    for one, first, second in zip(alone.images, both.images, twin.images, strict=True):
        np.testing.assert_allclose(first.cam_from_obj, one.cam_from_obj)
        assert len(one.score) > 0 and len(second.score) == 0


@pytest.mark.parametrize("more", [["--also", "{run}"], ["--also", "{run}", "--no-refine"], ["--also", "nowhere"]])
def test_models_that_cannot_compete_are_refused(
    more: list[str], run_folder: Path, debug_shards: Path, tmp_path: Path
) -> None:
    words = [word.replace("{run}", str(run_folder)) for word in more]
    out = ["-o", str(tmp_path / "preds.json")]
    done = CliRunner().invoke(main, ["predict", str(run_folder), str(debug_shards), *words, *out])
    assert done.exit_code == 2 and done.output.count("Error") == 1 and not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_written_is_refused_before_the_work(
    debug_shards: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    header = ShardDataset(debug_shards).header
    save_model(tmp_path / "model.pt", PoseNetwork(preset("debug"), header.object, (0.3, 0.6), header.camera), {})

    def never(*_: object) -> None:
        raise AssertionError("predicted all the same")

    monkeypatch.setattr("posenet.commands.predict.predict_together", never)
    file = tmp_path / "file"
    file.write_text("not a folder")
    for words in (["-o", file / "preds.json"], ["-o", tmp_path / "preds.json", "--picture", file / "a.png"]):
        done = CliRunner().invoke(main, ["predict", str(tmp_path / "model.pt"), str(debug_shards), *map(str, words)])
        assert done.exit_code == 2, done.output
        assert str(file) in done.output and "Traceback" not in done.output


def test_predictions_are_written_as_bops_results_with_the_object_numbered_by_the_user(
    run_folder: Path, debug_shards: Path, tmp_path: Path
) -> None:
    from evalkit.adapters.bop import results
    from posenet.commands.predict import predict

    predict(run_folder, open_source(debug_shards), tmp_path / "preds.json", device="cpu", max_images=2)
    predict(run_folder, open_source(debug_shards), tmp_path / "results.csv", device="cpu", max_images=2, object_id=7)
    ours, theirs = (
        {tuple(map(int, image.id.split("-"))): image for image in found.images if len(image.score)}  # scene, image
        for found in (
            read_predictions(tmp_path / "preds.json"),
            results.read_predictions(tmp_path / "results.csv", object_id=7),
        )
    )
    assert ours and set(ours) == set(theirs)
    for name, image in ours.items():
        np.testing.assert_allclose(theirs[name].cam_from_obj, image.cam_from_obj, atol=1e-9)
    with pytest.raises(InputError, match="--object-id"):
        predict(run_folder, open_source(debug_shards), tmp_path / "none.csv", device="cpu")
    assert not (tmp_path / "none.csv").exists()


def test_results_on_an_exported_set_are_of_its_models_whose_origin_is_moved(
    run_folder: Path, debug_shards: Path, tmp_path: Path, run_command: Callable[..., Any]
) -> None:
    from evalkit.adapters.bop import results
    from evalkit.adapters.bop.dataset import read_ground_truth
    from posenet.commands.predict import predict

    exported = tmp_path / "set"
    assert run_command("simgen", "export", "bop", debug_shards, exported).returncode == 0
    source = open_source(exported / "test")
    assert source.truth_options == ("--mesh-frame",)
    predict(run_folder, source, tmp_path / "preds.json", device="cpu", max_images=1)
    predict(run_folder, source, tmp_path / "results.csv", device="cpu", max_images=1, object_id=1)
    of_mesh = next(image for image in read_predictions(tmp_path / "preds.json").images if len(image.score))
    of_bop = results.read_predictions(tmp_path / "results.csv", object_id=1).images[0]
    models = [read_ground_truth(exported / "test", mesh_frame=frame).object for frame in (True, False)]
    assert np.linalg.norm(models[0].centroid - models[1].centroid) > 1e-3
    centers = [model.centers(image.cam_from_obj) for model, image in zip(models, (of_mesh, of_bop), strict=True)]
    np.testing.assert_allclose(centers[0], centers[1], atol=1e-6)
