"""3MF packages: units, transforms, components, parts in files of their own."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh

from evalkit.errors import InputError
from evalkit.meshes.read import read_file_mesh

CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
PRODUCTION = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"
BIG = trimesh.creation.box((10, 20, 30))
SMALL = trimesh.creation.box((1, 1, 1))
AWAY = 'transform="1 0 0 0 1 0 0 0 1 50 0 0"'


def mesh(body: trimesh.Trimesh, number: int, kind: str = "model") -> str:
    vertices = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in body.vertices)
    faces = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in body.faces)
    inner = f"<mesh><vertices>{vertices}</vertices><triangles>{faces}</triangles></mesh>"
    return f'<object id="{number}" type="{kind}">{inner}</object>'


def components(number: int, *parts: str) -> str:
    return f'<object id="{number}"><components>{"".join(f"<component {p}/>" for p in parts)}</components></object>'


def model(resources: str, build: str = "", unit: str = 'unit="millimeter"', more: str = "") -> str:
    namespaces = f'xmlns="{CORE}" xmlns:p="{PRODUCTION}" xmlns:b="http://example.org/beams"'
    return f"<model {unit} {namespaces} {more}><resources>{resources}</resources><build>{build}</build></model>"


def package(path: Path, root: str, root_name: str = "3D/3dmodel.model", **parts: str) -> Path:
    kind = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(
            "_rels/.rels", f'<Relationships><Relationship Target="/{root_name}" Type="{kind}"/></Relationships>'
        )
        archive.writestr(root_name, root)
        for name, text in parts.items():
            archive.writestr(f"3D/Objects/{name}.model", text)
    return path


def volume_and_size(path: Path) -> tuple[float, list[float]]:
    found = read_file_mesh(path)
    body = trimesh.Trimesh(found.vertices, found.faces, process=False)
    return float(body.volume), np.round(np.ptp(found.vertices, axis=0), 9).tolist()


@pytest.mark.parametrize(
    ("attribute", "unit"),
    [
        ("", "mm"),
        *((f'unit="{name}"', unit) for name, unit in [("inch", "inch"), ("meter", "m"), ("micron", "micron")]),
    ],
)
def test_the_unit_is_the_stated_one_and_millimeters_by_default(tmp_path: Path, attribute: str, unit: str) -> None:
    path = package(tmp_path / "a.3mf", model(mesh(BIG, 1), '<item objectid="1"/>', attribute))
    assert read_file_mesh(path).unit == unit


def test_components_nest_mirror_and_turn(tmp_path: Path) -> None:
    mirrored, turned = 'transform="-1 0 0 0 1 0 0 0 1 0 0 0"', 'transform="0 1 0 -1 0 0 0 0 1 100 0 0"'
    resources = mesh(BIG, 1) + components(2, f'objectid="1" {mirrored}', f'objectid="1" {turned}')
    path = package(tmp_path / "a.3mf", model(resources, f'<item objectid="2" {AWAY}/><item objectid="2"/>'))
    volume, size = volume_and_size(path)
    assert volume == pytest.approx(24_000)
    assert size == [165, 20, 30]
    assert read_file_mesh(path).vertices[:, 0].max() == pytest.approx(160)


def test_objects_in_files_of_their_own_are_told_apart_by_file_and_number(tmp_path: Path) -> None:
    a, b = 'p:path="/3D/Objects/a.model"', 'p:path="/3D/Objects/b.model"'
    build = '<item objectid="9"/>'
    together = model(components(9, f'{a} objectid="1"', f'{a} objectid="2" {AWAY}'), build)
    path = package(tmp_path / "a.3mf", together, a=model(mesh(BIG, 1) + mesh(SMALL, 2)))
    assert volume_and_size(path) == (pytest.approx(6001), [55.5, 20, 30])
    apart = model(components(9, f'{a} objectid="1"', f'{b} objectid="1" {AWAY}'), build)
    path = package(tmp_path / "b.3mf", apart, a=model(mesh(BIG, 1)), b=model(mesh(SMALL, 1)))
    assert volume_and_size(path) == (pytest.approx(6001), [55.5, 20, 30])


def test_only_what_is_built_counts_and_supports_do_not(tmp_path: Path) -> None:
    resources = mesh(BIG, 1) + mesh(SMALL, 2) + mesh(SMALL, 3, "support")
    path = package(tmp_path / "a.3mf", model(resources, f'<item objectid="1"/><item objectid="3" {AWAY}/>'))
    assert volume_and_size(path) == (pytest.approx(6000), [10, 20, 30])


def test_the_root_model_is_the_one_that_the_package_names(tmp_path: Path) -> None:
    path = package(tmp_path / "a.3mf", model(mesh(BIG, 1), '<item objectid="1"/>'), "3D/part.model")
    assert volume_and_size(path)[0] == pytest.approx(6000)


def test_trimesh_writes_what_is_read(tmp_path: Path) -> None:
    pytest.importorskip("lxml")
    BIG.export(tmp_path / "a.3mf")
    assert volume_and_size(tmp_path / "a.3mf") == (pytest.approx(6000), [10, 20, 30])


@pytest.mark.parametrize(
    ("root", "word"),
    [
        (model(components(1, 'objectid="1"'), '<item objectid="1"/>'), "contains itself"),
        (model(mesh(BIG, 1), '<item objectid="1"/>', more='requiredextensions="b"'), "extension 'b'"),
        (model(mesh(BIG, 1), '<item objectid="1"/>', 'unit="cubit"'), "cubit"),
        (model(mesh(BIG, 1), '<item objectid="2"/>'), "damaged"),
        (model(mesh(BIG, 1), '<item objectid="1" transform="1 0 0"/>'), "damaged"),
        (model(mesh(BIG, 1).replace('v1="0"', 'v1="80"'), '<item objectid="1"/>'), "lacks"),
        (model(mesh(BIG, 1), '<item objectid="1" p:path="/3D/none.model"/>'), "lacks the file"),
        (model(mesh(BIG, 1)), "no triangles"),
        ("<model", "damaged"),
    ],
)
def test_what_cannot_be_built_is_refused_in_a_sentence(tmp_path: Path, root: str, word: str) -> None:
    with pytest.raises(InputError, match=rf"a\.3mf: .*{word}.*export"):
        read_file_mesh(package(tmp_path / "a.3mf", root))
