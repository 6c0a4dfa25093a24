"""A part as strangers export it: every format that is read, with the habits of its writers, for `cad_table.py`."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from cad_parts import Array, Part, mesh_of
from cad_step import faceted_step

Faces = NDArray[np.int64]
Y_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
INCH, METER = 25.4, 1000.0  # millimeters
MOST_STEP_FACES = 3000  # of a faceted STEP file: Open CASCADE takes seconds for a thousand planes


@dataclass(frozen=True)
class Export:
    """A written file, its `units` where it does not state them and they are unusual, and its `turn` of the part."""

    path: Path
    units: str = "auto"
    turn: Array = field(default_factory=lambda: np.eye(3))


def stl_binary(part: Part, path: Path) -> Export:
    """The header begins with the word that text files begin with; something of the program's own follows the facets."""
    vertices, faces = part.mesh()
    corners = vertices[faces].astype("<f4")
    facets = np.zeros(len(faces), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    facets["corners"] = corners
    header = b"solid " + part.name.encode()[:60]
    path.write_bytes(header.ljust(80) + np.uint32(len(faces)).tobytes() + facets.tobytes() + b"made by a benchmark")
    return Export(path)


def stl_text(part: Part, path: Path) -> Export:
    """A solid a body, with words of the format in their names."""
    lines = []
    for number, body in enumerate(part.bodies):
        vertices, faces = mesh_of(body)
        lines.append(f"solid facet {part.name} loop {number}")
        for a, b, c in vertices[faces]:
            lines += ["facet normal 0 0 0", " outer loop"]
            lines += [f"  vertex {x:.6e} {y:.6e} {z:.6e}" for x, y, z in (a, b, c)] + [" endloop", "endfacet"]
        lines.append(f"endsolid facet {part.name}")
    path.write_text("\n".join(lines) + "\n")
    return Export(path)


def stl_repeated(part: Part, path: Path) -> Export:
    """In assembly coordinates 1.5 m off, every seventh facet twice."""
    vertices, faces = part.mesh()
    faces = np.concatenate([faces, faces[::7]])
    trimesh.Trimesh(vertices + np.array([1500.0, -200.0, 90.0]), faces, process=False).export(path)
    return Export(path)


def obj_inches(part: Part, path: Path) -> Export:
    """Polygons of any number of corners; texture and normal indices; an object a body."""
    lines, start = ["# made by a benchmark", "mtllib none.mtl", "vt 0 0", "vn 0 0 1"], 1
    for number, body in enumerate(part.bodies):
        vertices, faces = mesh_of(body)
        lines.append(f"o body {number}")
        lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices / INCH]
        lines += ["f " + " ".join(f"{start + i}/1/1" for i in polygon) for polygon in polygons(vertices, faces)]
        start += len(vertices)
    path.write_text("\n".join(lines) + "\n")
    return Export(path, "inch")


def ply_meters(part: Part, path: Path) -> Export:
    """Polygons, text, float32's digits."""
    vertices, faces = part.mesh()
    rows = polygons(vertices, faces)
    head = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}", *(f"property float {x}" for x in "xyz")]
    head += [f"element face {len(rows)}", "property list uchar int vertex_indices", "end_header"]
    lines = [f"{x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices / METER]
    lines += [f"{len(row)} " + " ".join(map(str, row)) for row in rows if len(row) < 256]
    path.write_text("\n".join(head + lines) + "\n")
    return Export(path)


def off_polygons(part: Part, path: Path) -> Export:
    """Wound the wrong way round, with colors."""
    vertices, faces = part.mesh()
    rows = polygons(vertices, faces)
    lines = ["OFF", "# made by a benchmark", f"{len(vertices)} {len(rows)} 0"]
    lines += [f"{x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices]
    lines += [f"{len(row)} " + " ".join(map(str, reversed(row))) + " 200 200 200" for row in rows]
    path.write_text("\n".join(lines) + "\n")
    return Export(path)


def glb_nodes(part: Part, path: Path) -> Export:
    """A node a body, each in a frame of its own, in a scene with y up."""
    scene = trimesh.Scene()
    for number, body in enumerate(part.bodies):
        vertices, faces = mesh_of(body)
        place = np.eye(4)
        own = trimesh.transformations.rotation_matrix(0.7 + number, [1, 2, 3], [0.1, 0, 0])
        local = trimesh.transform_points(vertices / METER, np.linalg.inv(own))
        place[:3, :3] = Y_UP
        scene.add_geometry(trimesh.Trimesh(local, faces, process=False), transform=place @ own)
    scene.export(path)
    return Export(path, turn=Y_UP)


def threemf_components(part: Part, path: Path) -> Export:
    """Inches; an object a body, one that is made of them as components, placed by transforms."""
    objects, components = [], []
    for number, body in enumerate(part.bodies, start=1):
        vertices, faces = mesh_of(body)
        local = (vertices - [5 * number, 0, 0]) @ Y_UP / INCH  # of columns: turned back
        places = "".join(f'<vertex x="{x:.12g}" y="{y:.12g}" z="{z:.12g}"/>' for x, y, z in local)
        corners = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in faces)
        objects.append(f'<object id="{number}" type="model"><mesh><vertices>{places}</vertices>'
                       f"<triangles>{corners}</triangles></mesh></object>")  # fmt: skip
        transform = " ".join(f"{x:.12g}" for x in [*Y_UP.T.reshape(-1), 5 * number / INCH, 0, 0])
        components.append(f'<component objectid="{number}" transform="{transform}"/>')
    objects.append(f'<object id="99" type="model"><components>{"".join(components)}</components></object>')
    types = "http://schemas.microsoft.com/3dmanufacturing/"
    space = types + "core/2015/02"
    model = (f'<?xml version="1.0" encoding="UTF-8"?><model unit="inch" xmlns="{space}"><resources>'
             f'{"".join(objects)}</resources>'
             '<build><item objectid="99" transform="1 0 0 0 1 0 0 0 1 2 3 4"/></build></model>')  # fmt: skip
    relation = ('<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships"><Relationship '
                f'Target="/3D/3dmodel.model" Id="r" Type="{types}2013/01/3dmodel"/>'
                "</Relationships>")  # fmt: skip
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("_rels/.rels", relation)
        archive.writestr("3D/3dmodel.model", model)
    return Export(path)


def step_facets(part: Part, path: Path) -> Export | None:
    """Plane faces, in inches; None for parts of too many."""
    if len(part.mesh()[1]) > MOST_STEP_FACES:
        return None
    path.write_text(faceted_step([(v / INCH, f) for v, f in map(mesh_of, part.bodies)]))
    return Export(path)


def polygons(vertices: Array, faces: Faces) -> list[list[int]]:
    """Plane regions of the surface as one polygon each, where they have no holes; the other triangles as they are."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    rows, merged = [], np.zeros(len(faces), bool)
    for facet in mesh.facets:
        outline = outline_of(faces[facet])
        if outline is not None and len(outline) < 250:
            rows.append(outline)
            merged[facet] = True
    return rows + faces[~merged].tolist()


def outline_of(faces: Faces) -> list[int] | None:
    """The corners around a connected region in order; None where it has holes or touches itself."""
    edges = {(int(a), int(b)) for face in faces for a, b in zip(face, np.roll(face, -1), strict=True)}
    rim = [(a, b) for a, b in edges if (b, a) not in edges]
    following = dict(rim)
    if len(following) != len(rim):
        return None
    outline = [rim[0][0]]
    while following[outline[-1]] != outline[0]:
        outline.append(following[outline[-1]])
    return outline if len(outline) == len(rim) else None


WRITERS: dict[str, tuple[str, Callable[[Part, Path], Export | None]]] = {
    "stl": ("stl", stl_binary),
    "stl-text": ("stl", stl_text),
    "stl-far": ("stl", stl_repeated),
    "obj": ("obj", obj_inches),
    "ply": ("ply", ply_meters),
    "off": ("off", off_polygons),
    "glb": ("glb", glb_nodes),
    "3mf": ("3mf", threemf_components),
    "step": ("step", step_facets),
}
