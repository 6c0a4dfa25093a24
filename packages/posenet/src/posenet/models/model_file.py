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

import numpy as np
import torch
from numpy.typing import NDArray

from evalkit.atomic import atomic_path
from evalkit.errors import InputError
from evalkit.geometry.camera import Camera
from evalkit.objects.model import ObjectModel
from posenet.config import Config
from posenet.models.compact import compact, expand
from posenet.network.pose_network import PoseNetwork

Array = NDArray[np.float64]
FORMAT = "binpose-model/1"
FARTHEST = 50.0  # meters; beyond it no camera looks into a bin
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
    except InputError:
        raise
    except (KeyError, TypeError, RuntimeError, AttributeError, ValueError):
        raise InputError(f"{path}: not a complete model of this posenet version; train it anew.") from None
    if not isinstance(record, dict):
        raise InputError(f"{path}: its record of the training is no object of JSON; train it anew.")
    if not all(bool(torch.isfinite(values).all()) for values in network.state_dict().values()):
        raise InputError(f"{path}: its weights hold numbers that are not finite; train it anew.")
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
        model = _with_mesh(model, document["vertices"].double().numpy(), document["faces"].int().numpy(), path)
    camera = Camera.from_json(json.loads(document["camera"]), f"{path}: camera")
    low, high = map(float, json.loads(document["depth_range"]))
    if not 0 < low <= high <= FARTHEST:
        raise InputError(f"{path}: its depth_range of {low:g} to {high:g} m is none over a bin; train it anew.")
    return PoseNetwork(config, model, (low, high), camera)


def _with_mesh(model: ObjectModel, vertices: Array, faces: NDArray[np.int32], path: Path) -> ObjectModel:
    """The object with its mesh.

    Raises:
        InputError: faces name vertices that are not there or no numbers, or the mesh is not of the object's size.
    """
    shaped = vertices.ndim == faces.ndim == 2 and vertices.shape[1] == faces.shape[1] == 3 and faces.size
    if not shaped or faces.min() < 0 or faces.max() >= len(vertices) or not np.isfinite(vertices[faces]).all():
        raise InputError(f"{path}: its mesh is damaged; train it anew.")
    model = replace(model, vertices=vertices, faces=faces)
    replace(model, vertices=vertices[np.unique(faces)]).require_one_unit(f"{path}: object")
    return model
