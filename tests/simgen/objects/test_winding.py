"""Every closed body is wound outwards on its own; true cavities stay cavities."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from simgen.objects.mending import mend
from simgen.objects.winding import signed_volume, wound_outwards

Mesh = trimesh.Trimesh


def box(side: float, at: float = 0.0, inverted: bool = False) -> Mesh:
    body = trimesh.creation.box([side] * 3).apply_translation([at, 0.1, 0.2])
    if inverted:
        body.invert()
    return body


def volumes(*bodies: Mesh) -> list[float]:
    """Of each body as it comes out of winding, in the order in which they went in."""
    joined = trimesh.util.concatenate(list(bodies))
    faces = wound_outwards(np.array(joined.vertices), np.array(joined.faces)).faces
    cuts = np.cumsum([len(body.faces) for body in bodies])[:-1]
    return [round(signed_volume(joined.vertices, part), 6) for part in np.split(faces, cuts)]


@pytest.mark.parametrize("first", [False, True])
@pytest.mark.parametrize("second", [False, True])
@pytest.mark.parametrize("third", [False, True])
def test_bodies_side_by_side_are_wound_outwards_whatever_the_file_says(first: bool, second: bool, third: bool) -> None:
    assert volumes(box(1, 0, first), box(2, 5, second), box(3, 10, third)) == [1, 8, 27]


@pytest.mark.parametrize("whole_file_inverted", [False, True])
def test_a_cavity_stays_a_cavity_and_an_inner_body_a_body(whole_file_inverted: bool) -> None:
    turned = whole_file_inverted
    assert volumes(box(4, 0, turned), box(2, 0, not turned)) == [64, -8]
    assert volumes(box(4, 0, turned), box(2, 0, turned)) == [64, 8]


@pytest.mark.parametrize("inverted", [False, True])
def test_a_body_within_a_cavity_is_wound_outwards(inverted: bool) -> None:
    assert volumes(box(4), box(3, 0, True), box(1, 0, inverted)) == [64, -27, 1]


def test_a_body_beside_a_hollow_one_is_no_cavity() -> None:
    assert volumes(box(4), box(2, 0, True), box(1, 9, True)) == [64, -8, 1]


def test_mended_volume_is_that_of_the_material() -> None:
    joined = trimesh.util.concatenate([box(4), box(2, 0, True), box(1, 9, True)])
    mesh = mend(np.array(joined.vertices), np.array(joined.faces))
    assert mesh.volume == pytest.approx(64 - 8 + 1)
    assert any("1 closed body was inside out, of 3" in warning for warning in mesh.warnings)


@pytest.mark.parametrize("seed", range(4))
def test_faces_turned_at_random_in_several_bodies_agree_again(seed: int) -> None:
    bodies = [trimesh.creation.icosphere(2, 1.0), trimesh.creation.torus(1.0, 0.3).apply_translation([5, 0, 0])]
    joined = trimesh.util.concatenate(bodies)
    faces = np.array(joined.faces)
    flip = np.random.default_rng(seed).random(len(faces)) < 0.4
    faces[flip] = faces[flip, ::-1]
    winding = wound_outwards(np.array(joined.vertices), faces)
    assert not winding.were_alike and winding.are_alike
    assert signed_volume(joined.vertices, winding.faces) == pytest.approx(sum(body.volume for body in bodies))


def test_a_moebius_strip_has_no_outside_and_is_said_to_have_none() -> None:
    n = 40
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    rim = [
        np.stack(
            [
                (1 + s * np.cos(angle / 2)) * np.cos(angle),
                (1 + s * np.cos(angle / 2)) * np.sin(angle),
                s * np.sin(angle / 2),
            ],
            -1,
        )
        for s in (-0.3, 0.3)
    ]
    i = np.arange(n - 1)
    faces = [np.stack([i, i + 1, i + n], -1), np.stack([i + 1, i + n + 1, i + n], -1)]
    faces.append(np.array([[n - 1, n, 2 * n - 1], [n, 0, 2 * n - 1]]))  # joined with a half turn
    winding = wound_outwards(np.concatenate(rim), np.concatenate(faces))
    assert not winding.are_alike
