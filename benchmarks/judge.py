"""The judge of refined poses: made from simulated piles, and beside the constants that scored before it.

    python benchmarks/judge.py [--network data/models/bunny-stereo.pt ...] [--write judge.json]

Piles of several built-in objects under three sensors; hypotheses made from the truth (simulated_hypotheses.py) and, of
the objects they know, by trained networks; some about parts that are not there. All are refined, which is the same for
both; then the judge scores, or evidence less what better poses explain does, as before. Each row is of a judge that saw
neither the row's object nor any `kinect` depth. ECE is the expected calibration error over ten bins; a pose is right
within Sym's threshold of an instance, once. --write makes the judge that is shipped, from all piles.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from evalkit.datasets.documents import PredictionImage, Predictions
from evalkit.scoring.bootstrap import compare
from evalkit.scoring.calibration import BINS, calibration
from evalkit.scoring.evaluation import average_precision
from evalkit.scoring.result import Result
from judge_piles import PILES, Image, Pile, collected
from posenet.refinement.judge import FARTHEST, FORMAT, Judge, Regression, probability
from posenet.refinement.neighbors import neighbor_columns, without_impossible_pairs

Array = NDArray[np.float64]
UNSEEN_SENSOR = "kinect"
ALONE = (
    "agreement", "through", "far through", "hidden", "near", "fine", "residual", "slope",
    "outline seen", "outline met", "outline missed", "prior", "strayed", "margin", "stable", "company", "evidence",
)  # fmt: skip
RIDGE = 1e-3  # on the weights of standardized inputs
VISIBILITIES = (0.5, 0.3)
BEFORE_HALF_SURE, BEFORE_STEEPNESS = 0.25, 16.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--network", type=Path, action="append", default=[], help="a trained model; may be repeated")
    parser.add_argument("--objects", default=",".join(PILES))
    parser.add_argument("--scenes", type=int, default=10, help="of each object and sensor, two views each")
    parser.add_argument("--write", type=Path, help="the judge made from all piles")
    parser.add_argument("-o", "--output", dest="out", type=Path, default=Path("runs/judge"))
    options = parser.parse_args()
    piles = list(collected(options))
    table(piles)
    if options.write:
        options.write.write_text(as_text(learned(piles)))


def learned(piles: list[Pile]) -> Judge:
    """A judge from piles, each of which counts the same."""
    columns = [image.finalists.alone for pile in piles for image in pile.images]
    near: list[Array] = [image.near.astype(float) for pile in piles for image in pile.images]
    weights: list[Array] = [np.full(len(image.near), weight(pile)) for pile in piles for image in pile.images]
    alone = fitted(columns, near, weights, ALONE)
    columns, right, weights = [], [], []
    for pile in piles:
        for image in pile.images:
            logit = alone.logit(image.finalists.alone)
            among, kept = neighbors(image, logit)
            columns.append({name: column[kept] for name, column in among.items()})
            right.append(image.right(logit, kept)[kept])
            weights.append(np.full(int(kept.sum()), weight(pile)))
    return Judge(FORMAT, alone, fitted(columns, right, weights, tuple(columns[0])))


def weight(pile: Pile) -> float:
    return 1.0 / sum(len(image.near) for image in pile.images)


def neighbors(image: Image, logit: Array) -> tuple[dict[str, Array], NDArray[np.bool_]]:
    share, kept = image.explained(logit)
    fits, alone, pairs, deep = image.finalists
    return neighbor_columns(logit, alone["agreement"], fits.evidence, share, kept, pairs, deep), kept


def fitted(
    columns: list[dict[str, Array]], right: list[Array], weights: list[Array], names: tuple[str, ...]
) -> Regression:
    """A logistic regression with a ridge, by L-BFGS."""
    x = np.stack([np.concatenate([part[name] for part in columns]) for name in names], 1)
    y, w = torch.tensor(np.concatenate(right)), torch.tensor(np.concatenate(weights))
    center, scale = x.mean(0), x.std(0) + 1e-6
    inputs = torch.tensor(np.clip((x - center) / scale, -FARTHEST, FARTHEST))
    parameters = torch.zeros(len(names) + 1, dtype=torch.double, requires_grad=True)
    optimizer = torch.optim.LBFGS([parameters], max_iter=200, line_search_fn="strong_wolfe")

    def loss() -> torch.Tensor:
        optimizer.zero_grad()
        logit = inputs @ parameters[1:] + parameters[0]
        each = torch.nn.functional.binary_cross_entropy_with_logits(logit, y, reduction="none")
        total = (w * each).sum() / w.sum() + RIDGE * parameters[1:].square().sum()
        total.backward()
        return total

    optimizer.step(loss)
    found = parameters.detach().numpy()
    terms = {
        name: (round(float(c), 4), round(float(s), 5), round(float(v), 4))
        for name, c, s, v in zip(names, center, scale, found[1:], strict=True)
    }
    return Regression(round(float(found[0]), 4), terms)


def as_text(judge: Judge) -> str:
    """judge.json, one input a line."""
    parts = []
    for name, regression in (("alone", judge.alone), ("among", judge.among)):
        terms = ",\n".join(f"   {json.dumps(key)}: {json.dumps(term)}" for key, term in regression.terms.items())
        parts.append(f' "{name}": {{"bias": {regression.bias}, "terms": {{\n{terms}\n }}}}')
    return f'{{"format": "{FORMAT}",\n' + ",\n".join(parts) + "\n}\n"


Scored = list[tuple[Array, NDArray[np.bool_]]]  # an image's scores and who is kept


def by_judge(judge: Judge, pile: Pile) -> Scored:
    found = []
    for image in pile.images:
        among, kept = neighbors(image, judge.alone.logit(image.finalists.alone))
        score = np.where(kept, probability(judge.among.logit(among)), 0.0)
        found.append((without_impossible_pairs(score, image.finalists.pairs[image.finalists.deep > 1.0]), kept))
    return found


def by_constants(pile: Pile) -> Scored:
    found = []
    for image in pile.images:
        fits = image.finalists.fits
        share, kept = image.explained(fits.evidence)
        left = fits.evidence - share * fits.agreement
        found.append((probability(BEFORE_STEEPNESS * (left - BEFORE_HALF_SURE)), kept))
    return found


def ap_of(pile: Pile, scored: Scored, visibility: float) -> Result:
    images = [
        PredictionImage(image.id, image.finalists.fits.cam_from_obj[kept], score[kept])
        for image, (score, kept) in zip(pile.images, scored, strict=True)
    ]
    return average_precision(Predictions(pile.model.name, images), pile.truth, min_visibility=visibility)


def told(pile: Pile, scored: Scored) -> tuple[Array, Array]:
    """Scores of what is kept, and which is right."""
    pairs = [
        (score[kept], image.right(score, kept)[kept]) for image, (score, kept) in zip(pile.images, scored, strict=True)
    ]
    return np.concatenate([p for p, _ in pairs]), np.concatenate([r for _, r in pairs])


def error_of(score: Array, right: Array) -> float:
    found = calibration(score, right > 0)
    assert found is not None
    return found.error


def table(piles: list[Pile]) -> None:
    """A row a pile, then all together."""
    print("| pile | poses | ECE before | judge | AP >= 50 % before | judge | difference [95 %] | AP >= 30 % before "
          "| judge | difference [95 %] | above 0.5, none right: before | judge |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|---|---|---|---|")
    every: list[tuple[Array, Array, Array, Array]] = []
    for name in dict.fromkeys(pile.object for pile in piles):
        judge = learned([pile for pile in piles if pile.object != name and pile.sensor != UNSEEN_SENSOR])
        for one in (pile for pile in piles if pile.object == name):
            before, now = by_constants(one), by_judge(judge, one)
            old, new = told(one, before), told(one, now)
            every.append((*old, *new))
            cells = [one.name, str(len(new[0])), f"{error_of(*old):.3f}", f"{error_of(*new):.3f}"]
            for visibility in VISIBILITIES:
                if one.foreign:
                    cells += ["", "", ""]
                    continue
                outcome = compare(ap_of(one, before, visibility), ap_of(one, now, visibility), 1000)
                cells += [f"{outcome.first.value:.4f}", f"{outcome.second.value:.4f}", str(outcome.difference)]
            wrong = [str(int((score > 0.5).sum())) for score, _ in (old, new)] if one.foreign else ["", ""]
            print("| " + " | ".join([*cells, *wrong]) + " |", flush=True)
    old_score, old_right, score, right = (np.concatenate(parts) for parts in zip(*every, strict=True))
    print(f"\nECE of all: before {error_of(old_score, old_right):.4f}, "
          f"judge {error_of(score, right):.4f}\n")  # fmt: skip
    print("| score | poses before | share right | poses by the judge | mean score | share right |")
    print("|---|---|---|---|---|---|")
    for k in range(BINS):
        old_in, now_in = (np.minimum((s * BINS).astype(int), BINS - 1) == k for s in (old_score, score))
        means = [
            f"{part.mean():.3f}" if len(part) else "" for part in (old_right[old_in], score[now_in], right[now_in])
        ]
        print(f"| {k / BINS:.1f} | {old_in.sum()} | {means[0]} | {now_in.sum()} | {means[1]} | {means[2]} |")


if __name__ == "__main__":
    main()
