"""What real mesh files get wrong: split, stray and repeated parts, winding, holes. Mended, or at least reported."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from simgen.objects.repeated_faces import without_repeated_faces
from simgen.objects.winding import signed_volume, wound_outwards

Vertices = NDArray[np.float64]
Faces = NDArray[np.int64]
WELD = 1e-7  # of the size: vertices closer than this are one
ROUNDINGS = 4  # steps of float32: as far apart as corners may be that were one before a file rounded them
LOOSE_WELD = 1e-4  # of the size: vertices farther apart are never one
MANY_FACES = 300_000  # rendering takes ten times as long as with a tenth of it


@dataclass(frozen=True, eq=False)
class MendedMesh:
    """A welded mesh (V, 3), (F, 3) without stray vertices or repeated faces, wound outwards, and how sound it is."""

    vertices: Vertices
    faces: Faces
    components: int
    open_edges: int  # of one face only
    crowded_edges: int  # of three faces and more
    is_watertight: bool  # along every edge as many faces run one way as the other, so there is an inside
    volume: float  # signed sum; meaningless for an open mesh
    warnings: list[str]


def mend(vertices: Vertices, faces: Faces) -> MendedMesh:
    """Weld, clean and wind a triangle mesh; whatever is noteworthy goes into `warnings`."""
    warnings: list[str] = []
    vertices, faces = _weld(vertices, faces)
    faces = _without_repeated_faces(vertices, faces, warnings)
    vertices, faces = without_unused_vertices(vertices, faces)
    faces, cavities = _wound_outwards(vertices, faces, warnings)
    counts = _edges(faces)[1]
    mesh = MendedMesh(
        vertices,
        faces,
        components=_count_components(len(vertices), faces) - cavities,
        open_edges=int((counts == 1).sum()),
        crowded_edges=int((counts > 2).sum()),
        is_watertight=_is_balanced(faces),
        volume=signed_volume(vertices, faces),
        warnings=warnings,
    )
    _note_flaws(mesh)
    return mesh


def closed(vertices: Vertices, faces: Faces) -> tuple[Vertices, Faces]:
    """The mesh with every hole closed by a fan around the middle of its rim."""
    edges, counts, first = _directed_edges(faces)
    rim = edges[first[counts == 1]]
    if len(rim) == 0:
        return vertices, faces
    links = coo_matrix((np.ones(len(rim)), rim.T), shape=(len(vertices),) * 2)
    _, label = connected_components(links, directed=False)
    _, hole = np.unique(label[rim[:, 0]], return_inverse=True)
    size = np.bincount(hole)
    middles = np.stack([np.bincount(hole, vertices[rim[:, 0], axis]) / size for axis in range(3)], -1)
    fans = np.stack([rim[:, 1], rim[:, 0], len(vertices) + hole], -1)
    return np.concatenate([vertices, middles]), np.concatenate([faces, fans])


def without_unused_vertices(vertices: Vertices, faces: Faces) -> tuple[Vertices, Faces]:
    """Only the vertices that a face uses: stray ones may lie anywhere and would count for the size."""
    used, renumbered = np.unique(faces, return_inverse=True)
    return vertices[used], renumbered.reshape(-1, 3)


def _weld(vertices: Vertices, faces: Faces) -> tuple[Vertices, Faces]:
    """Vertices at one place as one: STL repeats each for every face.

    Far from the origin a file's float32 is coarser than that. So where edges stay open, vertices a few roundings apart
    are joined too, if that closes some.
    """
    vertices, faces = without_unused_vertices(vertices, faces)
    low = vertices.min(0)
    size = float((vertices.max(0) - low).max())
    cells = np.round((vertices - low) / (size * WELD or 1.0)).astype(np.int64)
    order = np.lexsort(cells.T)
    new = np.ones(len(cells), bool)
    new[1:] = (np.diff(cells[order], axis=0) != 0).any(1)
    number = np.empty(len(cells), np.int64)
    number[order] = np.cumsum(new) - 1
    welded, corners = vertices[order[new]], number[faces]
    open_edges = _count_open_edges(corners)
    if open_edges:
        rounding = ROUNDINGS * float(np.spacing(np.float32(np.abs(vertices).max())))
        loose = _joined(welded, min(max(rounding, 2 * WELD * size), LOOSE_WELD * size))[corners]
        if _count_open_edges(loose) < open_edges:
            return welded, loose
    return welded, corners


def _joined(vertices: Vertices, distance: float) -> NDArray[np.int64]:
    """For every vertex (V,) the first of those that are joined to it by steps of at most `distance`."""
    near = cKDTree(vertices).query_pairs(distance, output_type="ndarray")
    graph = coo_matrix((np.ones(len(near), np.int8), near.T), shape=(len(vertices),) * 2)
    _, label = connected_components(graph, directed=False)
    _, first = np.unique(label, return_index=True)
    return first[label]


def _count_open_edges(faces: Faces) -> int:
    whole = faces[(faces != np.roll(faces, 1, axis=1)).all(1)]
    return int((_edges(whole)[1] == 1).sum()) if len(whole) else 0


def _without_repeated_faces(vertices: Vertices, faces: Faces, warnings: list[str]) -> Faces:
    """Without faces that lost a corner to welding, copies of others, and faces in contact."""
    single = without_repeated_faces(vertices, faces)
    if single.copies:
        warnings.append(f"{_count(single.copies, 'face was', 'faces were')} there more than once and dropped.")
    if single.in_contact:
        warnings.append(f"{single.in_contact} faces where surfaces touch were dropped: what touches is one solid.")
    return single.faces


def _wound_outwards(vertices: Vertices, faces: Faces, warnings: list[str]) -> tuple[Faces, int]:
    """Neighboring faces wound alike, and counter-clockwise seen from outside; and how many cavities there are."""
    winding = wound_outwards(vertices, faces)
    if not winding.were_alike:
        mended = "mended" if winding.are_alike else "mended as far as possible"
        warnings.append(f"The faces were not wound alike; {mended}.")
    if winding.turned_rest or 0 < winding.turned_bodies == winding.bodies:
        warnings.append("The mesh was inside out; its faces have been turned round.")
    elif winding.turned_bodies:
        bodies = _count(winding.turned_bodies, "closed body was", "closed bodies were")
        warnings.append(f"{bodies} inside out, of {winding.bodies}; the faces have been turned round.")
    return winding.faces, winding.cavities


def _directed_edges(faces: Faces) -> tuple[Faces, NDArray[np.int64], NDArray[np.int64]]:
    """All directed edges (3F, 2); and for every undirected one its number of faces and one of its directed edges."""
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    _, first, counts = np.unique(_pack(np.sort(directed, axis=1)), return_index=True, return_counts=True)
    return directed, counts, first


def _edges(faces: Faces) -> tuple[Faces, NDArray[np.int64]]:
    """Undirected edges (E, 2) and how many faces share each (E,)."""
    directed, counts, first = _directed_edges(faces)
    return directed[first], counts


def _is_balanced(faces: Faces) -> bool:
    """Whether the faces run along every edge as often one way as the other: alone, or where bodies share the edge."""
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    upwards = directed[:, 0] < directed[:, 1]
    _, number = np.unique(_pack(np.sort(directed, axis=1)), return_inverse=True)
    return not np.bincount(number.reshape(-1), np.where(upwards, 1, -1)).any()


def _pack(edges: Faces) -> NDArray[np.int64]:
    """One number an edge."""
    return edges[:, 0] * (int(edges.max(initial=0)) + 1) + edges[:, 1]


def _count_components(vertex_count: int, faces: Faces) -> int:
    links = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    graph = coo_matrix((np.ones(len(links), np.int8), links.T), shape=(vertex_count, vertex_count))
    return int(connected_components(graph, directed=False)[0])


def _note_flaws(mesh: MendedMesh) -> None:
    if mesh.crowded_edges:
        kind = "Bodies touch along edges" if mesh.is_watertight else "Not a manifold"
        mesh.warnings.append(f"{kind}: {_count(mesh.crowded_edges, 'edge has', 'edges have')} more than two faces.")
    if mesh.open_edges:
        mesh.warnings.append(
            f"Not watertight: {_count(mesh.open_edges, 'edge has', 'edges have')} one face only; the physics closes "
            "the holes, the pictures show them."
        )
    if mesh.components > 1:
        mesh.warnings.append(f"The mesh is in {mesh.components} separate pieces; they move as one rigid object.")
    if len(mesh.faces) > MANY_FACES:
        mesh.warnings.append(f"{len(mesh.faces)} faces make rendering slow; a tenth of them will look the same.")


def _count(number: int, one: str, many: str) -> str:
    return f"{number} {one if number == 1 else many}"
