"""From a mesh file to a score, by the commands as installed."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
import trimesh

Command = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("pipeline")


def succeed(done: subprocess.CompletedProcess[str]) -> str:
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_users_own_mesh_becomes_a_scored_estimator(folder: Path, run_command: Command) -> None:
    """Every stage on an STL in millimeters with a symmetry: what it says and writes, and that the next reads it."""
    mesh, shards, test = folder / "peg.stl", folder / "train", folder / "test"
    trimesh.creation.cylinder(radius=20.0, height=70.0, sections=48).export(mesh)
    said = succeed(run_command("simgen", "object", mesh))
    assert "mm" in said and "revolution-flip" in said
    build = ("--object", mesh, "--preset", "debug", "--units", "mm")
    succeed(run_command("simgen", "build", *build, "--scenes", 4, "-o", shards))
    succeed(run_command("simgen", "build", *build, "--scenes", 2, "--seed", 7, "--workers", 1, "-o", test))
    succeed(run_command("simgen", "verify", shards))
    succeed(run_command("simgen", "preview", shards, "-o", folder / "preview.png"))
    succeed(run_command("posenet", "fit", shards, "--preset", "debug", "--epochs", 40, "-o", folder / "run"))
    assert "revolution-flip" in succeed(run_command("posenet", "info", folder / "run"))
    preds, truth, result = folder / "preds.json", folder / "gt.json", folder / "ap.json"
    succeed(run_command("posenet", "predict", folder / "run", test, "--refine", "-o", preds))
    succeed(run_command("evalkit", "gt", test, "-o", truth))
    said = succeed(run_command("evalkit", "ap", preds, truth, "--json", result, "--plot", folder / "pr.png"))
    document = json.loads(result.read_text())
    assert {"ap", "map", "best_f1", "recall_at_precision_99", "recall_at_precision_50", "protocol", "counts"} <= set(
        document
    )
    assert document["counts"]["images"] == 6
    assert 0.0 < document["ap"] <= 1.0
    picture = folder / "picture.png"
    succeed(run_command("evalkit", "picture", preds, truth, "--shards", test, "-o", picture))
    for path in (folder / "preview.png", folder / "pr.png", picture):
        assert path.stat().st_size > 10_000


def test_the_truth_given_as_predictions_scores_one(folder: Path, debug_shards: Path, run_command: Command) -> None:
    truth, preds, result = folder / "truth.json", folder / "copied.json", folder / "one.json"
    succeed(run_command("evalkit", "gt", debug_shards, "-o", truth))
    document = json.loads(truth.read_text())
    images = [
        {"id": image["id"], "hypotheses": [{"R": i["R"], "t": i["t"], "score": 1.0} for i in image["instances"]]}
        for image in document["images"]
    ]
    preds.write_text(json.dumps({"format": "binpose-preds/1", "object": "bunny", "images": images}))
    for criterion in ("sym", "add", "adds"):
        succeed(run_command("evalkit", "ap", preds, truth, "--criterion", criterion, "--json", result))
        assert json.loads(result.read_text())["ap"] == 1.0
