"""The mesh reader, which is evalkit's."""

from evalkit.meshes.read import FORMATS, read_mesh

__all__ = ["FORMATS", "read_mesh"]
