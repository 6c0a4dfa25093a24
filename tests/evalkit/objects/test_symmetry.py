"""Groups are groups, equivalent poses are at distance 0, and the closest equivalent is the closest."""

from __future__ import annotations

import json

import numpy as np
import pytest

from evalkit.errors import InputError
from evalkit.geometry import poses
from evalkit.objects.model import ObjectModel
from evalkit.objects.symmetry import MAX_FOLD, Symmetry

ORDERS = {
    "none": 1, "cyclic:2": 2, "cyclic:7": 7, "dihedral:1": 2, "dihedral:2": 4, "dihedral:5": 10, "tetrahedral": 12,
    "octahedral": 24, "icosahedral": 60, "revolution": 1, "revolution-flip": 2, "sphere": 1,
}  # fmt: skip
FINITE = [name for name in ORDERS if not name.startswith(("revolution", "sphere"))]
FRAME = poses.random_rotations(np.random.default_rng(5), 1)[0]


@pytest.fixture(params=ORDERS)
def symmetry(request: pytest.FixtureRequest) -> Symmetry:
    return Symmetry.parse(request.param, FRAME)


def equivalent(symmetry: Symmetry, rotation: np.ndarray, seed: int = 0) -> np.ndarray:
    """A rotation that shows the same picture."""
    rng = np.random.default_rng(seed)
    if symmetry.kind == "sphere":
        return rotation @ poses.random_rotations(rng, 1)[0]
    element = symmetry.rotations[rng.integers(len(symmetry.rotations))]
    spin = poses.from_axis_angle(symmetry.axis, rng.uniform(0, 7) if symmetry.kind == "revolution" else 0.0)
    return rotation @ element @ spin


def distance(symmetry: Symmetry, model: ObjectModel, first: np.ndarray, second: np.ndarray) -> float:
    """Sym distance of two rotations about the same center, in meters."""
    fixed = symmetry.representatives(first, np.zeros(3), model.lam_in_obj)[0]
    moving = symmetry.representatives(second, np.zeros(3), model.lam_in_obj)
    return float(np.linalg.norm(moving - fixed, axis=-1).min())


def symmetric_model(symmetry: Symmetry) -> ObjectModel:
    """An object whose covariance obeys the symmetry: small triangles, none hidden by another, and all their copies."""
    rng = np.random.default_rng(1)
    middles = rng.normal([0.5, 0.2, 0.1], 1.0, (10, 1, 3))
    corners = middles / np.linalg.norm(middles, axis=-1, keepdims=True) + rng.normal(0.0, 0.03, (10, 3, 3))
    copies = np.einsum("gij,fkj->gfki", symmetry.elements(steps=12), corners).reshape(-1, 3)
    return ObjectModel.from_mesh("cloud", copies, np.arange(len(copies)).reshape(-1, 3), symmetry)


def test_the_elements_form_a_group(symmetry: Symmetry) -> None:
    elements = symmetry.elements(steps=6)
    assert poses.is_rotation(elements, 1e-9).all()
    assert elements[0] == pytest.approx(np.eye(3), abs=1e-12)
    products = (elements[:, None] @ elements[None]).reshape(-1, 3, 3)
    for product in products:
        assert poses.rotation_angle(product, elements).min() < 1e-6
    angles = poses.rotation_angle(elements[:, None], elements[None])
    assert angles[~np.eye(len(elements), dtype=bool)].min(initial=1.0) > 1e-3


@pytest.mark.parametrize("name", ORDERS)
def test_a_group_has_the_order_of_its_name(name: str) -> None:
    assert len(Symmetry.parse(name).rotations) == ORDERS[name]


@pytest.mark.parametrize(("name", "fold"), [("none", 1), ("cyclic:7", 7), ("dihedral:5", 5), ("octahedral", 4)])
def test_fold_counts_the_turns_about_the_main_axis(name: str, fold: int) -> None:
    assert Symmetry.parse(name, FRAME).fold == fold


def test_equivalent_poses_have_distance_zero(symmetry: Symmetry) -> None:
    model = symmetric_model(symmetry)
    for seed in range(10):
        rotation = poses.random_rotations(np.random.default_rng(seed), 1)[0]
        assert distance(symmetry, model, rotation, equivalent(symmetry, rotation, seed)) < 1e-6 * model.diameter


def test_distance_does_not_depend_on_which_equivalent_is_meant(symmetry: Symmetry) -> None:
    model = symmetric_model(symmetry)
    for seed in range(10):
        a, b = poses.random_rotations(np.random.default_rng(seed), 2)
        plain = distance(symmetry, model, a, b)
        assert distance(symmetry, model, b, a) == pytest.approx(plain, abs=1e-9)
        moved = distance(symmetry, model, equivalent(symmetry, a, seed), equivalent(symmetry, b, seed + 99))
        assert moved == pytest.approx(plain, abs=1e-6)


@pytest.mark.parametrize("name", FINITE)
def test_sym_distance_is_the_root_mean_square_distance_of_the_surface(name: str) -> None:
    """Brégier et al. 2018, equation 8: what the representatives are made for."""
    symmetry = Symmetry.parse(name, FRAME)
    model = symmetric_model(symmetry)
    assert model.vertices is not None and model.faces is not None
    a, b = poses.random_rotations(np.random.default_rng(3), 2)
    corners = model.vertices[model.faces] - model.centroid
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    # exact for quadratic functions: the middles of a triangle's sides, equally weighted
    middles = (corners + corners[:, [1, 2, 0]]) / 2
    rms = min(
        np.sqrt(np.average((((middles @ (a - b @ g).T) ** 2).sum(-1)).mean(1), weights=areas))
        for g in symmetry.rotations
    )
    assert distance(symmetry, model, a, b) == pytest.approx(rms, rel=1e-6)


def test_the_closest_equivalent_is_equivalent_and_closest(symmetry: Symmetry) -> None:
    rng = np.random.default_rng(2)
    rotation, reference = poses.random_rotations(rng, 2)
    closest = symmetry.closest_equivalent(rotation, reference)
    angle = float(poses.rotation_angle(closest, reference))
    everything = [equivalent(symmetry, rotation, seed) for seed in range(300)]
    assert angle <= poses.rotation_angle(np.stack(everything), reference).min() + 1e-7
    model = symmetric_model(symmetry)
    assert distance(symmetry, model, closest, rotation) < 1e-6 * model.diameter


def test_the_closest_equivalent_of_a_batch_is_that_of_each(symmetry: Symmetry) -> None:
    rotations = poses.random_rotations(np.random.default_rng(0), 6).reshape(2, 3, 3, 3)
    references = poses.random_rotations(np.random.default_rng(1), 3)
    batch = symmetry.closest_equivalent(rotations, references)
    for i, j in np.ndindex(2, 3):
        assert batch[i, j] == pytest.approx(symmetry.closest_equivalent(rotations[i, j], references[j]))


def test_a_symmetry_turned_with_its_object_is_the_same_symmetry(symmetry: Symmetry) -> None:
    turn = poses.random_rotations(np.random.default_rng(7), 1)[0]
    turned = symmetry.rotated(turn)
    assert turned.axis == pytest.approx(turn @ symmetry.axis)
    if symmetry.kind != "sphere":  # whose elements are a sample that no turn changes
        assert turned.elements(8) == pytest.approx(turn @ symmetry.elements(8) @ turn.T)


def test_json_keeps_the_symmetry(symmetry: Symmetry) -> None:
    again = Symmetry.from_json(json.loads(json.dumps(symmetry.to_json())))
    assert (again.name, again.kind) == (symmetry.name, symmetry.kind)
    assert again.rotations == pytest.approx(symmetry.rotations)
    assert again.obj_from_sym == pytest.approx(symmetry.obj_from_sym)


def test_any_closed_list_of_rotations_is_a_group() -> None:
    elements = Symmetry.parse("dihedral:3", FRAME).rotations
    group = Symmetry.from_rotations(elements[np.random.default_rng(0).permutation(6)])
    assert group.name == "finite:6"
    assert group.rotations[0] == pytest.approx(np.eye(3))
    again = Symmetry.from_json(json.loads(json.dumps(group.to_json())))
    assert again.name == group.name
    for element in elements:
        assert poses.rotation_angle(element, again.rotations).min() < 1e-6


@pytest.mark.parametrize(
    "elements", [np.eye(3)[None] * 2, Symmetry.parse("cyclic:3").rotations[:2], np.zeros((0, 3, 3))]
)
def test_what_is_no_group_is_refused(elements: np.ndarray) -> None:
    with pytest.raises(InputError, match="symmetry"):
        Symmetry.from_rotations(elements)


@pytest.mark.parametrize(
    "name", ["", "cyclic", "cyclic:0", "cyclic:-1", f"cyclic:{MAX_FOLD + 1}", "Sphere", "dihedral:x"]
)
def test_unknown_names_are_refused_with_the_syntax(name: str) -> None:
    with pytest.raises(InputError, match="cyclic:N"):
        Symmetry.parse(name)


@pytest.mark.parametrize(
    "document",
    [None, {}, {"name": 3}, {"name": "cyclic:2", "obj_from_sym": [[1, 0], [0, 1]]},
     {"name": "cyclic:2", "obj_from_sym": "x"}, {"name": "cyclic:2", "obj_from_sym": (2 * np.eye(3)).tolist()},
     {"name": "finite:2", "rotations": [[["a"]]]}],
)  # fmt: skip
def test_documents_that_are_no_symmetry_are_refused_by_place(document: object) -> None:
    with pytest.raises(InputError, match=r"gt\.json"):
        Symmetry.from_json(document, "gt.json")
