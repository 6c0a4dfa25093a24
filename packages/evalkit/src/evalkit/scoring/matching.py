"""Which hypothesis is right: predictions against ground truth, over all images at once, in flat arrays.

Two rules. :func:`match_mutual` is that of Brégier et al. 2017: a hypothesis is right where it and an instance are each
other's nearest, and farther hypotheses on the same instance are wrong; it depends on the confidence at which the list
is cut, and is followed through every cut. :func:`match_greedy` is COCO's: by falling score, each hypothesis takes the
nearest instance that is still free.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evalkit.datasets.documents import GroundTruthImage, PredictionImage
from evalkit.scoring.distances import Distance

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]
TRUE, IGNORED, DUPLICATE, FALSE = range(4)  # outcomes of a hypothesis; a duplicate counts as false
VISIBILITY_TOLERANCE = 1e-6  # shards keep float32, and 1 - occlusion_rate rounds
PAIRS_AT_ONCE = 1_000_000


@dataclass(frozen=True, eq=False)
class Crowd:
    """The H hypotheses and M instances of S images; hypotheses image by image, by falling score within each.

    Attributes:
        image: (H,) number of the image of each hypothesis; `instance_image` (M,) likewise.
        row: (H,) number of the hypothesis in its image's list, as given.
        pose: (H, 4, 4) and `instance_pose` (M, 4, 4): cam_from_obj.
        to_find: (M,) whether the instance is visible enough to be asked for.
        intrinsics: (S, 5) fx, fy, cx, cy and width of the images' cameras; None where one is unknown.
    """

    images: int
    image: Index
    row: Index
    score: Array
    pose: Array
    instance_image: Index
    instance_pose: Array
    to_find: Mask
    intrinsics: Array | None = None
    max_results: int | None = None

    @classmethod
    def gather(
        cls,
        hypotheses: list[PredictionImage | None],
        truth: list[GroundTruthImage],
        min_visibility: float,
        max_results: int | None = None,
    ) -> Crowd:
        """Flatten S images; `hypotheses` holds None where an image has none. Keeps each image's best `max_results`."""
        counts = [0 if image is None else len(image.score) for image in hypotheses]
        image, row = np.repeat(np.arange(len(truth)), counts), _count_up(np.array(counts, np.int64))
        score = _concatenate([h.score for h in hypotheses if h is not None], ())
        order = np.lexsort((row, -score, image))
        if max_results is not None:
            order = order[_count_up(np.array(counts, np.int64)) < max_results]
        pose = _concatenate([h.cam_from_obj for h in hypotheses if h is not None], (4, 4))
        visibility = _concatenate([t.visibility for t in truth], ())
        return cls(
            images=len(truth),
            image=image[order],
            row=row[order],
            score=score[order],
            pose=pose[order],
            instance_image=np.repeat(np.arange(len(truth)), [len(t.visibility) for t in truth]),
            instance_pose=_concatenate([t.cam_from_obj for t in truth], (4, 4)),
            intrinsics=_intrinsics(truth),
            to_find=visibility >= min_visibility - VISIBILITY_TOLERANCE,
            max_results=max_results,
        )

    @property
    def wanted(self) -> Index:
        """(S,) what recall is divided by: instances to find, at most `max_results`."""
        wanted = np.bincount(self.instance_image[self.to_find], minlength=self.images)
        return wanted if self.max_results is None else np.minimum(wanted, self.max_results)

    @property
    def hypotheses_per_image(self) -> Index:
        return np.bincount(self.image, minlength=self.images)

    @property
    def instances_per_image(self) -> Index:
        return np.bincount(self.instance_image, minlength=self.images)


@dataclass(frozen=True, eq=False)
class Pairs:
    """Hypotheses and instances of the same image within the threshold, sorted by hypothesis, then instance."""

    hypothesis: Index  # (P,) into the crowd's hypotheses
    instance: Index  # (P,) into the crowd's instances
    distance: Array  # (P,)


@dataclass(frozen=True, eq=False)
class Matching:
    """What became of every hypothesis and instance, and the counts at every cut of the lists.

    Attributes:
        outcome: (H,) TRUE, IGNORED, DUPLICATE or FALSE with the whole list at hand.
        partner: (H,) the instance it was compared with, -1 where none is near.
        found_by: (M,) the hypothesis that found the instance, -1 where none did.
        true_so_far, ignored_so_far: (H,) of an image's hypotheses down to this one, how many count so.
    """

    outcome: NDArray[np.int8]
    partner: Index
    found_by: Index
    true_so_far: Index
    ignored_so_far: Index


def close_pairs(crowd: Crowd, distance: Distance, threshold: float) -> Pairs:
    """All pairs of a hypothesis and an instance of its image no farther apart than `threshold`."""
    reach = threshold + distance.slack
    points, instance_points = distance.points(crowd.pose), distance.points(crowd.instance_pose)
    found: list[tuple[Index, Index, Array]] = [(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))]
    for hypothesis, instance in _all_pairs(crowd):
        gap = points[hypothesis] - instance_points[instance]
        near = np.einsum("ij,ij->i", gap, gap) <= (reach * (1 + 1e-9)) ** 2
        hypothesis, instance = hypothesis[near], instance[near]
        cameras = None if crowd.intrinsics is None else crowd.intrinsics[crowd.image[hypothesis]]
        apart = distance(crowd.pose[hypothesis], crowd.instance_pose[instance], cameras)
        near = apart <= threshold
        found.append((hypothesis[near], instance[near], apart[near]))
    return Pairs(*(np.concatenate(column) for column in zip(*found, strict=True)))


def within(pairs: Pairs, threshold: float) -> Pairs:
    """The pairs no farther apart than a smaller threshold."""
    near = pairs.distance <= threshold
    return Pairs(pairs.hypothesis[near], pairs.instance[near], pairs.distance[near])


def match_mutual(crowd: Crowd, pairs: Pairs) -> Matching:
    """The rule of Brégier et al. 2017, section 4.

    With the hypotheses of at least some score at hand, one is right where it is the nearest of them to the instance
    that is nearest to it; ties go to the higher score, then to the order given. Instead of cutting the list at every
    score, each instance's nearest hypothesis is followed down the list: it changes only where a new one is nearer.
    """
    partner = _first_of_each(pairs.hypothesis, pairs.instance, pairs.distance, len(crowd.score))
    record = _records(pairs)
    hypothesis, instance = pairs.hypothesis[record], pairs.instance[record]
    mutual = (partner[hypothesis] == instance).astype(np.int64)  # from here on the instance is matched, or no longer
    first = _is_first(instance)
    change = mutual - np.where(first, 0, np.roll(mutual, 1))
    final = np.roll(first, -1) & (mutual == 1)  # the last record of an instance precedes the next one's first
    found_by = np.full(len(crowd.to_find), -1)
    found_by[instance[final]] = hypothesis[final]
    wanted = crowd.to_find[instance]
    return Matching(
        outcome=_outcomes(crowd, partner, found_by),
        partner=partner,
        found_by=found_by,
        true_so_far=_running_count(crowd, hypothesis[wanted], change[wanted]),
        ignored_so_far=_running_count(crowd, hypothesis[~wanted], change[~wanted]),
    )


def match_greedy(crowd: Crowd, pairs: Pairs, visible_first: bool = True) -> Matching:
    """COCO's rule: by falling score, each hypothesis takes the nearest free instance.

    Args:
        visible_first: instances to find are taken before others, however near; BOP knows no such preference.
    """
    later = ~crowd.to_find[pairs.instance] & visible_first
    order = np.lexsort((pairs.instance, pairs.distance, later, pairs.hypothesis))
    taken_by, takes = [-1] * len(crowd.to_find), [-1] * len(crowd.score)
    for hypothesis, instance in zip(pairs.hypothesis[order].tolist(), pairs.instance[order].tolist(), strict=True):
        if takes[hypothesis] < 0 and taken_by[instance] < 0:
            takes[hypothesis], taken_by[instance] = instance, hypothesis
    found_by, taken = np.array(taken_by, np.int64), np.array(takes, np.int64)
    nearest = _first_of_each(pairs.hypothesis, pairs.instance, pairs.distance, len(crowd.score))
    partner = np.where(taken >= 0, taken, nearest)
    outcome = _outcomes(crowd, partner, found_by)
    everyone, once = np.arange(len(outcome)), np.ones(len(outcome), np.int64)
    return Matching(
        outcome=outcome,
        partner=partner,
        found_by=found_by,
        true_so_far=_running_count(crowd, everyone[outcome == TRUE], once[outcome == TRUE]),
        ignored_so_far=_running_count(crowd, everyone[outcome == IGNORED], once[outcome == IGNORED]),
    )


def _outcomes(crowd: Crowd, partner: Index, found_by: Index) -> NDArray[np.int8]:
    outcome = np.where(partner >= 0, DUPLICATE, FALSE).astype(np.int8)
    instance = np.flatnonzero(found_by >= 0)
    outcome[found_by[instance]] = np.where(crowd.to_find[instance], TRUE, IGNORED)
    return outcome


def _running_count(crowd: Crowd, hypothesis: Index, change: Index) -> Index:
    """Changes at hypotheses, added up down each image's list: (H,)."""
    total = np.cumsum(np.bincount(hypothesis, change, len(crowd.score)).astype(np.int64))
    before = np.r_[0, total][np.searchsorted(crowd.image, np.arange(crowd.images))]
    return np.asarray(total - before[crowd.image])


def _first_of_each(group: Index, item: Index, value: Array, groups: int) -> Index:
    """The item of least value of each group, the lower item on a tie, -1 for an empty group."""
    best = np.full(groups, -1)
    order = np.lexsort((item, value, group))
    order = order[_is_first(group[order])]
    best[group[order]] = item[order]
    return best


def _records(pairs: Pairs) -> Index:
    """Pairs at which an instance's distance falls below all before it, sorted by instance, then hypothesis."""
    order = np.lexsort((pairs.hypothesis, pairs.instance))
    _, rank = np.unique(pairs.distance, return_inverse=True)  # integers, so that the instances' offsets are exact
    key = rank[order] - pairs.instance[order] * (len(order) + 1)
    record = np.ones(len(key), bool)
    record[1:] = key[1:] < np.minimum.accumulate(key)[:-1]
    return order[record]


def _is_first(group: Index) -> Mask:
    """Where a sorted array's value differs from the one before."""
    first = np.ones(len(group), bool)
    first[1:] = group[1:] != group[:-1]
    return first


def _all_pairs(crowd: Crowd) -> Iterator[tuple[Index, Index]]:
    """Every hypothesis with every instance of its image, a bounded number at a time."""
    instances = crowd.instances_per_image
    first = np.r_[0, np.cumsum(instances)[:-1]]
    partners = instances[crowd.image]
    ends = np.cumsum(partners)
    start = 0
    while start < len(partners):
        reached = ends[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, reached + PAIRS_AT_ONCE, side="right")))
        count = partners[start:stop]
        yield (
            np.repeat(np.arange(start, stop), count),
            np.repeat(first[crowd.image[start:stop]], count) + _count_up(count),
        )
        start = stop


def _count_up(counts: Index) -> Index:
    """[2, 3] -> [0, 1, 0, 1, 2]."""
    ends = np.cumsum(counts)
    return np.arange(ends[-1] if len(ends) else 0) - np.repeat(ends - counts, counts)


def _intrinsics(truth: list[GroundTruthImage]) -> Array | None:
    cameras = [image.camera for image in truth]
    known = [(c.fx, c.fy, c.cx, c.cy, c.width) for c in cameras if c is not None]
    return np.array(known, float).reshape(-1, 5) if len(known) == len(cameras) else None


def _concatenate(parts: list[Array], shape: tuple[int, ...]) -> Array:
    return np.concatenate([np.zeros((0, *shape)), *(np.asarray(part, float).reshape(-1, *shape) for part in parts)])
