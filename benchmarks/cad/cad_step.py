"""STEP files of bodies with plane faces (ISO 10303-21, application protocol 214), in inches, for `cad_formats.py`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

Mesh = tuple[NDArray[np.float64], NDArray[np.int64]]
FRAME = """#1=APPLICATION_CONTEXT('automotive design');
#2=PRODUCT_CONTEXT('',#1,'mechanical');
#3=PRODUCT('part','part','',(#2));
#4=PRODUCT_DEFINITION_FORMATION('','',#3);
#5=PRODUCT_DEFINITION_CONTEXT('part definition',#1,'design');
#6=PRODUCT_DEFINITION('design','',#4,#5);
#7=PRODUCT_DEFINITION_SHAPE('','',#6);
#8=(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.));
#9=LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(25.4),#8);
#10=DIMENSIONAL_EXPONENTS(1.,0.,0.,0.,0.,0.,0.);
#11=(CONVERSION_BASED_UNIT('INCH',#9)LENGTH_UNIT()NAMED_UNIT(#10));
#12=(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.));
#13=(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT());
#14=UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.E-6),#11,'distance_accuracy_value','');
#15=(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT((#14))
GLOBAL_UNIT_ASSIGNED_CONTEXT((#11,#12,#13))REPRESENTATION_CONTEXT('',''));
#16=CARTESIAN_POINT('',(0.,0.,0.));
#17=AXIS2_PLACEMENT_3D('',#16,$,$);"""


def faceted_step(bodies: Sequence[Mesh]) -> str:
    """The text of a file that holds a faceted solid a body: vertices (V, 3) in inches, faces (F, 3)."""
    lines, solids = FRAME.splitlines(), list[int]()
    number = 20

    def add(text: str) -> int:
        nonlocal number
        number += 1
        lines.append(f"#{number}={text};")
        return number

    for vertices, faces in bodies:
        points = [add(f"CARTESIAN_POINT('',({_list(vertex)}))") for vertex in vertices]
        normals = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
        shell = []
        for face, normal in zip(faces, normals, strict=True):
            if not np.linalg.norm(normal) > 0:
                continue
            along = vertices[face[1]] - vertices[face[0]]
            z = add(f"DIRECTION('',({_list(normal / np.linalg.norm(normal))}))")
            x = add(f"DIRECTION('',({_list(along / np.linalg.norm(along))}))")
            frame = add(f"AXIS2_PLACEMENT_3D('',#{points[face[0]]},#{z},#{x})")
            plane = add(f"PLANE('',#{frame})")
            loop = add(f"POLY_LOOP('',({_names(points[i] for i in face)}))")
            bound = add(f"FACE_OUTER_BOUND('',#{loop},.T.)")
            shell.append(add(f"FACE_SURFACE('',(#{bound}),#{plane},.T.)"))
        closed = add(f"CLOSED_SHELL('',({_names(shell)}))")
        solids.append(add(f"FACETED_BREP('',#{closed})"))
    shape = add(f"FACETED_BREP_SHAPE_REPRESENTATION('',(#17,{_names(solids)}),#15)")
    add(f"SHAPE_DEFINITION_REPRESENTATION(#7,#{shape})")
    head = ["ISO-10303-21;", "HEADER;", "FILE_DESCRIPTION((''),'2;1');",
            "FILE_NAME('part','2026-01-01T00:00:00',(''),(''),'','','');",
            "FILE_SCHEMA(('AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }'));", "ENDSEC;", "DATA;"]  # fmt: skip
    return "\n".join([*head, *lines, "ENDSEC;", "END-ISO-10303-21;"]) + "\n"


def _names(numbers: Iterable[int]) -> str:
    return ",".join(f"#{number}" for number in numbers)


def _list(numbers: NDArray[np.float64]) -> str:
    return ",".join(f"{x:.12E}" for x in numbers.tolist())
