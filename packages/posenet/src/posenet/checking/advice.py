"""What a model was trained for beside what it meets, each with what to do where they differ."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import Any, NamedTuple

from evalkit.evidence.verdict import Verdict
from posenet.checking.site import Site
from posenet.network.pose_network import PoseNetwork

DISTANCE_SLACK = 1.15  # beyond the trained distances by this factor, nothing is lost yet
FEWEST_PIXELS = 25.0  # across; a part that shows fewer, and fewer than trained on, has no shape to read
FEWER_PIXELS = 0.6  # of the trained sizes
NOISIER = 2.0  # times the noise trained on
MORE_HOLES = 0.1  # beyond the share trained on
LEAST_EXPLAINED = 0.4  # of the heap
MOST_CONTRADICTED = (0.1, 0.34)  # of the decided poses: worth a look, and too many
STEPS = 0.05  # meters, of distances that are advised


class Grade(IntEnum):
    """How serious a finding is."""

    FINE = 0
    DOUBTFUL = 1
    BAD = 2


class Finding(NamedTuple):
    """One thing that was compared; the mend is empty where it is fine."""

    title: str
    here: str
    trained: str
    grade: Grade
    mend: str = ""


VERDICTS = {
    Grade.FINE: "It works here.",
    Grade.DOUBTFUL: "It may work here, but not as well as it could.",
    Grade.BAD: "It does not work here as it is.",
}


def findings(site: Site, network: PoseNetwork, record: dict[str, Any], model: str, frames: str) -> list[Finding]:
    """Everything compared, the poses first; `model` and `frames` are their paths, for commands to type."""
    statistics = record.get("data")
    statistics = statistics if isinstance(statistics, dict) else {}
    return [
        _poses(site, model, frames),
        _explained(site, model, frames),
        _distance(site, network, statistics),
        _pixels(site, network),
        _noise(site, network, statistics, model, frames),
        _holes(site, network, statistics, model, frames),
    ]


def worst(found: list[Finding]) -> Grade:
    return max(finding.grade for finding in found)


def _poses(site: Site, model: str, frames: str) -> Finding:
    verified, contradicted, undecided = (site.count(verdict) for verdict in Verdict)
    here = f"{verified} verified, {contradicted} contradicted, {undecided} undecided on {len(site.images)} images"
    usual = "next to none contradicted"
    if verified == 0:
        mend = "Check the mesh and its unit, the camera file and the unit of depth: no pose is borne out by the images."
        return Finding("Poses", here, usual, Grade.BAD, mend)
    if site.contradicted_share > MOST_CONTRADICTED[1]:
        mend = "Look at the red poses: are those other parts, or is the mesh another version of this one?"
        return Finding("Poses", here, usual, Grade.BAD, mend)
    if site.contradicted_share > MOST_CONTRADICTED[0]:
        mend = f"Let it learn these images: posenet adapt {model} {frames}"
        return Finding("Poses", here, usual, Grade.DOUBTFUL, mend)
    if undecided > verified:
        mend = "Look at the amber poses: is too little of them seen, or do they lie in the plane of a floor or a wall?"
        return Finding("Poses", here, usual, Grade.DOUBTFUL, mend)
    return Finding("Poses", here, usual, Grade.FINE)


def _explained(site: Site, model: str, frames: str) -> Finding:
    here, usual = f"{site.explained:.0%} of the heap", f"{LEAST_EXPLAINED:.0%} or more"
    if site.explained >= LEAST_EXPLAINED:
        return Finding("Explained by verified poses", here, usual, Grade.FINE)
    mend = (
        "Parts are missed, or other things (the bin's walls too) are counted: give --roi or --mask, look at the page; "
        f"if parts are missed: posenet adapt {model} {frames}"
    )
    return Finding("Explained by verified poses", here, usual, Grade.DOUBTFUL, mend)


def _distance(site: Site, network: PoseNetwork, statistics: dict[str, Any]) -> Finding:
    near, far = site.distance
    low, high = statistics.get("distance_m", network.depth_range)
    here, trained = f"{near:.2f} to {far:.2f} m", f"{low:.2f} to {high:.2f} m"
    if near * DISTANCE_SLACK >= low and far <= high * DISTANCE_SLACK:
        return Finding("Distance to the parts", here, trained, Grade.FINE)
    wide = f"{math.floor(near / STEPS) * STEPS:.4g}-{math.ceil(far / STEPS) * STEPS:.4g}"
    return Finding("Distance to the parts", here, trained, Grade.DOUBTFUL, f"Train with --distance {wide}.")


def _pixels(site: Site, network: PoseNetwork) -> Finding:
    low, high = site.pixels
    near, far = network.depth_range
    across = network.camera.fx * network.model.diameter
    smallest, largest = across / far, across / near  # as the network saw them, at its working scale
    here, trained = f"{low:.0f} to {high:.0f} pixels", f"{smallest:.0f} to {largest:.0f} pixels"
    if low < min(FEWEST_PIXELS, smallest / DISTANCE_SLACK):
        mend = "Bring the camera nearer, or use its full resolution: the part shows too little of its shape."
        return Finding("Size of a part", here, trained, Grade.BAD, mend)
    if low < FEWER_PIXELS * smallest:
        mend = "Train with --camera (this one) and --distance as above, or bring the camera nearer."
        return Finding("Size of a part", here, trained, Grade.DOUBTFUL, mend)
    return Finding("Size of a part", here, trained, Grade.FINE)


OLDER = "not known: an older model file does not say; train anew to have it compared"


def _noise(site: Site, network: PoseNetwork, statistics: dict[str, Any], model: str, frames: str) -> Finding:
    here, added = f"{1e3 * site.noise:.2f} mm", network.config.train.augment_noise * network.model.diameter
    if "noise_m" not in statistics:
        return Finding("Noise", here, OLDER, Grade.FINE)
    stored = float(statistics["noise_m"])
    trained = f"{1e3 * stored:.2f} mm, and up to {1e3 * added:.2f} mm drawn on the fly"
    if site.noise <= NOISIER * max(stored, added):
        return Finding("Noise", here, trained, Grade.FINE)
    return Finding("Noise", here, trained, Grade.DOUBTFUL, _sensor(model, frames))


def _holes(site: Site, network: PoseNetwork, statistics: dict[str, Any], model: str, frames: str) -> Finding:
    here = "not known: no part is verified" if site.holes is None else f"{site.holes:.0%} of a part's surface"
    if "holes" not in statistics:
        return Finding("Holes", here, OLDER, Grade.FINE)
    stored, added = float(statistics["holes"]), network.config.train.augment_holes
    trained = f"{stored:.0%}, and up to {added:.0%} drawn on the fly"
    if site.holes is None or site.holes <= max(stored, added) + MORE_HOLES:
        return Finding("Holes", here, trained, Grade.FINE)
    return Finding("Holes", here, trained, Grade.DOUBTFUL, _sensor(model, frames))


def _sensor(model: str, frames: str) -> str:
    return (
        "Train with this camera's errors (simgen sensor fit, then simgen build --sensor), or let it learn these "
        f"images: posenet adapt {model} {frames}"
    )
