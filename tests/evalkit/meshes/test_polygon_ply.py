"""PLY: every encoding gives the same surface, and what is damaged is refused in one sentence."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evalkit import InputError
from evalkit.meshes.read import read_mesh

VERTICES = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 1]], float)
POLYGONS = [[0, 3, 2, 1], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]  # a pyramid on a square
TRIANGLES = [[0, 3, 2], [0, 2, 1], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]
ENCODINGS = ["ascii", "binary_little_endian", "binary_big_endian"]


def ply_bytes(encoding, polygons=POLYGONS, vertices=VERTICES):
    """As scanners write them: normals and colors beside x, y, z, and an element nobody asked for before the faces."""
    header = (
        f"ply\nformat {encoding} 1.0\ncomment made by hand\nelement vertex {len(vertices)}\n"
        "property float x\nproperty float y\nproperty double z\nproperty float nx\nproperty uchar red\n"
        "element camera 2\nproperty float focus\nproperty list uchar short view\n"
        f"element face {len(polygons)}\nproperty list uchar int vertex_indices\nproperty uchar flags\nend_header\n"
    )
    if encoding == "ascii":
        rows = [f"{x} {y} {z} 0.5 255" for x, y, z in vertices] + ["1.5 2 7 8", "2.5 0"]
        rows += [f"{len(p)} {' '.join(map(str, p))} 1" for p in polygons]
        return (header + "\n".join(rows) + "\n").encode()
    order = "<" if "little" in encoding else ">"
    body = b"".join(struct.pack(order + "ffdfB", *vertex, 0.5, 255) for vertex in vertices)
    body += struct.pack(order + "fBhh", 1.5, 2, 7, 8) + struct.pack(order + "fB", 2.5, 0)
    body += b"".join(struct.pack(f"{order}B{len(p)}iB", len(p), *p, 1) for p in polygons)
    return header.encode() + body


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("polygons", [POLYGONS, TRIANGLES])
def test_every_encoding_gives_the_same_surface(tmp_path, encoding, polygons):
    (tmp_path / "mesh.ply").write_bytes(ply_bytes(encoding, polygons))
    vertices, faces = read_mesh(tmp_path / "mesh.ply")
    np.testing.assert_array_equal(vertices, VERTICES)
    assert faces.tolist() == TRIANGLES


def test_windows_line_ends_and_the_other_name_of_the_list_are_read(tmp_path):
    text = ply_bytes("ascii").decode().replace("vertex_indices", "vertex_index").replace("\n", "\r\n")
    (tmp_path / "mesh.ply").write_bytes(text.encode())
    assert read_mesh(tmp_path / "mesh.ply")[1].tolist() == TRIANGLES


@pytest.mark.parametrize("encoding", ENCODINGS)
@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_a_damaged_file_is_read_or_refused_but_never_crashes(tmp_path_factory, encoding, data):
    whole = bytearray(ply_bytes(encoding))
    for _ in range(data.draw(st.integers(1, 5))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.mktemp("ply") / "mesh.ply"
    path.write_bytes(bytes(whole[: data.draw(st.integers(0, len(whole)))]))
    try:
        vertices, faces = read_mesh(path)
    except InputError as error:
        assert "mesh.ply" in str(error)
    else:
        assert vertices.shape[1] == faces.shape[1] == 3
        assert faces.max() < len(vertices)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_a_truncated_file_is_refused(tmp_path, encoding):
    (tmp_path / "mesh.ply").write_bytes(ply_bytes(encoding)[:-12])
    with pytest.raises(InputError, match=r"mesh\.ply: .*'face'"):
        read_mesh(tmp_path / "mesh.ply")


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("ply\n", "pig\n", "header"),
        ("format ascii", "format morse", "morse"),
        ("property float y", "property float w", "x, y and z"),
        ("property list uchar int vertex_indices", "property list uchar int corners", "cloud of points"),
        ("element face 5", "element face five", "element face five"),
        ("property float x", "property quaternion x", "quaternion"),
    ],
)
def test_what_a_header_lacks_is_named(tmp_path, old, new, word):
    (tmp_path / "mesh.ply").write_text(ply_bytes("ascii").decode().replace(old, new))
    with pytest.raises(InputError, match=word):
        read_mesh(tmp_path / "mesh.ply")


def test_the_reference_cup_is_read(reference):
    vertices, faces = read_mesh(reference / "icvl_cup" / "cup.ply")
    assert (len(vertices), len(faces)) == (32774, 65217)
    assert 60 < np.ptp(vertices, axis=0).min() < 120  # millimeters


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_strips_are_wound_alike_and_minus_one_ends_them(tmp_path, encoding):
    header = f"ply\nformat {encoding} 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n"
    header += "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    strip = [0, 1, 3, 2, -1, 0, 1, 4]
    if encoding == "ascii":
        rows = ["{} {} {}".format(*vertex) for vertex in VERTICES] + [f"8 {' '.join(map(str, strip))}"]
        body = "\n".join(rows).encode()
    else:
        order = "<" if "little" in encoding else ">"
        body = VERTICES.astype(order + "f4").tobytes() + struct.pack(order + "9i", len(strip), *strip)
    (tmp_path / "mesh.ply").write_bytes(header.encode() + body)
    assert read_mesh(tmp_path / "mesh.ply")[1].tolist() == [[0, 1, 3], [3, 1, 2], [0, 1, 4]]


@pytest.mark.parametrize("encoding", ENCODINGS[1:])
def test_bytes_after_the_last_row_of_a_binary_file_do_no_harm(tmp_path, encoding):
    (tmp_path / "mesh.ply").write_bytes(ply_bytes(encoding) + b"made by hand")
    assert read_mesh(tmp_path / "mesh.ply")[1].tolist() == TRIANGLES


def test_rows_of_more_numbers_than_the_header_announces_are_refused(tmp_path):
    text = ply_bytes("ascii").decode().replace("property float nx\n", "")
    (tmp_path / "mesh.ply").write_text(text)
    with pytest.raises(InputError, match=r"mesh\.ply"):
        read_mesh(tmp_path / "mesh.ply")
