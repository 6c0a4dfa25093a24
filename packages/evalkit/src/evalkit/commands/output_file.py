"""The names of files that commands write: what would be lost by them, or would only fail after the work, is refused."""

from __future__ import annotations

import os
import re
import tempfile
from pathlib import Path
from typing import Any

import click

from evalkit.errors import InputError

DOCUMENTS = (".json",)
PAGES = (".html", ".htm")
DRAWINGS = (".png", ".svg", ".pdf")
IMAGES = (".png",)
MODELS = (".pt",)
IMAGES_READ = (".png", ".tif", ".tiff", ".npy", ".exr", ".ply", ".pcd")
OF_OTHER_KINDS = {
    *DOCUMENTS, *PAGES, *DRAWINGS, *MODELS, *IMAGES_READ, ".csv", ".h5", ".hdf5", ".jpg", ".jpeg", ".obj", ".off",
    ".onnx", ".stl", ".3mf", ".glb", ".gltf", ".step", ".stp", ".yaml", ".yml",
}  # fmt: skip
HEAD = 256  # bytes of a document of ours that hold its format


class OutputFile(click.Path):
    """A file to write.

    Args:
        suffixes: of such a file's name. Other endings are let pass, unless they are those of other kinds of files.
        document: what the format of a JSON document begins with, such as ``binpose-gt``; a document of another kind is
            not overwritten. None: none of ours is.
        or_folder: whether a folder may be written in its place.
    """

    def __init__(self, *suffixes: str, document: str | None = None, or_folder: bool = False) -> None:
        super().__init__(path_type=Path)
        self.suffixes, self.document, self.or_folder = suffixes, document, or_folder

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path, refused where it cannot be written, or what it names would be lost."""
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        if is_special(path) or (self.or_folder and path.is_dir()):
            return path
        if path.is_dir() or str(value).endswith(os.sep):
            raise InputError(f"{path}: is a folder; give the name of the file to write.")
        suffix = path.suffix.lower()
        if self.suffixes and suffix not in self.suffixes and suffix in OF_OTHER_KINDS:
            raise InputError(f"{path}: what is written here is no {suffix} file; end its name in {self._endings}.")
        self._require_same_kind(path)
        _require_writable(path)
        return path

    @property
    def _endings(self) -> str:
        return " or ".join(self.suffixes)

    def _require_same_kind(self, path: Path) -> None:
        """Refuse to overwrite a document of another kind: two names of one command may have been mixed up."""
        if path.suffix.lower() not in DOCUMENTS or not path.is_file() or not path.stat().st_size:
            return
        kind = _kind(path)
        is_other = kind.startswith("binpose-") if self.document is None else kind != self.document
        if is_other:
            holds = f"a {kind} document" if kind else "something else"
            raise InputError(f"{path}: holds {holds}, which would be lost; choose another name, or delete it.")


def is_special(path: Path) -> bool:
    """Whether it is there and neither a file nor a folder: /dev/null, /dev/stdout, a pipe."""
    return path.exists() and not path.is_file() and not path.is_dir()


def require_apart(written: dict[str, Path], read: list[Path]) -> None:
    """Refuse outputs, by their option, that are read too, or that two options name.

    Raises:
        InputError: an output is one of the inputs, or an image of a folder of them, or another output.
    """
    seen: dict[Path, str] = {}
    for option, path in written.items():
        if is_special(path):
            continue
        twin = seen.setdefault(path.resolve(), option)
        if twin != option:
            raise InputError(f"{path}: {twin} and {option} both write it; give two names.")
        if path.exists() and any(_holds(source, path) for source in read):
            raise InputError(f"{path}: is read, and what is read is never overwritten; choose another {option}.")


def _holds(source: Path, path: Path) -> bool:
    """Whether `source` is the file `path`, or a folder that holds it as one of its images."""
    if not source.exists():
        return False
    if source.is_dir():
        return path.suffix.lower() in IMAGES_READ and path.resolve().is_relative_to(source.resolve())
    return source.samefile(path)


def _kind(path: Path) -> str:
    """What the format of a document of ours begins with; empty for any other file."""
    with open(path, "rb") as file:
        head = file.read(HEAD).decode("utf-8", "replace")
    found = re.search(r'"format"\s*:\s*"([^"/]+)', head)
    return found[1] if found else ""


def _require_writable(path: Path) -> None:
    """Raise OSError where no file can be made there, before hours of work."""
    parent = path.absolute().parent
    while not parent.exists():
        parent = parent.parent
    try:
        tempfile.TemporaryFile(dir=parent).close()
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
