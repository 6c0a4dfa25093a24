"""The evalkit command as a user types it."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from evalkit import PredictionImage, Predictions, write_ground_truth, write_predictions
from evalkit.commands.cli import main
from evalkit.datasets.scene import Instances, View
from evalkit.datasets.shard_format import ShardHeader
from evalkit.datasets.shard_writer import ShardWriter
from evalkit.geometry import poses
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel

CAMERA = Camera(80, 60, 80.0, 80.0, 39.5, 29.5)


def evalkit(*arguments):
    """Run in this process; tracebacks are failures."""
    result = CliRunner().invoke(main, [str(a) for a in arguments], catch_exceptions=False)
    return result


@pytest.fixture
def folder(plain_model, make_crowd, tmp_path):
    predictions, truth = make_crowd(plain_model, 0)
    write_ground_truth(tmp_path / "gt.json", truth)
    write_predictions(tmp_path / "preds.json", predictions)
    return tmp_path


@pytest.fixture(scope="module")
def shards(tmp_path_factory):
    """Three frames of two tiles each, 80 x 60."""
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * 0.05
    model = ObjectModel.from_mesh("tile", square, [[0, 1, 2], [0, 2, 3]])
    header = ShardHeader(CAMERA, 1e-4, model)
    rng = np.random.default_rng(0)
    path = tmp_path_factory.mktemp("shards")
    with ShardWriter(path / "shard-00000.h5", header, frames=3) as writer:
        for view in range(3):
            place = poses.from_rotation_translation(poses.random_rotations(rng, 2), [[-0.1, 0, 0.5], [0.1, 0, 0.5]])
            writer.append(View(
                CAMERA, np.full((60, 80), 6000, np.uint16), 1e-4, np.zeros((60, 80), np.uint16), np.eye(4),
                Instances(np.arange(2), place, *np.array([[1.0, 0.3], [0.8, 0.3]]), *np.ones((3, 2), int),
                          *np.zeros((2, 2, 4), int), np.zeros((2, 2))), 7, view))  # fmt: skip
    return path


def test_ap_prints_the_figures_the_counts_and_the_rules(folder):
    done = evalkit("ap", folder / "preds.json", folder / "gt.json", "--min-visibility", 0.4)
    assert done.exit_code == 0
    for words in ("AP ", "MAP", "best F1", "P = 0.99", "P = 0.50", "to find", "ignored", "40 %", "Sym, root"):
        assert words in done.output


def test_ap_writes_everything_as_json(folder):
    out = folder / "out.json"
    assert evalkit("ap", folder / "preds.json", folder / "gt.json", "--json", out).exit_code == 0
    document = json.loads(out.read_text())
    assert {
        "ap", "map", "best_f1", "recall_at_precision_99", "recall_at_precision_50", "protocol", "counts", "criterion",
        "threshold", "symmetry", "min_visibility", "evalkit_version", "inputs", "curve",
    } <= document.keys()  # fmt: skip
    for key, name in (("predictions", "preds.json"), ("ground_truth", "gt.json")):
        assert document["inputs"][key]["sha256"] == hashlib.sha256((folder / name).read_bytes()).hexdigest()


@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_ap_draws_the_curve(folder, suffix):
    out = folder / f"pr{suffix}"
    assert evalkit("ap", folder / "preds.json", folder / "gt.json", "--plot", out).exit_code == 0
    if suffix == ".png":
        picture = cv2.imread(str(out))
        assert picture.shape[0] > 400
        assert picture.std() > 10
    else:
        assert "<svg" in out.read_text()


@pytest.mark.parametrize(
    "arguments",
    [
        ["ap", "absent.json", "gt.json"], ["ap", "preds.json", "preds.json"], ["ap", "gt.json", "gt.json"],
        ["ap", "preds.json", "gt.json", "--threshold", "0"], ["ap", "preds.json", "gt.json", "--max-results", "0"],
        ["ap", "preds.json", "gt.json", "--protocol", "voc"], ["ap", "preds.json", "gt.json", "--plot", "pr.xyz"],
        ["ap", "preds.json", ".", ], ["gt", "absent", "-o", "x.json"], ["gt", ".", "-o", "x.json"],
        ["gt", "--from", "sileane", ".", "-o", "x.json"], ["preds", "--from", "sileane", "absent", "-o", "x.json"],
        ["ap", "preds.json", "gt.json", "--json", "gt.json/x.json"],
        ["picture", "preds.json", "gt.json", "--shards", "absent", "-o", "x.png"],
    ],
)  # fmt: skip
def test_wrong_input_gets_one_sentence_and_exit_code_2(folder, monkeypatch, arguments):
    monkeypatch.chdir(folder)
    before = sorted(p.name for p in folder.iterdir())
    done = evalkit(*arguments)
    assert done.exit_code == 2
    errors = [line for line in done.output.splitlines() if line.startswith("Error: ")]
    assert len(errors) == 1
    assert "Traceback" not in done.output
    assert sorted(p.name for p in folder.iterdir()) == before


def test_gt_of_shards_scores_one_against_itself(shards, tmp_path):
    assert evalkit("gt", shards, "-o", tmp_path / "gt.json").exit_code == 0
    document = json.loads((tmp_path / "gt.json").read_text())
    assert [image["id"] for image in document["images"]] == ["000007-000", "000007-001", "000007-002"]
    hypotheses = [
        {"id": i["id"], "hypotheses": [{"R": r["R"], "t": r["t"], "score": r["visibility"]} for r in i["instances"]]}
        for i in document["images"]
    ]
    preds = {"format": "binpose-preds/1", "object": document["object"]["name"], "images": hypotheses}
    (tmp_path / "preds.json").write_text(json.dumps(preds))
    for criterion in ("sym", "add", "adds"):
        out = tmp_path / "ap.json"
        rules = ["--criterion", criterion, "--json", out]
        assert evalkit("ap", tmp_path / "preds.json", tmp_path / "gt.json", *rules).exit_code == 0
        assert json.loads(out.read_text())["ap"] == 1.0


def test_the_share_of_visibility_that_is_asked_for_decides_and_is_said(shards, tmp_path):
    gt, preds = tmp_path / "gt.json", tmp_path / "preds.json"
    done = evalkit("gt", shards, "-o", gt)
    assert "geometric share" in done.output
    document = json.loads(gt.read_text())
    assert document["visibility"] == "geometric"
    first = document["images"][0]["instances"][0]
    assert (first["visibility"], first["visibility_returned"]) == (1.0, pytest.approx(0.8))
    evalkit("preds", "--from", "shards", shards, "-o", preds)
    for options, share, to_find in (([], "geometric", 3), (["--visibility", "returned"], "returned", 0)):
        out = evalkit("ap", preds, gt, "--min-visibility", 0.9, *options).output
        assert f"at least 90 % visible ({share} share)" in " ".join(out.split())
        assert f"of them {to_find} to find" in out
    assert evalkit("gt", shards, "--visibility", "returned", "-o", gt).exit_code == 0
    assert json.loads(gt.read_text())["visibility"] == "returned"
    assert "(returned share)" in " ".join(evalkit("ap", preds, gt).output.split())
    assert evalkit("gt", shards, "--visibility", "depth", "-o", gt).exit_code == 2


def test_picture_shows_images_of_the_shards(shards, tmp_path):
    assert evalkit("gt", shards, "-o", tmp_path / "gt.json").exit_code == 0
    place = poses.from_rotation_translation(np.eye(3), [[-0.1, 0, 0.5], [0.0, 0.1, 0.5]])
    found = PredictionImage("000007-001", place, np.array([0.9, 0.8]))
    write_predictions(tmp_path / "preds.json", Predictions("tile", [found]))
    files = tmp_path / "preds.json", tmp_path / "gt.json", "--shards", shards, "-o", tmp_path / "out.png"
    assert evalkit("picture", *files, "--images", 2).exit_code == 0
    assert cv2.imread(str(tmp_path / "out.png")).shape[1] > 1000
    assert evalkit("picture", *files, "--image", "nowhere").exit_code == 2


def test_sileane_files_go_in_and_the_golden_figure_comes_out(reference, tmp_path):
    data = reference / "sileane_bunny"
    assert evalkit("gt", "--from", "sileane", data, "-o", tmp_path / "gt.json").exit_code == 0
    assert evalkit("preds", "--from", "sileane", data / "results", "-o", tmp_path / "preds.json").exit_code == 0
    rules = ["--protocol", "sileane-toolbox", "--threshold", 0.025, "--json", tmp_path / "out.json"]
    assert evalkit("ap", tmp_path / "preds.json", tmp_path / "gt.json", *rules).exit_code == 0
    assert json.loads((tmp_path / "out.json").read_text())["ap"] == pytest.approx(0.798411235339, abs=1e-9)


def test_what_takes_long_to_import_waits_until_it_is_needed():
    code = "import sys, evalkit.commands.cli; print(sorted({'scipy', 'matplotlib', 'cv2', 'h5py'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


def test_intervals_confidence_and_comparison_are_printed_and_written(folder):
    files = folder / "preds.json", folder / "gt.json"
    done = evalkit("ap", *files, "--bootstrap", 50, "--confidence", 0.5, "--json", folder / "out.json")
    assert done.exit_code == 0
    assert "F1" in done.output
    assert "50 resamples" in done.output
    document = json.loads((folder / "out.json").read_text())
    assert document["bootstrap"]["ap"][0] <= document["ap"] <= document["bootstrap"]["ap"][1]
    assert document["at_confidence"]["score"] == 0.5
    done = evalkit("compare", files[0], *files, "--resamples", 20, "--json", folder / "out.json")
    assert done.exit_code == 0
    assert "difference: 0.0000 [0.0000, 0.0000]" in done.output
    assert json.loads((folder / "out.json").read_text())["difference"]["value"] == 0


def test_bop24_scores_the_ground_truth_of_shards_with_one(shards, tmp_path):
    assert evalkit("gt", shards, "-o", tmp_path / "gt.json").exit_code == 0
    document = json.loads((tmp_path / "gt.json").read_text())
    images = [
        {"id": i["id"], "hypotheses": [{"R": r["R"], "t": r["t"], "score": 1} for r in i["instances"]]}
        for i in document["images"]
    ]
    preds = {"format": "binpose-preds/1", "object": "tile", "images": images}
    (tmp_path / "preds.json").write_text(json.dumps(preds))
    files = tmp_path / "preds.json", tmp_path / "gt.json", "--json", tmp_path / "out.json"
    done = evalkit("bop24", *files)
    assert done.exit_code == 0
    for name in ("bop24_mAP", "bop25_mAP", "bop25_mAP_mm"):
        assert json.loads((tmp_path / "out.json").read_text())[name] == 1.0
        assert f"{name:<18} 1.0000" in done.output


def test_predictions_go_out_in_the_format_of_the_toolbox(folder, tmp_path):
    params = "width 8\nheight 8\nfu 9\nfv 9\ncu 4\ncv 4\nlocation 0 0 1\nrotation 0 1 0 0\n"
    (tmp_path / "camera_params.txt").write_text(params)
    out, back = tmp_path / "results", tmp_path / "back.json"
    camera = ["--camera-params", tmp_path / "camera_params.txt"]
    assert evalkit("preds", folder / "preds.json", "--to", "sileane", "-o", out, *camera).exit_code == 0
    assert evalkit("preds", out, "--from", "sileane", "-o", back, *camera, "--object", "thing-none").exit_code == 0
    scores = []
    for path in (folder / "preds.json", back):
        done = evalkit("ap", path, folder / "gt.json", "--json", tmp_path / "out.json")
        assert done.exit_code == 0, done.output
        scores.append(json.loads((tmp_path / "out.json").read_text())["ap"])
    assert scores[0] == pytest.approx(scores[1], abs=1e-9)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["gt", ".", "-o", "x.json", "--mesh", "m.ply"], "--mesh"),
        (["gt", ".", "-o", "x.json", "--from", "ipa", "--object-id", "3"], "--object-id"),
        (["preds", "preds.json", "-o", "x.json"], "--from"),
        (["preds", "preds.json", "-o", "x.csv", "--to", "bop", "--camera-params", "x.txt"], "--camera-params"),
    ],
)
def test_options_without_meaning_are_refused(folder, monkeypatch, arguments, word):
    monkeypatch.chdir(folder)
    done = evalkit(*arguments)
    assert done.exit_code == 2
    assert word in done.output


def test_ap_without_files_says_what_it_takes():
    done = evalkit("ap")
    assert done.exit_code == 2
    assert "preds.json" in done.output and "gt.json" in done.output and done.output.count("\n") == 1


def test_what_to_type_next_is_no_part_of_the_result(folder):
    done = evalkit("ap", folder / "preds.json", folder / "gt.json")
    assert "Next: evalkit report" in done.stderr and "Next" not in done.stdout


def test_a_camera_file_is_explained_with_what_it_sees_at_a_distance(tmp_path):
    document = {"width": 640, "height": 480, "fx": 600.0, "fy": 600.0, "cx": 319.5, "cy": 239.5, "k1": -0.1}
    (tmp_path / "camera.json").write_text(json.dumps(document))
    done = evalkit("camera", tmp_path / "camera.json", "--at", "0.6")
    assert done.exit_code == 0
    assert "56.1 x 43.6 degrees" in done.stdout and "1 mm a pixel" in done.stdout and "k1 -0.1" in done.stdout
    plain = json.loads(evalkit("camera", tmp_path / "camera.json", "--json").stdout)
    assert plain == {key: document[key] for key in ("width", "height", "fx", "fy", "cx", "cy")}
    (tmp_path / "camera.json").write_text("{}")
    assert evalkit("camera", tmp_path / "camera.json").exit_code == 2
