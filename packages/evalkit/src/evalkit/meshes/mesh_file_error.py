"""What is wrong with a mesh file, said without its name."""

from __future__ import annotations


class MeshFileError(Exception):
    """A half sentence on a mesh file, such as "the file ends early"; the reader puts the file's name before it."""
