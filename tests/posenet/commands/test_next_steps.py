"""Each command ends with the next one to type, on stderr, and one without its files says what it would take."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from posenet.commands.cli import main
from posenet.commands.next_steps import after_fit, after_predict


def typed(*words: object) -> tuple[int, str, str]:
    done = CliRunner().invoke(main, [str(word) for word in words])
    return done.exit_code, done.stdout, done.stderr


def test_a_command_without_its_files_says_what_it_takes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs" / "bunny-small").mkdir(parents=True)
    for words, says in (
        (("fit",), "simgen build"),
        (("predict",), "runs/bunny-small"),
        (("predict", "model.pt"), "BOP"),
    ):
        code, out, err = typed(*words)
        assert (code, out) == (2, "")
        assert says in err and err.count("\n") == 1


def dataset(folder: Path, seed: int) -> Path:
    folder.mkdir()
    document = {"format": "binpose-dataset/1", "config": {"seed": seed}}
    (folder / "dataset.json").write_text(json.dumps(document))
    return folder


def test_after_training_comes_a_test_set_of_other_scenes_and_then_predictions_on_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "posenet.commands.next_steps.read_dataset_file", lambda f: json.loads((f / "dataset.json").read_text())
    )
    shards = dataset(tmp_path / "my shards", 7)
    after_fit(Path("runs/part"), [shards])
    said = capsys.readouterr()
    assert said.out == ""
    assert f"simgen build --like '{shards}' --seed 1007" in said.err
    dataset(tmp_path / "test", 1007)
    after_fit(Path("runs/part"), [shards])
    assert "Next: posenet predict runs/part test --refine -o preds.json" in capsys.readouterr().err


def test_after_predictions_comes_the_ground_truth_where_there_is_one(capsys: pytest.CaptureFixture[str]) -> None:
    after_predict(Path("test"), Path("out/preds.json"), "shards", drawn=False)
    assert "Next: evalkit gt test -o out/gt.json" in capsys.readouterr().err
    after_predict(Path("bunny"), Path("preds.json"), "sileane", drawn=False)
    assert "Next: evalkit gt --from sileane bunny -o gt.json" in capsys.readouterr().err
    after_predict(Path("set/test"), Path("preds.json"), "bop", False, ("--mesh-frame",))
    assert "Next: evalkit gt --from bop set/test --mesh-frame -o gt.json" in capsys.readouterr().err
    after_predict(Path("depth.png"), Path("preds.json"), None, drawn=True)
    assert capsys.readouterr().err == ""
