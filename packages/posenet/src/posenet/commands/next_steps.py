"""The command to type after `posenet fit` and `posenet predict`, with the paths that they wrote."""

from __future__ import annotations

import sys
from pathlib import Path

from evalkit.commands.group import suggest_next
from evalkit.datasets.shard_folder import DATASET_FILE, read_dataset_file
from evalkit.errors import InputError

TEST_FOLDER = Path("test")
TEST_SCENES, TEST_VIEWS = 40, 2  # 80 images: enough for an AP that is sure to a hundredth or two
OTHER_SEED = 1000  # added to the training set's


def after_fit(run: Path, shards: list[Path]) -> None:
    """A test set of other scenes than the training set's; where there is one already, predictions on it."""
    training = shards[0] if shards[0].is_dir() else shards[0].parent
    if (TEST_FOLDER / DATASET_FILE).is_file() and TEST_FOLDER.resolve() != training.resolve():
        suggest_next("posenet", "predict", run, TEST_FOLDER, "--refine", "-o", "preds.json")
        return
    try:
        seed = int(read_dataset_file(training)["config"]["seed"]) + OTHER_SEED
    except (InputError, OSError, KeyError, TypeError, ValueError):
        return  # not written by simgen, which could then not write more of it either
    size = ("--scenes", str(TEST_SCENES), "--views", str(TEST_VIEWS))
    suggest_next("simgen", "build", "--like", training, "--seed", str(seed), *size, "-o", TEST_FOLDER)


def after_predict(path: Path, out: Path, truth: str | None, drawn: bool, options: tuple[str, ...] = ()) -> None:
    """The ground truth, where the images have it, read with `options`; else a look at the poses."""
    if truth is not None and out.suffix.lower() != ".csv":
        kind = [] if truth == "shards" else ["--from", truth]
        suggest_next("evalkit", "gt", *kind, path, *options, "-o", out.with_name("gt.json"))
    elif truth is None and not drawn:
        suggest_next("posenet", *sys.argv[1:], "--picture", out.with_suffix(".png"))


def missing_model() -> InputError:
    """What to say where no model was given."""
    runs = [str(run) for run in sorted(Path("runs").glob("*")) if run.is_dir()][:3]
    here = f", such as {' or '.join(runs)}" if runs else ""
    return InputError(f"Missing MODEL: give a run's folder, which 'posenet fit' writes{here}, or a model file (.pt).")
