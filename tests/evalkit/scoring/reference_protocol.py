"""The protocol of Brégier et al. 2017 as plainly as it can be said: the oracle of evalkit's fast one.

Nothing is clever here: every cut of the list of hypotheses is evaluated from scratch, every distance alone. A scene is
(hypotheses, instances): [(pose, score)] and [(pose, to_find)], poses (4, 4). Loaded by path, by tests and benchmark.
"""

from __future__ import annotations

import numpy as np

NEVER = float("inf")


def sym_distance(pose_a, pose_b, model, toolbox=False):
    """Smallest distance of a representative of one pose to the first of the other."""
    turn = model.inertial_from_obj[:3, :3]
    rotations = [turn @ g @ turn.T for g in model.symmetry.rotations]
    axis = turn @ model.symmetry.axis

    def representatives(pose):
        rotation = pose[:3, :3] if toolbox else pose[:3, :3] @ turn.T
        center = pose[:3, 3] if toolbox else pose[:3, :3] @ model.centroid + pose[:3, 3]
        if model.symmetry.kind == "sphere":
            return [center]
        if model.symmetry.kind == "revolution":
            scale = model.symmetry.rotated(turn).revolution_scale(model.lam)
            return [np.concatenate([scale * rotation @ g @ axis, center]) for g in rotations]
        if toolbox:
            return [np.concatenate([(rotation @ model.lam @ g).ravel(), center]) for g in rotations]
        return [np.concatenate([(rotation @ g @ model.lam).ravel(), center]) for g in rotations]

    fixed = representatives(pose_b)[0]
    return min(np.sqrt(((candidate - fixed) ** 2).sum()) for candidate in representatives(pose_a))


def evaluate(scenes, distance, threshold, max_results=None):
    """Curve [(score, precision, recall)] over all scenes, AP, and the scenes' own APs."""
    scenes = [(best(hypotheses, max_results), instances) for hypotheses, instances in scenes]
    tables = [[[distance(p, q) for q, _ in instances] for p, _ in hypotheses] for hypotheses, instances in scenes]

    def at(number, cut):
        return precision_recall(*scenes[number], tables[number], cut, threshold, max_results)

    curve = []
    for cut in scores_of([hypothesis for hypotheses, _ in scenes for hypothesis in hypotheses]):
        figures = [at(number, cut) for number in range(len(scenes))]
        curve.append((cut, np.mean([p for p, _ in figures]), np.mean([r for _, r in figures])))
    if not curve:
        curve = [(NEVER, 1.0, np.mean([at(number, NEVER)[1] for number in range(len(scenes))]))]
    own = []
    for number, (hypotheses, _) in enumerate(scenes):
        cuts = scores_of(hypotheses) or [NEVER]
        own.append(area([(cut, *at(number, cut)) for cut in cuts]))
    return {"curve": curve, "ap": area(curve), "scene_ap": own}


def best(hypotheses, max_results):
    return sorted(hypotheses, key=lambda hypothesis: -hypothesis[1])[:max_results]


def scores_of(hypotheses):
    return sorted({score for _, score in hypotheses}, reverse=True)


def precision_recall(hypotheses, instances, table, cut, threshold, max_results):
    """Of one scene, with the hypotheses whose score is at least `cut`."""
    true, false = 0, 0
    active = [h for h, (_, score) in enumerate(hypotheses) if score >= cut]
    for h in active:
        outcome = judge(h, active, instances, table, threshold)
        true += outcome == "true"
        false += outcome == "false"
    wanted = sum(to_find for _, to_find in instances)
    if max_results is not None:
        wanted = min(wanted, max_results)
    precision = true / (true + false) if true + false else 1.0
    recall = true / wanted if wanted else 1.0
    return precision, recall


def judge(h, active, instances, table, threshold):
    """Whether hypothesis h is "true", "false" or "ignored" among the active ones."""
    if not instances:
        return "false"
    nearest = min(range(len(instances)), key=lambda i: table[h][i])
    if table[h][nearest] > threshold:
        return "false"
    if min(active, key=lambda other: table[other][nearest]) != h:
        return "false"
    return "true" if instances[nearest][1] else "ignored"


def area(curve):
    total, before = 0.0, 0.0
    for _, precision, recall in curve:
        total += precision * (recall - before)
        before = recall
    return total
