"""From a mesh file to an object."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from evalkit.errors import InputError
from evalkit.meshes import load
from evalkit.objects import symmetry_detection
from evalkit.objects.symmetry import Symmetry


@pytest.fixture
def pyramid(tmp_path: Path) -> Path:
    path = tmp_path / "pyramid.stl"
    trimesh.creation.cone(0.5, 1.0, sections=4).export(path)
    return path


def test_the_unit_scales_the_object_and_is_noted(pyramid: Path) -> None:
    model = load.load_object(pyramid, "inch", "none")
    assert (model.name, model.notes["units"]) == ("pyramid", "inch")
    assert model.vertices is not None and np.ptp(model.vertices, axis=0).max() == pytest.approx(0.0254)
    with pytest.raises(InputError, match=r"pyramid\.stl: its largest side of 1e\+04 .*--units"):
        trimesh.creation.box((1e4, 1, 1)).export(pyramid)
        load.load_object(pyramid, None)


@pytest.mark.parametrize(("given", "asked"), [(None, "auto"), ("cyclic:4@z", "cyclic:4@z")])
def test_the_symmetry_is_found_unless_it_is_given(
    pyramid: Path, monkeypatch: pytest.MonkeyPatch, given: str | None, asked: str
) -> None:
    heard = []

    def resolve(vertices: object, faces: object, spec: str) -> symmetry_detection.DetectedSymmetry:
        heard.append(spec)
        return symmetry_detection.DetectedSymmetry(Symmetry.parse("cyclic:4"), 0.0, 0.0, [])

    monkeypatch.setattr(load, "resolve_symmetry", resolve)
    assert load.load_object(pyramid, "cm", given).symmetry.name == "cyclic:4"
    assert heard == [asked]
