"""The page on file formats names every field that the code writes."""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path

import h5py
import numpy as np

from evalkit.datasets.documents import (
    GroundTruth,
    GroundTruthImage,
    PredictionImage,
    Predictions,
    write_ground_truth,
    write_predictions,
)
from evalkit.datasets.scene import Instances, View
from evalkit.datasets.shard_folder import read_dataset_file, write_dataset_file
from evalkit.datasets.shard_format import INSTANCE_DTYPES, INSTANCE_SHAPES, ShardHeader
from evalkit.datasets.shard_writer import ShardWriter
from evalkit.evidence.verdict import PoseEvidence, Verdict
from evalkit.evidence.verification import Verification, VerifiedImage
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
CAMERA = Camera(4, 3, 4.0, 4.0, 1.5, 1.0)


def chapter(anchor: str) -> set[str]:
    """All that stands as code in the first column of a chapter's tables."""
    text = PAGE.split(f"{{#{anchor}}}")[1].split("\n## ")[0]
    rows = [row.split("|")[1] for row in text.splitlines() if row.startswith("|")]
    return {name for row in rows for name in re.findall(r"`([^`]+)`", row)}


def box() -> ObjectModel:
    vertices = np.array([[x, y, z] for x in (0, 1) for y in (0, 2) for z in (0, 3)], float) / 100
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6],
             [0, 6, 4], [1, 5, 7], [1, 7, 3]]  # fmt: skip
    return ObjectModel.from_mesh("box", vertices, faces)


def test_the_chapter_on_shards_names_every_dataset_and_attribute(tmp_path: Path) -> None:
    rows = {name: np.zeros((1, *INSTANCE_SHAPES.get(name, ())), kind) for name, kind in INSTANCE_DTYPES.items()}
    image = np.zeros((3, 4), np.uint16)
    view = View(CAMERA, image, 1e-4, image, np.eye(4), Instances(**rows), 0, 0, image)
    with ShardWriter(tmp_path / "shard-00000.h5", ShardHeader(CAMERA, 1e-4, box()), 1, keep_ideal=True) as writer:
        writer.append(view)
    written: set[str] = set()
    with h5py.File(tmp_path / "shard-00000.h5") as file:
        file.visititems(lambda name, item: written.add(name) if isinstance(item, h5py.Dataset) else None)
        written |= set(file.attrs)
    assert written <= chapter("shard") <= written | {"json/…"}


def test_the_chapter_on_datasets_names_every_field(tmp_path: Path) -> None:
    write_dataset_file(tmp_path, ShardHeader(CAMERA, 1e-4, box()), [])
    assert set(read_dataset_file(tmp_path)) == chapter("dataset")


def test_the_chapters_on_cameras_and_objects_name_every_field() -> None:
    assert set(CAMERA.to_json()) == chapter("camera")
    assert set(box().to_json()) == chapter("object")


def test_the_chapters_on_documents_name_every_field(tmp_path: Path) -> None:
    pose, one = np.eye(4)[None], np.ones(1)
    truth = GroundTruth(box(), [GroundTruthImage("a", CAMERA, pose, one, one)], share="geometric")
    write_ground_truth(tmp_path / "gt.json", truth)
    write_predictions(tmp_path / "preds.json", Predictions("box", [PredictionImage("a", pose, one)]))
    for name, rows, anchor in (("gt.json", "instances", "gt"), ("preds.json", "hypotheses", "preds")):
        document = json.loads((tmp_path / name).read_text(encoding="utf-8"))
        image = document["images"][0]
        fields = set(document) | {f"images[].{key}" for key in image}
        fields |= {f"images[].{rows}[].{key}" for key in image[rows][0]}
        assert fields == chapter(anchor) | {"images"}


def test_the_chapter_on_verdicts_names_every_field() -> None:
    pose, one = np.eye(4)[None], np.ones(1)
    evidence = PoseEvidence(Verdict.VERIFIED, "", 1.0, 0.0, 0.0, 0.0, 0.0, pose[0], np.zeros(0, int), 1)
    image = VerifiedImage("a", pose, one, np.zeros(1, int), [evidence], [None])
    document = Verification([image], 0.5, box()).to_json()
    fields = set(document) - {"poses_by_image"} | {"inputs"}
    fields |= {f"poses_by_image.ID[].{key}" for key in document["poses_by_image"]["a"][0]}
    assert fields == chapter("verification")


def test_the_chapters_on_models_and_runs_name_every_key() -> None:
    assert keys_of("posenet/models/model_file.py", "save_model") == chapter("model")
    run = keys_of("posenet/training/train.py", "_identity") - {"sha256", "shards"}
    run |= keys_of("posenet/training/train.py", "_length")
    assert run | {"format", "made_by"} == chapter("run") - {name for name in chapter("run") if "." in name}


def test_the_chapter_on_scenes_names_every_dataset() -> None:
    tree = ast.parse((ROOT / "packages/simgen/src/simgen/scenes/file.py").read_text(encoding="utf-8"))
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and ast.unparse(node.func) == "write_array"]
    assert {ast.literal_eval(call.args[1]) for call in calls} == chapter("scenes")


def keys_of(file: str, function: str) -> set[str]:
    """The texts that a function uses as keys: of the dictionaries it spells out, and what it assigns by name."""
    tree = ast.parse((ROOT / "packages" / file.split("/")[0] / "src" / file).read_text(encoding="utf-8"))
    body = next(node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) and node.name == function)
    keys = [key for node in ast.walk(body) if isinstance(node, ast.Dict) for key in node.keys]
    keys += [
        node.slice for node in ast.walk(body) if isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Store)
    ]
    return {key.value for key in keys if isinstance(key, ast.Constant)}
