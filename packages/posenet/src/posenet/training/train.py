"""`posenet fit`: what a run is, and its beginning; the loop is :class:`posenet.training.trainer.Trainer`."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from evalkit.atomic import sha256_of_file
from evalkit.datasets.shard_folder import list_shards
from evalkit.datasets.shard_format import checksum_problem
from evalkit.errors import InputError
from posenet.device import choose_device
from posenet.network.backbone import load_vgg16_weights
from posenet.network.pose_network import PoseNetwork
from posenet.runs.provenance import data_hash, git_version, shard_hashes, software_versions
from posenet.runs.run_folder import RunFolder
from posenet.training.batches import degradation_of
from posenet.training.dataset import Frames, Split
from posenet.training.fit_options import FitOptions
from posenet.training.processes import processes
from posenet.training.rank import Rank
from posenet.training.trainer import Trainer
from posenet.training.working_scale import choose_scale

log = logging.getLogger(__name__)


def fit(options: FitOptions) -> RunFolder:
    """Train, or go on training; returns the run's folder, with the best model in it.

    Raises:
        InputError: the shards, the options or the folder cannot be used, nothing is learned, or the loss became NaN.
        OSError: the folder cannot be written, or its disk is full.
        KeyboardInterrupt: Ctrl-C or SIGTERM, after the state was saved.
    """
    device = choose_device(options.device, options.devices)
    frames, split, network = _prepared(options, intact_frames(options.shards))
    run = RunFolder(options.out)
    options = _with_length(options, run)
    resuming = run.claim(_identity(options, frames), _length(options), _made_by(options, frames))
    follow = partial(_follow, options, resuming)
    with run.locked(), _reproducible(device), processes(options.devices, follow) as rank:
        run.note_length(_length(options))
        _train(Trainer(network, frames, split, run, options, rank), resuming)
    return run


def _follow(options: FitOptions, resuming: bool, rank: Rank) -> None:
    """What :func:`fit` does in the processes beside the first, which has checked everything."""
    frames, split, network = _prepared(options, Frames(list(options.shards)))
    with _reproducible(choose_device(options.device)):
        _train(Trainer(network, frames, split, RunFolder(options.out), options, rank), resuming)


def _train(trainer: Trainer, resuming: bool) -> None:
    if resuming:
        trainer.restore(trainer.run.load_checkpoint())
    trainer.train()


def _prepared(options: FitOptions, frames: Frames) -> tuple[Frames, Split, PoseNetwork]:
    """The frames at their working scale, which of them train, and the network as it begins."""
    config = options.config
    share = config.train.validation_share if options.validate else 0.0
    split = frames.split(share, options.seed, config.train.validation_images)
    batch = min(config.train.batch_images, len(split.train))
    if batch < options.devices:
        raise InputError(
            f"--devices {options.devices}: a batch of {batch} image(s) cannot be shared by so many; give "
            f"--batch-images {options.devices} or more, and as many training images."
        )
    depths = frames.depths(split.train, config.train.min_visibility)
    frames = _at_working_scale(frames, options, float(np.median(depths)))
    torch.manual_seed(options.seed)
    network = PoseNetwork(config, frames.model, (float(depths.min()), float(depths.max())), frames.camera)
    if options.backbone_weights is not None:
        _load_backbone(network, options.backbone_weights)
    return frames, split, network


def _at_working_scale(frames: Frames, options: FitOptions, distance: float) -> Frames:
    stored = frames.stored_camera
    scale = choose_scale(stored, frames.model.diameter, distance, options.config.train.object_pixels, options.scale)
    camera = scale.camera(stored)
    log.info(
        "Images: %d x %d, read as %d x %d (--scale %.3g): %s.",
        stored.width, stored.height, camera.width, camera.height, scale.factor, scale.reason,
    )  # fmt: skip
    if any(degradation_of(options.config.train, frames)):
        have = f"the shards have those of '{frames.sensor}', so half of" if frames.sensor else "up to"
        log.info("Sensor errors: drawn on the fly, %s what a bad stereo camera makes (--augment off for none).", have)
    if options.config.train.cut_frames:
        log.info("Frames: most steps see parts of their images, for objects that the frame cuts (--no-cut-frames).")
    return frames.on_grid_of(camera)


def intact_frames(shards: list[Path]) -> Frames:
    """The shards' frames, after every byte was checked: better now than as a traceback in the second hour.

    Raises:
        InputError: a shard is missing, damaged, of another schema, or does not belong with the first.
    """
    for path in list_shards(shards):
        problem = checksum_problem(path)
        if problem:
            raise InputError(f"{path}: {problem}; delete it and run 'simgen build' again.")
    return Frames(list(shards))


def _load_backbone(network: PoseNetwork, path: Path) -> None:
    trunk = network.config.network.backbone
    if trunk != "vgg16":
        raise InputError(
            f"--backbone-weights {path}: fits the trunk vgg16 only, and the preset '{network.config.preset}' has "
            f"{trunk}; give --preset paper, or leave the weights out."
        )
    load_vgg16_weights(network.backbone, path)


def _identity(options: FitOptions, frames: Frames) -> dict[str, Any]:
    """What must be the same for a run to be resumed."""
    weights = options.backbone_weights
    return {
        "config": options.config.to_json(),
        "seed": options.seed,
        "validate": options.validate,
        "scale": options.scale,
        "backbone_weights": sha256_of_file(weights) if weights is not None else None,
        "data": {"sha256": data_hash(frames.dataset), "shards": shard_hashes(frames.dataset)},
    }


def _length(options: FitOptions) -> dict[str, Any]:
    """How long it trains; a run may be given more of it."""
    return {"minutes": options.minutes, "epochs": options.epochs}


def _with_length(options: FitOptions, run: RunFolder) -> FitOptions:
    """The options with the run's own budget where none is given."""
    given = options.minutes is not None or options.epochs is not None
    return options if given else replace(options, **run.length())


def _made_by(options: FitOptions, frames: Frames) -> dict[str, Any]:
    """How to make the run again."""
    return {
        "command": options.command or f"posenet.train.fit({options!r})",
        "folder": os.getcwd(),
        "shards": [str(path.resolve()) for path in frames.dataset.paths],
        "git": git_version(),
        "software": software_versions(),
    }


@contextmanager
def _reproducible(device: torch.device) -> Iterator[None]:
    """On the CPU, gradients that are summed in one order: in parallel, indexing adds them as the threads come."""
    before = torch.are_deterministic_algorithms_enabled(), torch.is_deterministic_algorithms_warn_only_enabled()
    filling = torch.utils.deterministic.fill_uninitialized_memory  # type: ignore[attr-defined]
    if device.type == "cpu":
        torch.use_deterministic_algorithms(True, warn_only=True)
        torch.utils.deterministic.fill_uninitialized_memory = False  # type: ignore[attr-defined]
    try:
        yield
    finally:
        torch.use_deterministic_algorithms(before[0], warn_only=before[1])
        torch.utils.deterministic.fill_uninitialized_memory = filling  # type: ignore[attr-defined]
