"""simgen follows evalkit's policy of units."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest
import trimesh

from evalkit.meshes.load import load_object
from evalkit.meshes.units import CHOICES
from simgen.objects.prepare import prepare_object


def test_both_commands_read_one_file_in_one_unit_and_warn_alike(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "part.stl"
    trimesh.creation.box((8.0, 5.0, 3.0)).export(path)
    for units in CHOICES:
        caplog.clear()
        with caplog.at_level(logging.WARNING):
            model = load_object(path, units, "none")
        prepared = prepare_object(str(path), units, symmetry="none")
        assert prepared.model.notes["units"] == model.notes["units"]
        assert prepared.model.diameter == pytest.approx(model.diameter)
        assert [record.getMessage().partition(": ")[2] for record in caplog.records] == prepared.warnings
