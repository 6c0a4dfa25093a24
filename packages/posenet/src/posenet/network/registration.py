"""Joint registration: hypotheses are scored again in view of their neighbors, so that each instance is found once.

After GossipNet (Hosang, Benenson & Schiele, CVPR 2017, "Learning non-maximum suppression") with the relations of
Sock et al. (BMVC 2018, section 3.3): a hypothesis hears from every neighbor, keeps the strongest of what it hears, and
after a few such rounds says how sure it is to be the one for its instance. Everything here works on hypotheses that
are constants: f_J learns on detached inputs.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor, nn

RELATION_NAMES = (
    "own score", "other's score", "box IoU", "own a", "own b", "own c", "other's a", "other's b", "other's c",
    "dx", "dy", "dz", "distance",
)  # fmt: skip
SCORE_UNIT = 5.0  # log-odds run over some -15 ... 10; networks like inputs of order one
LOUDEST_BLOCKS = 4  # deeper networks start no louder than this many blocks do
MAX_NEIGHBORS = 128  # a bound on memory in a heap of thousands; an ordinary bin stays well below
LISTENERS_AT_ONCE = 1024


@dataclass(frozen=True)
class HypothesisSet:
    """The n hypotheses of one image, in any order."""

    scores: Tensor  # (n,) confidence as log-odds or as logarithm of a probability
    rotation: Tensor  # (n, 3, 3) cam_from_obj
    center: Tensor  # (n, 3) meters: where the origin of the model box's frame lies in the camera's
    angles: Tensor  # (n, 3) a, b, c in radians
    detection: Tensor  # (n,) of which detection; hypotheses of one detection are siblings

    def __len__(self) -> int:
        return len(self.scores)


@dataclass(frozen=True)
class Relations:
    """Who hears whom among `count` hypotheses, and what is known of each pair."""

    count: int
    pairs: Tensor  # (P, 2) listener and neighbor, sorted by listener; each is its own neighbor too
    features: Tensor  # (P, 13), see RELATION_NAMES

    def heard(self) -> Tensor:
        """How many neighbors each hears (n,)."""
        if torch.compiler.is_exporting():  # ONNX cannot count; as many, whoever listens
            return self.pairs.new_zeros(self.count)
        return self.pairs[:, 0].bincount(minlength=self.count)

    @classmethod
    def merged(cls, parts: list[Relations]) -> Relations:
        """Several images as one graph without edges between them: hypotheses in the order of `parts`."""
        offsets = [0]
        for part in parts:
            offsets.append(offsets[-1] + part.count)
        pairs = [part.pairs + offset for part, offset in zip(parts, offsets, strict=False)]
        return cls(offsets[-1], torch.cat(pairs), torch.cat([part.features for part in parts]))


@torch.no_grad()
def relation_features(
    hypotheses: HypothesisSet,
    model_box: Tensor,  # (2, 3) lowest and highest corner, object frame, meters
    max_neighbors: int = MAX_NEIGHBORS,
) -> Relations:
    """The 13 numbers of each pair of neighbors (docs/network.md).

    Neighbors are hypotheses whose 3D boxes overlap, siblings, and oneself; of more than `max_neighbors` those of
    largest overlap are kept. The 3D boxes are the axis-parallel ones, in the camera's frame, around the posed model
    box: their overlap is exact and cheap where that of oriented boxes is neither.
    """
    scores = hypotheses.scores.detach().float()
    boxes = posed_boxes(hypotheses.rotation, hypotheses.center, model_box)
    pairs, overlap = _neighboring_pairs(boxes, hypotheses.detection, scores, max_neighbors)
    own, other = pairs.unbind(1)
    angles = unit_angles(hypotheses.angles)
    diagonal = (model_box[1] - model_box[0]).norm().to(scores.dtype)
    shift = (hypotheses.center[other] - hypotheses.center[own]).float() / diagonal
    both_scores = torch.stack([scores[own], scores[other]], 1) / SCORE_UNIT
    features = [both_scores, overlap[:, None], angles[own], angles[other], shift, shift.norm(dim=1)[:, None]]
    return Relations(scores.shape[0], pairs, torch.cat(features, 1))


def posed_boxes(rotation: Tensor, center: Tensor, model_box: Tensor) -> tuple[Tensor, Tensor]:
    """Lowest and highest corners (n, 3) of the axis-parallel boxes around the model box (2, 3) in n poses."""
    rotation, center, model_box = rotation.float(), center.float(), model_box.float()
    middle = rotation @ (model_box.sum(0) / 2) + center
    half = rotation.abs() @ ((model_box[1] - model_box[0]) / 2)
    return middle - half, middle + half


def box_iou_3d(a: tuple[Tensor, Tensor], b: tuple[Tensor, Tensor]) -> Tensor:
    """Intersection over union (n, m) of axis-parallel boxes, given by lowest and highest corners (n, 3) and (m, 3)."""
    (low_a, high_a), (low_b, high_b) = a, b
    shared = torch.ones(low_a.shape[0], low_b.shape[0], device=low_a.device)
    for axis in range(3):
        top = torch.minimum(high_a[:, None, axis], high_b[None, :, axis])
        shared *= (top - torch.maximum(low_a[:, None, axis], low_b[None, :, axis])).clamp_(min=0)
    volume_a, volume_b = (high_a - low_a).prod(1), (high_b - low_b).prod(1)
    return shared / (volume_a[:, None] + volume_b[None] - shared).clamp(min=torch.finfo(shared.dtype).tiny)


def unit_angles(angles: Tensor) -> Tensor:
    """Angles a, b, c (n, 3) in radians to [0, 1]: full turns of a and c, half a turn of b."""
    turn = angles.new_tensor([2 * math.pi, math.pi, 2 * math.pi])
    a, b, c = (angles / turn).float().unbind(-1)
    return torch.stack([a % 1.0, b.clamp(0, 1), c % 1.0], -1)


def _neighboring_pairs(
    boxes: tuple[Tensor, Tensor], detection: Tensor, scores: Tensor, most: int
) -> tuple[Tensor, Tensor]:
    """Pairs (P, 2) sorted by listener, and the overlap (P,) of each; listeners in portions, for memory's sake."""
    if torch.compiler.is_exporting():
        return _as_many_pairs_of_all(boxes, detection, scores, most)
    pairs, overlap = [], []
    for listeners in torch.arange(len(scores), device=scores.device).split(LISTENERS_AT_ONCE):
        iou = box_iou_3d((boxes[0][listeners], boxes[1][listeners]), boxes)
        row, neighbor = _neighbors(iou, listeners, detection, scores, most)
        pairs.append(torch.stack([listeners[row], neighbor], 1))
        overlap.append(iou[row, neighbor])
    return torch.cat(pairs), torch.cat(overlap)


def _as_many_pairs_of_all(
    boxes: tuple[Tensor, Tensor], detection: Tensor, scores: Tensor, most: int
) -> tuple[Tensor, Tensor]:
    """As :func:`_neighboring_pairs`, for ONNX: `most` pairs of every listener; who has fewer hears itself again.

    What is heard twice changes no maximum. Of n hypotheses as many again stand by that nobody hears, so that there are
    always `most` to choose from.
    """
    iou = box_iou_3d(boxes, boxes)
    itself = torch.arange(scores.shape[0], device=scores.device)
    closeness = torch.where(itself[:, None] == itself, 3.0, iou + (detection[:, None] == detection))
    preference = torch.where(closeness > 0, closeness + 1e-4 * scores.sigmoid(), closeness)
    best, neighbor = F.pad(preference, (0, most)).topk(most, dim=1)
    neighbor = torch.where(best > 0, neighbor, itself[:, None]).flatten()
    listener = itself[:, None].expand(best.shape).flatten()
    return torch.stack([listener, neighbor], 1), iou[listener, neighbor]


def _neighbors(
    overlap: Tensor, listeners: Tensor, detection: Tensor, scores: Tensor, most: int
) -> tuple[Tensor, Tensor]:
    """Rows of `overlap` (k, n) and the neighbors of each, at most `most`: oneself, then siblings, then by overlap."""
    closeness = overlap + (detection[listeners, None] == detection)
    closeness[torch.arange(len(listeners), device=overlap.device), listeners] = 3.0
    if closeness.shape[1] <= most:
        row, neighbor = closeness.nonzero(as_tuple=True)
        return row, neighbor
    # Of equally close ones, such as copies of one pose, the most confident: the answer must not depend on the order.
    preference = torch.where(closeness > 0, closeness + 1e-4 * scores.sigmoid(), closeness)
    best, neighbor = preference.topk(most, dim=1)
    row, rank = (best > 0).nonzero(as_tuple=True)
    return row, neighbor[row, rank]


class JointRegistration(nn.Module):
    """f_J: a logit for each hypothesis of being the one that explains its instance.

    `blocks` rounds of talk over `width` features a hypothesis (GossipNet: 16 in the paper, 1 in its released model).
    Each starts from zeros and hears pairs: the 13 relations and, with `features`, what the image shows within the boxes
    of both hypotheses (Sock et al.), so many numbers each, reduced by a layer of their own as GossipNet does.
    """

    def __init__(self, blocks: int = 4, width: int = 128, features: int = 0) -> None:
        super().__init__()
        self.width = width
        pair_width = width // 4
        self.seen = _fully_connected(features, pair_width) if features else None
        inputs = len(RELATION_NAMES) + (2 * pair_width if features else 0)
        self.relation = _fully_connected(inputs, pair_width, pair_width, pair_width)
        self.blocks = nn.ModuleList(GossipBlock(width, pair_width) for _ in range(blocks))
        self.head = nn.Sequential(_fully_connected(width, width, width), nn.Linear(width, 1))
        for module in self.modules():
            if isinstance(module, nn.Linear):
                nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
                if module.bias is not None:
                    nn.init.zeros_(module.bias)
        # Each block about doubles what it adds to; sixteen of them would start at logits of 100,000.
        for module in self.modules():
            if isinstance(module, GossipBlock):
                module.tell.weight.data.mul_(min(1.0, LOUDEST_BLOCKS / blocks) ** 2)

    def forward(self, relations: Relations, features: Tensor | None = None) -> Tensor:
        """Logits (n,), float32, from relations and, where the network was built for them, features (n, features)."""
        with torch.autocast(relations.features.device.type, enabled=False):
            state = relations.features.new_zeros(relations.count, self.width)
            relation = self.relation(self._pairs(relations, features))
            counts = relations.heard()
            for block in self.blocks:
                state = block(state, relation, relations.pairs, counts)
            return self.head(state)[:, 0]

    def _pairs(self, relations: Relations, features: Tensor | None) -> Tensor:
        """What is known of each pair (P, inputs): its relations, and what is seen of the listener and the neighbor."""
        if self.seen is None:
            return relations.features
        assert features is not None, "this registration was built to see"
        seen = self.seen(features.detach().float())
        listener, neighbor = relations.pairs.unbind(1)
        return torch.cat([relations.features, seen[listener], seen[neighbor]], 1)


class GossipBlock(nn.Module):
    """One round: hear every neighbor, keep the strongest, digest, add to what one knew (Hosang et al., figure 4)."""

    def __init__(self, width: int, pair_width: int) -> None:
        super().__init__()
        hidden = width // 2
        self.reduce = _fully_connected(width, pair_width)
        # One layer over (own, other's, relation); split, so that the first two are computed once a hypothesis.
        self.own = nn.Linear(pair_width, hidden)
        self.other = nn.Linear(pair_width, hidden, bias=False)
        self.relation = nn.Linear(pair_width, hidden, bias=False)
        self.message = _fully_connected(hidden, hidden)
        self.digest = _fully_connected(hidden, hidden)
        self.tell = nn.Linear(hidden, width)

    def forward(self, state: Tensor, relation: Tensor, pairs: Tensor, counts: Tensor) -> Tensor:
        """state (n, width), relation (P, pair_width), pairs (P, 2), pairs of each (n,) -> state (n, width)."""
        listener, neighbor = pairs.unbind(1)
        reduced = self.reduce(state)
        heard = self.own(reduced)[listener]
        heard += self.other(reduced)[neighbor]
        heard += self.relation(relation)
        linear, rectifier = self.message
        # The strongest is rectified: so few, and it is the strongest of those that are rectified one by one.
        strongest = rectifier(max_by_listener(linear(heard.relu_()), counts))
        return F.relu(state + self.tell(self.digest(strongest)))


def max_by_listener(messages: Tensor, counts: Tensor) -> Tensor:
    """The largest of each listener's messages, feature by feature: (P, d), sorted by listener -> (n, d).

    `counts` (n,) says how many each has; none has none. A maximum does not depend on the order, so this repeats itself
    on every device. Twice as fast as `scatter_reduce`.
    """
    if torch.compiler.is_exporting():  # each has as many
        return messages.view(counts.shape[0], -1, messages.shape[1]).amax(1)
    return torch.segment_reduce(messages, "max", lengths=counts, axis=0, unsafe=True)


def _fully_connected(*widths: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for inputs, outputs in itertools.pairwise(widths):
        layers += [nn.Linear(inputs, outputs), nn.ReLU()]
    return nn.Sequential(*layers)


@torch.no_grad()
def registration_targets(
    distances: Tensor,  # (n, m) Sym distance of each hypothesis to each instance
    scores: Tensor,  # (n,)
    threshold: float,
    ignored: Tensor | None = None,  # (m,) bool: instances that need not be found
) -> Tensor:
    """Labels (n,): +1 for the hypothesis of best score of each instance, -1 for the rest, 0 for those left out.

    A hypothesis speaks for the instance that is nearest to it, if within the threshold. Those that speak for an ignored
    instance are left out. Which of an instance's hypotheses is best is for the caller to say: with the negative
    distance as the score it is the nearest, as the evaluation protocol rewards.
    """
    labels = torch.full_like(scores, -1.0, dtype=torch.float32)
    if distances.numel() == 0:
        return labels
    nearest, instance = distances.min(1)
    speaks = (nearest < threshold)[:, None] & F.one_hot(instance, distances.shape[1]).bool()
    if ignored is not None:
        labels[(speaks & ignored).any(1)] = 0.0
        speaks = speaks & ~ignored
    best = torch.where(speaks, scores.float()[:, None], -math.inf).argmax(0)
    labels[best[speaks.any(0)]] = 1.0
    return labels


def registration_loss(logits: Tensor, labels: Tensor, weighting: Literal["paper", "balanced"] = "paper") -> Tensor:
    """Weighted logistic loss: sum of a_i log(1 + exp(-y_i s_i)) over the sum of a_i; rows labeled 0 are left out.

    `paper` has a_i = 1 for +1 and 16 for -1, as written; `balanced` gives both labels the same weight in sum.
    """
    positive, negative = labels > 0, labels < 0
    weights = torch.zeros_like(logits)
    weights[positive] = 1.0 if weighting == "paper" else 1.0 / max(int(positive.sum()), 1)
    weights[negative] = 16.0 if weighting == "paper" else 1.0 / max(int(negative.sum()), 1)
    total = (weights * F.softplus(-labels * logits)).sum()
    return total / weights.sum().clamp(min=torch.finfo(weights.dtype).tiny)
