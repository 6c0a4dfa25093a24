"""Pictures that explain a trained network: its bins, one detection's hypotheses, what hypotheses know of each other."""

from __future__ import annotations

from pathlib import Path

from evalkit.datasets.shard_folder import ShardDataset
from evalkit.drawing.plots import save
from evalkit.errors import InputError
from posenet.figures.angle_bins import draw_bins
from posenet.figures.looked_at import look_at
from posenet.figures.one_detection import draw_hypotheses
from posenet.figures.relations import draw_relations
from posenet.network.pose_network import PoseNetwork


def draw_figures(network: PoseNetwork, shards: Path, out: Path, frame: int = 0) -> list[Path]:
    """Write bins.png, hypotheses.png and relations.png into `out`, the last two on one frame of the shards.

    Raises:
        InputError: the shards hold no such frame, or the network finds nothing on it.
    """
    dataset = ShardDataset(shards)
    if not 0 <= frame < len(dataset):
        raise InputError(f"--frame {frame}: {shards} holds the frames 0 to {len(dataset) - 1}.")
    looked = look_at(network, dataset[frame])
    drawn = {"bins": draw_bins(network), "hypotheses": draw_hypotheses(looked), "relations": draw_relations(looked)}
    paths = [out / f"{name}.png" for name in drawn]
    for path, figure in zip(paths, drawn.values(), strict=True):
        save(figure, path)
    return paths
