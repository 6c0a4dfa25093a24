"""What joint registration is worth on a trained network: AP with it less AP without, paired over the test scenes.

    python benchmarks/registration.py data/models/bunny-stereo.pt train test [--overlap 0.85] [--seeds 3]

`train` and `test` are folders of shards, neither of which the network was trained on. The network stays as it is:
registrations are trained on its hypotheses (all five of a detection) in `train`. One kind hears the 13 relations of a
pair alone, the other also the image features within both hypotheses' boxes, as Sock et al. (BMVC 2018) feed theirs.
Over the learned confidence the mean of both logits ranks, over the marginals' product registration's alone. With
--overlap detection keeps boxes that overlap by so much, so that there are duplicates to sort out. AP is Sym, Siléane
protocol, unrefined.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from tqdm import tqdm

from evalkit.datasets.documents import GroundTruth, PredictionImage, Predictions
from evalkit.datasets.ground_truth import read_ground_truth
from evalkit.scoring.bootstrap import compare
from evalkit.scoring.evaluation import average_precision
from posenet.coding import euler
from posenet.models.model_file import load_model
from posenet.network.confidence import ConfidenceHead
from posenet.network.pose_network import PoseNetwork
from posenet.network.predict_options import PredictOptions
from posenet.network.registration import (
    HypothesisSet,
    JointRegistration,
    Relations,
    registration_loss,
    registration_targets,
    relation_features,
)
from posenet.network.seen_boxes import pooled_features, seen_boxes
from posenet.training.dataset import Frames

CELLS = 3  # a side of what is seen of a hypothesis
BLOCKS, WIDTH, NEIGHBORS = 4, 64, 48
BATCH, RATE = 4, 2e-3
VISIBILITIES = (0.5, 0.3)
RESAMPLES = 1000


@dataclass(frozen=True)
class Claims:
    """One image's hypotheses and what is known of them."""

    confidence: Tensor  # (H,) logit
    relations: Relations
    seen: Tensor  # (H, F) float16
    labels: Tensor  # (H,) +1, -1, 0
    poses: NDArray[np.float64]  # (H, 4, 4)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", type=Path)
    parser.add_argument("train", type=Path)
    parser.add_argument("test", type=Path)
    parser.add_argument("--overlap", type=float, default=0.0, help="IoU of boxes kept [the detector's own]")
    parser.add_argument("--epochs", type=int, default=8)
    parser.add_argument("--seeds", type=int, default=3)
    options = parser.parse_args()
    network = load_model(options.model).network.eval()
    head = network.confidence
    truth = read_ground_truth(options.test)
    print("| scores | registration hears | seed | visible | AP without | AP with | difference [95 %] |")
    print("|---|---|---|---|---|---|---|")
    for scores in ("learned", "product"):
        network.confidence = head if scores == "learned" else None
        if scores == "learned" and head is None:
            continue
        train = list(claims(network, Frames(options.train), options.overlap))
        test = list(claims(network, Frames(options.test), options.overlap))
        for seeing in (False, True):
            for seed in range(options.seeds):
                registration = trained(train, seeing, seed, options.epochs)
                logits = [registered(registration, image, head if scores == "learned" else None) for image in test]
                for visibility in VISIBILITIES:
                    row = compared(test, logits, truth, visibility)
                    heard = "relations and image" if seeing else "relations"
                    print(f"| {scores} | {heard} | {seed} | >= {visibility:.0%} | {row} |", flush=True)


@torch.no_grad()
def claims(network: PoseNetwork, frames: Frames, overlap: float) -> Iterator[Claims]:
    """The hypotheses of each frame, with labels as training gives them."""
    frames = frames.on_grid_of(network.camera)
    own = network.detector.limits
    loose = replace(own, nms_iou=overlap, least=2 * own.least) if overlap else None
    options = PredictOptions(detection=loose, registration=False)
    for number in tqdm(range(len(frames.dataset)), desc="hypotheses", disable=None):
        batch = frames.batch(np.array([number]))
        images = network.encode(batch.depth, batch.intrinsics)
        (proposals,) = network.propose(images, options)
        found, confidence = proposals.hypotheses, network.score(proposals, options).confidence
        angles = torch.stack(euler.to_angles(found.relative), -1)
        known = HypothesisSet(confidence, found.rotation, found.center, angles, found.detection)
        nearest = 0.1 * network.model.diameter
        boxes = seen_boxes(network.outermost, found.rotation, found.center, batch.intrinsics[0], nearest)
        distances = network.distance.between(found.rotation, found.center, *network.codec.canonical(batch.poses[0]))
        hidden = batch.visibility[0] < network.config.train.min_visibility
        yield Claims(
            confidence,
            relation_features(known, network.model_box, NEIGHBORS),
            pooled_features(images.features[0], boxes, CELLS, network.backbone.stride).half(),
            registration_targets(distances, confidence, network.model.threshold, hidden),
            network.codec.cam_from_obj(found.rotation, found.center),
        )


def trained(images: list[Claims], seeing: bool, seed: int, epochs: int) -> JointRegistration:
    torch.manual_seed(seed)
    registration = JointRegistration(BLOCKS, WIDTH, images[0].seen.shape[1] if seeing else 0)
    steps = epochs * len(images) // BATCH
    optimizer = torch.optim.AdamW(registration.parameters(), weight_decay=1e-2)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, RATE, total_steps=steps)
    for _ in tqdm(range(steps), desc="registration", disable=None):
        some = [images[int(i)] for i in torch.randint(len(images), (BATCH,))]
        seen = torch.cat([image.seen for image in some]) if seeing else None
        logits = registration(Relations.merged([image.relations for image in some]), seen)
        loss = registration_loss(logits, torch.cat([image.labels for image in some]), "balanced")
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    return registration.eval()


@torch.no_grad()
def registered(registration: JointRegistration, image: Claims, head: ConfidenceHead | None) -> Tensor:
    """Final logits (H,), as :meth:`PoseNetwork.final_logit` has them."""
    logit = registration(image.relations, image.seen if registration.seen is not None else None)
    return logit if head is None else (logit + image.confidence) / 2


def compared(images: list[Claims], logits: list[Tensor], truth: GroundTruth, visibility: float) -> str:
    """AP without registration, AP with it, and the difference with its interval."""
    results = []
    for scores in ([image.confidence for image in images], logits):
        rows = zip(truth.images, images, scores, strict=True)
        found = [PredictionImage(gt.id, image.poses, score.double().numpy()) for gt, image, score in rows]
        results.append(average_precision(Predictions(truth.object.name, found), truth, min_visibility=visibility))
    outcome = compare(results[0], results[1], RESAMPLES)
    return f"{outcome.first.value:.4f} | {outcome.second.value:.4f} | {outcome.difference}"


if __name__ == "__main__":
    main()
