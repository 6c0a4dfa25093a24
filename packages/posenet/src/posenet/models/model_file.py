"""A trained model in one file: weights, configuration, object, camera, depth range, training record.

Read with ``torch.load(weights_only=True)``: a model file that somebody handed you runs no code of theirs.
"""

from __future__ import annotations

import json
import pickle
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch

from evalkit.atomic import atomic_path
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel
from posenet.config import Config
from posenet.models.compact import compact, expand
from posenet.network.pose_network import PoseNetwork

FORMAT = "binpose-model/1"
MODEL_FILE = "model.pt"


@dataclass(frozen=True, eq=False)
class TrainedModel:
    """A network in eval mode and how it came to be."""

    network: PoseNetwork
    record: dict[str, Any]  # minutes, images, validation AP, data, versions


def save_model(path: Path | str, network: PoseNetwork, record: dict[str, Any], packed: bool = False) -> None:
    """Write a model file atomically; `packed` in a quarter of the bytes (see :mod:`posenet.models.compact`)."""
    model = network.model
    weights = {name: value.detach().cpu() for name, value in network.state_dict().items()}
    document: dict[str, Any] = {
        "format": FORMAT,
        "config": json.dumps(network.config.to_json()),
        "object": json.dumps(model.to_json()),
        "camera": json.dumps(network.camera.to_json()),
        "depth_range": json.dumps(network.depth_range),
        "record": json.dumps(record),
        "weights": compact(weights) if packed else weights,
    }
    if model.vertices is not None and model.faces is not None:
        document["vertices"] = torch.from_numpy(model.vertices.astype("float32"))
        document["faces"] = torch.from_numpy(model.faces.astype("int32"))
    write_torch_file(path, document)


def load_model(source: Path | str, device: str | torch.device = "cpu") -> TrainedModel:
    """Read a model file, or the best model of a run's folder.

    Raises:
        InputError: there is none, or it is damaged or of another format.
    """
    path = Path(source)
    if path.is_dir():
        path = path / MODEL_FILE
    if not path.is_file():
        raise InputError(f"{path}: no such model; train one with 'posenet fit', or check the path.")
    document = read_torch_file(path)
    if document.get("format") != FORMAT:
        raise InputError(f"{path}: format {document.get('format')!r} where {FORMAT!r} is needed; train it anew.")
    try:
        network = _rebuild(document, path)
        network.load_state_dict(expand(document["weights"]))
        record = json.loads(document["record"])
    except (KeyError, TypeError, RuntimeError, json.JSONDecodeError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"{path}: not a complete model of this posenet version ({reason}); train it anew.") from None
    network = network.to(device).eval()
    return TrainedModel(network.in_fast_layout(), record)


def write_compact(source: Path, out: Path) -> int:
    """Write the model at `source` (a model file or a run's folder) in few bytes; returns how many.

    Raises:
        InputError: there is no usable model, or `out` is that very file.
    """
    if out.exists() and source.exists() and out.samefile(source):
        raise InputError(f"{out}: is the model to be read; choose another file with -o.")
    trained = load_model(source)
    save_model(out, trained.network, trained.record, packed=True)
    return out.stat().st_size


def read_torch_file(path: Path) -> dict[str, Any]:
    """A dictionary written by torch.save, without unpickling anything but tensors and plain values.

    Raises:
        InputError: it is not such a file, or damaged.
    """
    try:
        document = torch.load(path, map_location="cpu", weights_only=True)
    except (RuntimeError, pickle.UnpicklingError, zipfile.BadZipFile, EOFError, ValueError, KeyError):
        raise InputError(
            f"{path}: cannot be read as a PyTorch file, so it is truncated, damaged or of another kind; copy it again."
        ) from None
    if not isinstance(document, dict):
        raise InputError(f"{path}: holds no dictionary, so it is not a file of posenet's.")
    return document


def write_torch_file(path: Path | str, document: dict[str, Any]) -> None:
    """Write atomically what :func:`read_torch_file` reads.

    Raises:
        OSError: the disk is full or the folder cannot be written; what stood there before still does.
    """
    try:
        with atomic_path(path) as temporary, open(temporary, "wb") as file:
            torch.save(document, file)
    except RuntimeError as error:
        # torch.save hides what the file system said behind an error of its own.
        if isinstance(error.__context__, OSError):
            raise OSError(error.__context__.errno, error.__context__.strerror, str(path)) from None
        raise


def _rebuild(document: dict[str, Any], path: Path) -> PoseNetwork:
    config = Config.from_json(json.loads(document["config"]), f"{path}: config")
    model = ObjectModel.from_json(json.loads(document["object"]), f"{path}: object")
    if "vertices" in document:
        vertices, faces = document["vertices"].double().numpy(), document["faces"].int().numpy()
        model = replace(model, vertices=vertices, faces=faces)
    camera = Camera.from_json(json.loads(document["camera"]), f"{path}: camera")
    low, high = json.loads(document["depth_range"])
    return PoseNetwork(config, model, (float(low), float(high)), camera)
