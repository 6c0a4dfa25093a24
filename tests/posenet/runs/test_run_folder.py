"""A run's folder says what the run was; and a disk that fills up, or cannot be written, costs one sentence."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import subprocess
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

import cv2
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from evalkit.commands.group import describe_os_error
from evalkit.datasets.shard_folder import list_shards
from evalkit.datasets.shard_format import USER_BLOCK
from evalkit.errors import InputError
from posenet.config import preset, with_options
from posenet.models.model_file import load_model, read_torch_file
from posenet.runs.run_folder import RunFolder
from posenet.training import dataset, trainer
from posenet.training.fit_options import FitOptions
from posenet.training.train import fit
from posenet.training.trainer import Trainer


def options(shards: Path, out: Path, **rest: object) -> FitOptions:
    chosen = {"config": preset("debug"), "epochs": 2, "device": "cpu", "validate": False} | rest
    return FitOptions([shards], out, **chosen)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def validated(debug_shards: Path, tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """A run of four steps with two validations on one of the two scenes."""
    config = with_options(preset("debug"), "train", batch_images=1, validations=2, ema=0.9)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dataset, "LEAST_SCENES", 2)
        patch.setattr(trainer, "ROW_EVERY", 2)
        out = tmp_path_factory.mktemp("runs") / "run"
        command = "posenet fit shards --preset debug"
        return fit(options(debug_shards, out, config=config, validate=True, command=command))


def test_run_json_says_how_to_make_the_run_again(validated: RunFolder, debug_shards: Path) -> None:
    document = json.loads((validated.path / "run.json").read_text())
    assert document["config"]["train"]["ema"] == 0.9 and document["seed"] == 0 and document["epochs"] == 2
    assert document["made_by"]["command"] == "posenet fit shards --preset debug"
    assert document["made_by"]["folder"] == os.getcwd()
    assert document["made_by"]["software"]["torch"] == version("torch")
    for path in list_shards(debug_shards):
        assert document["data"]["shards"][path.name] == hashlib.sha256(path.read_bytes()[USER_BLOCK:]).hexdigest()


def test_the_commit_is_noted_where_the_package_runs_from_a_checkout(validated: RunFolder) -> None:
    said = json.loads((validated.path / "run.json").read_text())["made_by"]["git"]
    here = Path(trainer.__file__).parent
    known = subprocess.run(["git", "-C", str(here), "cat-file", "-t", str(said).split("-")[0]], capture_output=True)
    assert said is None or known.stdout.strip() == b"commit"
    in_checkout = subprocess.run(["git", "-C", str(here), "ls-files", "--error-unmatch", "trainer.py"], check=False)
    assert (said is not None) == (in_checkout.returncode == 0)


def test_validation_ap_over_time_and_losses_are_lines_and_curves(validated: RunFolder) -> None:
    rows = [json.loads(line) for line in (validated.path / "metrics.jsonl").read_text().splitlines()]
    assert [row["images"] for row in rows] == sorted(row["images"] for row in rows) and len(rows) == 2
    assert all(0 <= row["ap"] <= 1 and row["minutes"] > 0 for row in rows)
    losses = [json.loads(line) for line in (validated.path / "losses.jsonl").read_text().splitlines()]
    assert losses and all(row["total"] > 0 and row["depth"] > 0 for row in losses)
    picture = cv2.imread(str(validated.path / "curves.png"))
    assert picture is not None and picture.std() > 10


def test_tensorboard_shows_predictions_on_the_same_image_at_each_validation(validated: RunFolder) -> None:
    events = EventAccumulator(str(validated.path), size_guidance={"images": 0})
    events.Reload()
    images = events.Images("validation/poses")
    assert len(images) == 2 and (images[0].width, images[0].height) == (320, 240)
    assert len(events.Scalars("validation/ap")) == 2


def test_best_and_last_model_are_kept(validated: RunFolder) -> None:
    best, last = load_model(validated.model), load_model(validated.last)
    assert last.record["step"] == read_torch_file(validated.checkpoint)["step"]
    assert best.record["validation_ap"] >= last.record["validation_ap"]


def test_the_average_is_what_is_kept_and_the_last_weights_are_what_goes_on(validated: RunFolder) -> None:
    state = read_torch_file(validated.checkpoint)
    kept = read_torch_file(validated.last)["weights"]
    assert all(torch.equal(kept[name], value) for name, value in state["average"]["weights"].items())
    assert any(not torch.equal(kept[name], value) for name, value in state["weights"].items())


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 20 MB: one checkpoint fits, two do not."""
    place = tmp_path / "disk"
    place.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=20m", "tmpfs", str(place)], capture_output=True)
    if mounted.returncode:
        pytest.skip("only root can mount a small disk")
    yield place
    subprocess.run(["umount", "-l", str(place)], check=True)


def check_full_disk(shards: Path, out: Path) -> None:
    """One sentence, and the checkpoint of an earlier step stands and can be gone on from."""
    with pytest.raises(OSError) as caught:
        fit(options(shards, out, epochs=3, checkpoint_seconds=0.0))
    said = describe_os_error(caught.value)
    assert said.startswith("no space left on the disk that holds") and str(out / "checkpoint.pt") in said
    assert read_torch_file(out / "checkpoint.pt")["step"] == 1
    assert not list(out.glob(".*.tmp"))


def test_a_full_disk_costs_one_sentence_and_keeps_the_last_checkpoint(debug_shards: Path, small_disk: Path) -> None:
    check_full_disk(debug_shards, small_disk / "run")


def test_no_space_reported_late_keeps_the_last_checkpoint(
    debug_shards: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Some file systems say so only when asked to write to the platter."""
    real, synced = os.fsync, []

    def full_from_the_third_file_on(handle: int) -> None:
        synced.append(handle)
        if len(synced) >= 3:  # run.json and the first checkpoint came before
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(handle)

    monkeypatch.setattr(os, "fsync", full_from_the_third_file_on)
    check_full_disk(debug_shards, tmp_path / "run")


@pytest.fixture
def read_only(tmp_path: Path) -> Iterator[Path]:
    place = tmp_path / "read-only"
    place.mkdir()
    if os.geteuid() != 0:  # root may write where permissions forbid it
        place.chmod(0o555)
        yield place
        place.chmod(0o755)
        return
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "ro", "tmpfs", str(place)], capture_output=True).returncode:
        pytest.skip("nothing can be mounted here")
    yield place
    subprocess.run(["umount", "-l", str(place)], check=True)


def test_a_folder_that_cannot_be_written_is_refused_before_training(
    debug_shards: Path, read_only: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Trainer, "train", lambda _: pytest.fail("it began to train"))
    with pytest.raises(OSError) as caught:
        fit(options(debug_shards, read_only / "run"))
    assert str(read_only / "run") in describe_os_error(caught.value)


def test_a_finished_folder_that_became_read_only_is_refused_before_training(
    debug_shards: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = fit(options(debug_shards, tmp_path / "run", epochs=1))

    def refuse(**_: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr("posenet.runs.run_folder.tempfile.TemporaryFile", refuse)
    with pytest.raises(OSError) as caught:
        fit(options(debug_shards, tmp_path / "run", epochs=1))
    assert describe_os_error(caught.value).startswith(f"{run.path} is on a read-only file system")


@pytest.mark.parametrize("name", ["model.pt", "last.pt", "dataset.json"])
def test_a_model_that_no_run_made_and_shards_are_not_mixed_with_a_run(
    name: str, debug_shards: Path, tmp_path: Path
) -> None:
    (tmp_path / name).write_text("precious")
    with pytest.raises(InputError, match=f"{name}: is there, but no run's"):
        fit(options(debug_shards, tmp_path))
    assert [file.name for file in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_text() == "precious"


def test_what_a_killed_write_left_behind_is_removed(debug_shards: Path, tmp_path: Path) -> None:
    run = fit(options(debug_shards, tmp_path / "run", epochs=1))
    leftover = run.path / ".checkpoint.pt.abc.tmp"
    leftover.write_bytes(b"half")
    fit(options(debug_shards, tmp_path / "run", epochs=1))
    assert not leftover.exists()


def test_two_processes_do_not_train_in_one_folder(debug_shards: Path, tmp_path: Path) -> None:
    run = fit(options(debug_shards, tmp_path / "run", epochs=1))
    with run.locked(), pytest.raises(InputError, match="another process is training"):
        fit(options(debug_shards, tmp_path / "run", epochs=1))
    fit(options(debug_shards, tmp_path / "run", epochs=1))


def test_a_run_begun_before_an_option_was_added_goes_on(debug_shards: Path, tmp_path: Path) -> None:
    run = fit(options(debug_shards, tmp_path / "run", epochs=1))
    file = run.path / "run.json"
    document = json.loads(file.read_text())
    del document["config"]["train"]["ema"], document["data"]["shards"]
    file.write_text(json.dumps(document))
    before = run.model.read_bytes()
    fit(options(debug_shards, tmp_path / "run", epochs=1))
    assert run.model.read_bytes() == before
