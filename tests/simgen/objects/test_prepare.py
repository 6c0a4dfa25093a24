"""From a file or a name to an object in meters: the same object, however it is written down."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from evalkit.atomic import sha256_of_file
from evalkit.errors import InputError
from evalkit.objects.symmetry import Symmetry
from evalkit.objects.symmetry_detection import DetectedSymmetry
from evalkit.objects.symmetry_fit import SymmetryCandidate
from simgen.objects import prepare as meshes
from simgen.objects.builtin import BUILTIN_OBJECTS
from simgen.objects.prepare import _near_misses, describe, prepare_object

BRICK = trimesh.creation.box((0.05, 0.08, 0.12))


@pytest.fixture(autouse=True)
def no_convex_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """The convex parts have tests of their own; here the mesh stands in for them."""
    monkeypatch.setattr(meshes, "convex_parts", lambda vertices, faces: ([(vertices, faces)], []))


def brick_file(folder: Path, meters_per_unit: float = 1.0, name: str = "brick.stl") -> str:
    mesh = BRICK.copy()
    mesh.apply_scale(1 / meters_per_unit)
    mesh.export(folder / name)
    return str(folder / name)


@pytest.mark.parametrize("name", ["brick.ply", "brick.stl", "brick.obj", "brick.off"])
@pytest.mark.parametrize("meters_per_unit", [1.0, 1e-3])
def test_meters_and_millimeters_give_the_same_object(tmp_path: Path, name: str, meters_per_unit: float) -> None:
    prepared = prepare_object(brick_file(tmp_path, meters_per_unit, name))
    assert prepared.warnings == []
    assert prepared.model.diameter == pytest.approx(np.linalg.norm(BRICK.extents), rel=1e-5)
    assert prepared.model.symmetry.name == "dihedral:2"
    assert prepared.mesh.volume == pytest.approx(BRICK.volume, rel=1e-5)
    assert prepared.model.notes["units"] == {1.0: "m", 1e-3: "mm"}[meters_per_unit]


@pytest.mark.parametrize("scale", [0.5, 3.0])
@pytest.mark.parametrize("units", ["m", "mm"])
def test_units_and_scale_multiply(tmp_path: Path, scale: float, units: str) -> None:
    meters = {"m": 1.0, "mm": 1e-3}[units]
    prepared = prepare_object(brick_file(tmp_path, meters), units=units, scale=scale, symmetry="none")
    assert prepared.model.diameter == pytest.approx(scale * np.linalg.norm(BRICK.extents), rel=1e-5)
    assert prepared.mesh.volume == pytest.approx(scale**3 * BRICK.volume, rel=1e-5)
    assert np.ptp(prepared.convex_parts[0][0], axis=0) == pytest.approx(scale * BRICK.extents, rel=1e-5)


def test_the_decision_on_units_is_kept_and_told(tmp_path: Path) -> None:
    path = brick_file(tmp_path, 1e-3)
    prepared = prepare_object(path, scale=2.0)
    notes = prepared.model.notes
    assert notes == {
        "source": "brick.stl",
        "sha256": sha256_of_file(path),
        "units": "mm",
        "scale": 2.0,
        "symmetry_from": "mesh",
    }
    assert "millimeters" in prepared.summary and "160 x 240" in prepared.summary.replace("100 x ", "")
    assert "dihedral:2" in prepared.summary


def test_an_uncertain_unit_is_told(tmp_path: Path) -> None:
    prepared = prepare_object(brick_file(tmp_path), scale=0.5, units="auto")
    assert prepared.warnings == []
    doubtful = prepare_object(brick_file(tmp_path, 0.12 / 1.5))
    assert len(doubtful.warnings) == 1 and "--units inch" in doubtful.warnings[0]


@pytest.mark.parametrize("name", BUILTIN_OBJECTS)
def test_built_in_objects_need_no_file_and_give_no_warning(name: str) -> None:
    prepared = prepare_object(name, symmetry="none")
    assert prepared.warnings == []
    assert prepared.model.name == name
    assert prepared.mesh.is_watertight


def test_a_file_that_is_not_here_is_the_built_in_object_of_its_name_and_that_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    prepared = prepare_object("gear.ply")
    assert prepared.model.diameter == prepare_object("gear").model.diameter
    assert any("the built-in object 'gear' is taken" in warning for warning in prepared.warnings)
    Path("gear.stl").write_bytes(Path(brick_file(tmp_path)).read_bytes())
    assert not any("built-in" in warning for warning in prepare_object("gear.stl").warnings)


@pytest.mark.parametrize("source", ["parts/gear.ply", "gear.txt", "wheel.ply"])
def test_a_path_that_leads_nowhere_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, source: str) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="no such file"):
        prepare_object(source)


def test_an_object_is_named_by_its_file_or_as_asked(tmp_path: Path) -> None:
    path = brick_file(tmp_path)
    assert prepare_object(path).model.name == Path(path).stem
    assert prepare_object(path, name="sileane_bunny").model.name == "sileane_bunny"


def test_a_given_symmetry_is_obeyed_and_doubted(tmp_path: Path) -> None:
    path = brick_file(tmp_path)
    right = prepare_object(path, symmetry="cyclic:2")
    assert right.model.symmetry.name == "cyclic:2" and right.warnings == []
    wrong = prepare_object(path, symmetry="revolution@z")
    assert wrong.model.symmetry.name == "revolution"
    assert wrong.model.symmetry.axis == pytest.approx([0, 0, 1])
    assert len(wrong.warnings) == 1 and "not that symmetric" in wrong.warnings[0]
    assert right.model.notes["symmetry_from"] == "user"


def test_what_is_said_of_a_symmetry_names_its_residual(tmp_path: Path) -> None:
    assert "residual" in describe(prepare_object(brick_file(tmp_path)).symmetry)
    assert describe(prepare_object("bunny").symmetry).startswith("none (nearest: ")
    assert describe(prepare_object("bunny", symmetry="none").symmetry) == "none"


@pytest.mark.parametrize(
    ("missed_by", "detected", "asked", "said"),
    [
        (5e-4, "none", "auto", True),
        (5e-4, "cyclic:2", "auto", True),
        (2e-3, "none", "auto", False),
        (5e-4, "revolution", "auto", False),
        (5e-4, "none", "none", False),
    ],
    ids=["a thread", "a larger group", "a keyway", "a smaller group", "not asked"],
)
def test_a_symmetry_that_is_missed_by_little_is_named_with_what_to_say(
    missed_by: float, detected: str, asked: str, said: bool
) -> None:
    """A bolt of 34 mm whose head has six sides."""
    candidate = SymmetryCandidate(Symmetry.parse("cyclic:6"), 0.8 * missed_by, missed_by, 1.4, 1.4)
    found = DetectedSymmetry(Symmetry.parse(detected), 0.0, 0.0, [candidate])
    assert any("say --symmetry cyclic:6" in sentence for sentence in _near_misses(found, asked, 0.034)) == said


FLAT = trimesh.Trimesh([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0.1, 0.1, 0]], [[0, 1, 2], [1, 3, 2]])
BAD_OPTIONS: list[dict[str, object]] = [
    {"scale": 0.0},
    {"scale": -1.0},
    {"scale": float("nan")},
    {"scale": float("inf")},
    {"scale": 1e-9},
    {"scale": 1e9},
    {"units": "foot"},
    {"symmetry": "cyclic:0"},
    {"symmetry": "round"},
    {"symmetry": "revolution@w"},
    {"symmetry": "revolution@0,0,0"},
    {"symmetry": ""},
    {"name": " "},
]


@pytest.mark.parametrize("options", BAD_OPTIONS, ids=str)
def test_an_option_that_makes_no_sense_is_refused_in_one_sentence(tmp_path: Path, options: dict[str, object]) -> None:
    with pytest.raises(InputError) as error:
        prepare_object(brick_file(tmp_path), **options)  # type: ignore[arg-type]
    assert str(error.value).endswith(".") and "\n" not in str(error.value)


def test_what_is_no_body_is_refused_by_name(tmp_path: Path) -> None:
    one = trimesh.Trimesh([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]], [[0, 1, 2]], process=False)
    line = trimesh.Trimesh([[0, 0, 0], [0.1, 0, 0], [0.2, 0, 0]], [[0, 1, 1]], process=False)
    for name, mesh in {"flat.ply": FLAT, "one.ply": one, "line.ply": line}.items():
        mesh.export(tmp_path / name)
        with pytest.raises(InputError, match=name):
            prepare_object(str(tmp_path / name))


@pytest.mark.parametrize("size", [1e-6, 2500.0 * 4, 1e6])
def test_a_size_plausible_in_no_unit_is_refused(tmp_path: Path, size: float) -> None:
    with pytest.raises(InputError, match=r"--units"):
        prepare_object(brick_file(tmp_path, 0.12 / size))


def test_an_unknown_name_lists_the_built_in_objects() -> None:
    with pytest.raises(InputError, match="bunny"):
        prepare_object("rabbit")


def test_a_stray_vertex_does_not_change_the_unit_or_size(tmp_path: Path) -> None:
    text = trimesh.exchange.obj.export_obj(BRICK) + "\nv 5000 0 0\n"
    (tmp_path / "brick.obj").write_text(text)
    prepared = prepare_object(str(tmp_path / "brick.obj"))
    assert prepared.model.notes["units"] == "m"
    assert prepared.model.diameter == pytest.approx(np.linalg.norm(BRICK.extents), rel=1e-5)
