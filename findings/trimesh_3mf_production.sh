#!/usr/bin/env bash
# trimesh 5.2.0 reads a 3MF package whose parts lie in files of their own (the Production Extension, as slicers write it)
# wrongly and in silence: a component names one object of a part file and gets all meshes of that file, whatever their
# numbers; and objects of two files that carry the same number become one. The package below holds a box of 6000 mm3 and
# one of 1 mm3, each used once: 6001 mm3. Seen: "together 12002" and "apart 12002".
# Exits 0 while trimesh behaves so, non-zero once that changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet trimesh==5.2.0 "numpy<3" lxml networkx scipy
cd "$folder"
venv/bin/python - <<'PYTHON'
import sys
import zipfile

import trimesh

SPACES = ('xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02" '
          'xmlns:p="http://schemas.microsoft.com/3dmanufacturing/production/2015/06"')
AWAY = 'transform="1 0 0 0 1 0 0 0 1 50 0 0"'


def mesh(body, number):
    vertices = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in body.vertices)
    faces = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in body.faces)
    inner = f"<mesh><vertices>{vertices}</vertices><triangles>{faces}</triangles></mesh>"
    return f'<object id="{number}" type="model">{inner}</object>'


def model(resources, build=""):
    return f'<model unit="millimeter" {SPACES}><resources>{resources}</resources><build>{build}</build></model>'


def volume(name, components, **parts):
    inner = "".join(f"<component {component}/>" for component in components)
    with zipfile.ZipFile(name, "w") as archive:
        root = f'<object id="9" type="model"><components>{inner}</components></object>'
        archive.writestr("3D/3dmodel.model", model(root, '<item objectid="9"/>'))
        for part, text in parts.items():
            archive.writestr(f"3D/Objects/{part}.model", text)
    return round(trimesh.load_scene(name, process=False).to_mesh().volume)


big, small = trimesh.creation.box((10, 20, 30)), trimesh.creation.box((1, 1, 1))
a, b = 'p:path="/3D/Objects/a.model"', 'p:path="/3D/Objects/b.model"'
together = volume("together.3mf", [f'{a} objectid="1"', f'{a} objectid="2" {AWAY}'],
                  a=model(mesh(big, 1) + mesh(small, 2)))
apart = volume("apart.3mf", [f'{a} objectid="1"', f'{b} objectid="1" {AWAY}'],
               a=model(mesh(big, 1)), b=model(mesh(small, 1)))
print("trimesh", trimesh.__version__, "together", together, "apart", apart, "(6001 is right)")
sys.exit((together, apart) != (12002, 12002))
PYTHON
