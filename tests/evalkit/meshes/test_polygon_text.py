"""OBJ and OFF as other programs write them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from evalkit.errors import InputError
from evalkit.meshes.read import read_mesh

QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
BOX = [(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)]


def block(x0: float, size: tuple[float, float, float], corner: str = "{i}") -> list[str]:
    """A box whose faces name its corners by relative indices."""
    lines = [f"v {x0 + i * size[0]:g} {j * size[1]:g} {k * size[2]:g}" for i, j, k in BOX]
    return lines + ["f " + " ".join(corner.format(i=i - 8) for i in quad) for quad in QUADS]


def area(path: Path) -> float:
    vertices, faces = read_mesh(path)
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


@pytest.mark.parametrize("corner", ["{i}", "{i}/{i}", "{i}/{i}/{i}", "{i}//{i}"])
@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r", " # remark\n"])
def test_relative_indices_count_from_the_line_that_holds_them(tmp_path: Path, corner: str, line_end: str) -> None:
    lines = ["mtllib none.mtl", "o one", *block(0, (40, 20, 10), corner), "usemtl red", "g two", "s off"]
    lines += [*block(50, (5, 5, 5), corner), "l 1 2 3", "p 1"]
    (tmp_path / "two.obj").write_bytes(line_end.join([*lines, ""]).encode())
    assert area(tmp_path / "two.obj") == pytest.approx(2950)
    assert np.ptp(read_mesh(tmp_path / "two.obj")[0], axis=0).tolist() == [55, 20, 10]


def test_continued_lines_colors_and_weights_change_nothing(tmp_path: Path) -> None:
    rows = [f"v {x} {y} {z} 0.5 0.5 0.5" for x, y, z in BOX]
    faces = ["f " + " \\\n ".join(str(i + 1) for i in quad) for quad in QUADS]
    (tmp_path / "box.obj").write_text("\ufeff# a box\n\n" + "\n".join(rows + faces))
    assert area(tmp_path / "box.obj") == pytest.approx(6)


@pytest.mark.parametrize(
    "line", ["f 1 2 99", "f 0 1 2", "f -9 1 2", "f 1 2 x", "v 1 2", "v 1,5 2 3", "f 1 2 2.5", "surf 0 1 0 1 1 2 3"]
)
def test_a_line_that_cannot_be_meant_is_refused_and_the_file_named(tmp_path: Path, line: str) -> None:
    (tmp_path / "bad.obj").write_text("\n".join([*block(0, (1, 1, 1)), line]))
    with pytest.raises(InputError, match=r"bad\.obj: .*export"):
        read_mesh(tmp_path / "bad.obj")


OFF_FACES = [f"4 {' '.join(map(str, quad))}" for quad in QUADS]
OFF_ROWS = [f"{x} {y} {z}" for x, y, z in BOX]


@pytest.mark.parametrize(
    "lines",
    [
        ["OFF", "8 6 12", *OFF_ROWS, *OFF_FACES],
        ["OFF 8 6 12", *OFF_ROWS, *OFF_FACES],
        ["off", "# counts", "8 6", "", *OFF_ROWS, "# faces", *(f"{face} 255 0 0" for face in OFF_FACES)],
        ["COFF", "8 6 0", *(f"{row} 255 0 0 255" for row in OFF_ROWS), *OFF_FACES],
        ["NOFF", "8 6 0", *(f"{row} 0 0 1" for row in OFF_ROWS), *OFF_FACES],
        ["OFF", "8 8 0", *OFF_ROWS, "2 0 1", *OFF_FACES, "1 7"],
    ],
)
@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
def test_off_in_its_kinds_is_the_same_box(tmp_path: Path, lines: list[str], line_end: str) -> None:
    (tmp_path / "box.off").write_bytes(line_end.join(lines).encode())
    assert area(tmp_path / "box.off") == pytest.approx(6)


@pytest.mark.parametrize(
    "lines",
    [
        ["4OFF", "8 6 12", *OFF_ROWS, *OFF_FACES],
        ["OFF BINARY", "8 6 12"],
        ["OFF", "8 6 12", *OFF_ROWS, *OFF_FACES[:-1]],
        ["OFF", "8 6 12", *OFF_ROWS, *OFF_FACES[:-1], "4 0 1 2"],
        ["OFF", "8 6 12", *OFF_ROWS, *OFF_FACES[:-1], "3 0 1 8"],
        ["OFF", "-8 6 12", *OFF_ROWS, *OFF_FACES],
        [*OFF_ROWS, *OFF_FACES],
    ],
)
def test_off_that_is_damaged_or_of_another_kind_is_refused(tmp_path: Path, lines: list[str]) -> None:
    (tmp_path / "bad.off").write_text("\n".join(lines))
    with pytest.raises(InputError, match=r"bad\.off: .*(export|write)"):
        read_mesh(tmp_path / "bad.off")
