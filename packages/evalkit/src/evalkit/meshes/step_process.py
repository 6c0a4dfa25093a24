"""cascadio in a process of its own: Open CASCADE prints from C++, and may crash on a damaged file.

``python -m evalkit.meshes.step_process PART.step PART.glb`` writes the part's triangles in meters.
"""

from __future__ import annotations

import sys

import cascadio


def main(step_file: str, glb_file: str) -> None:
    """Convert a STEP file; surfaces are followed within 0.01 mm, and half a radian from facet to facet."""
    cascadio.step_to_glb(step_file, glb_file, tol_linear=0.01, tol_angular=0.5)


if __name__ == "__main__":
    main(*sys.argv[1:])
