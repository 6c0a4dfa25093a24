"""What `simgen object` understands of CAD parts whose truth is known, in every format: a table.

    python benchmarks/cad/cad_table.py [--parts shaft,flange] [--formats stl,glb] [--folder FOLDER] [--convex]

A cell is `ok`, or what differs from the truth: the sides of the bounding box (0.1 %), the volume (1 %), whether the
mesh is closed, how many bodies it has, the symmetry group, and its main axis (2 degrees).
"""

from __future__ import annotations

import argparse
import logging
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from unittest.mock import patch

import numpy as np

from cad_fittings import more_parts
from cad_formats import WRITERS, Export
from cad_parts import Part, all_parts
from evalkit.errors import InputError
from simgen.objects.prepare import PreparedObject, prepare_object

AXIS_DEGREES = 2.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", default="", help="words, separated by commas, that the part's name holds")
    parser.add_argument("--formats", default=",".join(WRITERS))
    parser.add_argument("--folder", type=Path, help="where to leave the files")
    parser.add_argument("--convex", action="store_true", help="decompose into convex parts too: CoACD takes seconds")
    options = parser.parse_args()
    logging.disable(logging.CRITICAL)
    formats = options.formats.split(",")
    folder = options.folder or Path(tempfile.mkdtemp(prefix="cad-parts-"))
    folder.mkdir(exist_ok=True)
    wrong = 0
    for part in [*all_parts(), *more_parts()]:
        if any(word in part.name for word in options.parts.split(",")):
            started = time.process_time()
            cells = [cell(part, name, folder, options.convex) for name in formats]
            wrong += sum(text not in ("ok", "-") for text in cells)
            seconds = (time.process_time() - started) / len(formats)
            print(f"{part.name:34}{'/'.join(part.symmetry):18}{seconds:5.1f} s  " + " | ".join(cells), flush=True)
    print(f"{wrong} wrong; formats: {', '.join(formats)}")


def cell(part: Part, name: str, folder: Path, convex: bool) -> str:
    suffix, write = WRITERS[name]
    stem = "".join(c if c.isalnum() else "_" for c in f"{part.name} {name}")
    export = write(part, folder / f"{stem}.{suffix}")
    if export is None:
        return "-"
    try:
        found = understood(export, convex)
    except InputError as error:
        return str(error)
    return ", ".join(differences(part, export, found)) or "ok"


def understood(export: Export, convex: bool) -> PreparedObject:
    if convex:
        return prepare_object(str(export.path), export.units)
    with patch("simgen.objects.prepare.convex_parts", return_value=([], [])):
        return prepare_object(str(export.path), export.units)


def differences(part: Part, export: Export, found: PreparedObject) -> Iterator[str]:
    vertices, _ = part.mesh()
    sides = np.ptp(vertices @ export.turn.T, axis=0)
    got = 1e3 * np.ptp(found.mesh.vertices, axis=0)
    if np.abs(got / sides - 1).max() > 1e-3:
        yield f"{' x '.join(f'{side:.4g}' for side in got)} mm"
    volume = 1e9 * found.mesh.volume
    if abs(volume / part.volume - 1) > 0.01:
        yield f"{volume / part.volume:.3f} of the volume"
    if not found.mesh.is_watertight:
        yield f"open ({found.mesh.open_edges} open, {found.mesh.crowded_edges} crowded edges)"
    if found.mesh.components not in (part.pieces or (len(part.bodies),)):
        yield f"{found.mesh.components} pieces"
    symmetry = found.symmetry.symmetry
    if symmetry.name not in part.symmetry:
        yield symmetry.name
    elif part.axis is not None and symmetry.name != "none":
        axis = export.turn @ np.array(part.axis) / np.linalg.norm(part.axis)
        off = np.degrees(np.arccos(min(1.0, abs(float(axis @ symmetry.axis)))))
        if off > AXIS_DEGREES:
            yield f"axis {off:.1f} degrees off"


if __name__ == "__main__":
    main()
