"""What the rerun viewer is told. Skipped where rerun is not installed (pip install 'binpose-simgen[view]')."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

from evalkit.datasets.shard_folder import ShardDataset
from simgen.commands.cli import cli


def typed(*words: object) -> Result:
    return CliRunner().invoke(cli, [str(word) for word in words])


@pytest.fixture(scope="module")
def recorded(debug_shards: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Any]]:
    """Every component's values over all frames, by ``entity:Archetype:component``."""
    pytest.importorskip("rerun", reason="rerun is not installed")
    chunk = pytest.importorskip("rerun.chunk", reason="this rerun cannot read recordings")
    path = tmp_path_factory.mktemp("rerun") / "scenes.rrd"
    done = typed("view", debug_shards, "--save", path)
    assert done.exit_code == 0, done.output
    found: dict[str, list[Any]] = {}
    parts = [(part.entity_path, part.to_record_batch()) for part in chunk.RrdReader(str(path)).stream()]
    batches = [
        (entity, batch.drop_columns([n for n in batch.schema.names if n == "log_time"])) for entity, batch in parts
    ]
    rows = [
        (row.get("frame") or 0, f"{entity}:{name}", value)
        for entity, batch in batches
        for row in batch.to_pylist()
        for name, value in row.items()
        if ":" in name and value is not None
    ]
    for _, name, value in sorted(rows, key=lambda row: row[:2]):
        found.setdefault(name, []).append(value)
    return found


def test_every_frame_has_its_camera_depth_and_visible_boxes(recorded: dict[str, list[Any]], debug_shards: Path) -> None:
    dataset = ShardDataset(debug_shards)
    for name in ("/world/camera:Pinhole:image_from_camera", "/world/camera/depth:DepthImage:buffer",
                 "/world/camera/instances:SegmentationImage:buffer"):  # fmt: skip
        assert len(recorded[name]) == len(dataset)
    for view, buffer, boxes, place in zip(
        dataset,
        recorded["/world/camera/depth:DepthImage:buffer"],
        recorded["/world/camera/instances/visible:Boxes2D:labels"],
        recorded["/world/camera:Transform3D:translation"],
        strict=True,
    ):
        depth = np.frombuffer(np.array(buffer[0], np.uint8).tobytes(), "<u2").reshape(view.depth_raw.shape)
        assert (depth == view.depth_raw).all()
        assert len(boxes) == (view.instances.pixels_returned > 0).sum()
        assert place[0] == pytest.approx(np.linalg.inv(view.cam_from_world)[:3, 3], abs=1e-6)


def test_instances_stand_where_the_labels_say_and_leave_with_their_scene(
    recorded: dict[str, list[Any]], debug_shards: Path
) -> None:
    dataset = ShardDataset(debug_shards)
    views = [dataset[int(np.argmax(dataset.scene_index == scene))] for scene in np.unique(dataset.scene_index)]
    shown = [len(view.instances) for view in views]
    for number in range(max(shown)):
        scenes = [view for view, count in zip(views, shown, strict=True) if number < count]
        told = recorded[f"/world/instances/{number:03d}:Transform3D:translation"]
        wanted = [(np.linalg.inv(v.cam_from_world) @ v.instances.cam_from_obj)[number, :3, 3] for v in scenes]
        assert np.array(told)[:, 0] == pytest.approx(np.array(wanted), abs=1e-6)
    gone = {name for name in recorded if ":Clear:" in name}
    assert len(gone) == max(0, max(shown[:-1]) - shown[-1])


def test_the_bin_is_that_of_the_build(recorded: dict[str, list[Any]]) -> None:
    assert recorded["/world/bin:Boxes3D:half_sizes"][0][0] == pytest.approx([0.15, 0.15, 0.05], abs=1e-6)


@pytest.mark.parametrize("words", [["--save", "scenes.txt"], ["--scenes", 0], []])
def test_what_cannot_be_shown_is_told_in_one_sentence(
    words: list[object], debug_shards: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not words:
        pytest.importorskip("rerun", reason="rerun is not installed")
    for variable in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(variable, raising=False)
    done = typed("view", debug_shards, *words)
    assert done.exit_code == 2
    assert len(done.output.splitlines()) == 1 and done.output.startswith("Error: ")


def test_without_rerun_a_sentence_says_how_to_get_it(
    debug_shards: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    done = typed("view", debug_shards, "--save", tmp_path / "scenes.rrd")
    assert done.exit_code == 2
    assert "pip install 'binpose-simgen[view]'" in done.output
    assert not list(tmp_path.iterdir())
