"""A model file that is damaged or was changed costs one sentence, and runs no code of anybody's."""

from __future__ import annotations

import json
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from evalkit.errors import InputError
from posenet.models.model_file import load_model

Document = dict[str, Any]
SHIPPED = Path(__file__).parents[3] / "data" / "models" / "bunny-stereo.pt"


@pytest.fixture(scope="module")
def document() -> Document:
    return dict(torch.load(SHIPPED, weights_only=True))


def first_weights_nan(document: Document) -> None:
    name = next(key for key, value in document["weights"].items() if getattr(value, "is_floating_point", bool)())
    document["weights"] = document["weights"] | {name: document["weights"][name] * float("nan")}


CHANGES: dict[str, tuple[Callable[[Document], object], str]] = {
    "another format": (lambda d: d.update(format="binpose-model/9"), "binpose-model/9"),
    "no weights": (lambda d: d.pop("weights"), "not a complete model"),
    "weights of another network": (lambda d: d.update(weights={}), "not a complete model"),
    "weights no numbers": (first_weights_nan, "not finite"),
    "a config of another version": (lambda d: d.update(config='{"more": 1}'), "config"),
    "a config no text": (lambda d: d.update(config=3), "not a complete model"),
    "no camera": (lambda d: d.update(camera="null"), "camera"),
    "one depth": (lambda d: d.update(depth_range="[1]"), "not a complete model"),
    "depths behind the camera": (lambda d: d.update(depth_range="[-1, 2]"), "depth_range"),
    "depths in millimeters": (lambda d: d.update(depth_range="[400, 900]"), "depth_range"),
    "a record no object": (lambda d: d.update(record="[]"), "record"),
    "no vertices": (lambda d: d.update(vertices=None), "not a complete model"),
    "vertices no numbers": (lambda d: d.update(vertices=d["vertices"] * float("nan")), "mesh is damaged"),
    "vertices in millimeters": (lambda d: d.update(vertices=1e3 * d["vertices"]), "in meters"),
    "faces of other vertices": (lambda d: d.update(faces=d["faces"] + 10**5), "mesh is damaged"),
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_changed_model_is_refused_by_name(change: str, document: Document, tmp_path: Path) -> None:
    edit, sentence = CHANGES[change]
    changed = dict(document)
    edit(changed)
    torch.save(changed, tmp_path / "model.pt")
    with pytest.raises(InputError, match=sentence) as caught:
        load_model(tmp_path)
    assert str(tmp_path / "model.pt") in str(caught.value)


class Trap:
    """Unpickled, it would leave a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.path,)


@pytest.mark.parametrize("kind", ["empty", "truncated", "zip", "pickle", "torch"])
def test_what_is_no_model_runs_nothing(kind: str, tmp_path: Path) -> None:
    path, trap = tmp_path / "model.pt", Trap(tmp_path / "sprung")
    if kind == "zip":
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("readme.txt", json.dumps({"format": "binpose-model/1"}))
    elif kind == "torch":
        torch.save({"format": "binpose-model/1", "config": trap}, path)
    else:
        whole = SHIPPED.read_bytes()
        path.write_bytes({"empty": b"", "truncated": whole[: len(whole) // 2], "pickle": pickle.dumps(trap)}[kind])
    with pytest.raises(InputError, match="cannot be read as a PyTorch file"):
        load_model(path)
    assert not trap.path.exists()
