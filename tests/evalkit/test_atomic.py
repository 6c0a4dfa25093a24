"""A file is complete or absent, whatever happens while it is written."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import stat
from pathlib import Path

import pytest

from evalkit.atomic import atomic_path, sha256_of_file, write_json, write_text


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_the_file_appears_when_the_block_ends(tmp_path: Path) -> None:
    with atomic_path(tmp_path / "deep" / "file") as temporary:
        temporary.write_text("whole")
        assert not (tmp_path / "deep" / "file").exists()
    assert (tmp_path / "deep" / "file").read_text() == "whole"
    assert names(tmp_path / "deep") == {"file"}


@pytest.mark.parametrize("failure", [ValueError, KeyboardInterrupt, OSError])
def test_a_failure_leaves_the_old_file_and_no_other(tmp_path: Path, failure: type[BaseException]) -> None:
    write_text(tmp_path / "file", "old")
    with pytest.raises(failure), atomic_path(tmp_path / "file") as temporary:
        temporary.write_text("half of the n")
        raise failure
    assert (tmp_path / "file").read_text() == "old"
    assert names(tmp_path) == {"file"}


def test_of_several_who_write_a_new_file_the_first_wins(tmp_path: Path) -> None:
    with atomic_path(tmp_path / "file", new=True) as temporary:
        temporary.write_text("first")
    with pytest.raises(FileExistsError) as error, atomic_path(tmp_path / "file", new=True) as temporary:
        temporary.write_text("second")
    assert error.value.filename == str(tmp_path / "file")
    assert (tmp_path / "file").read_text() == "first"
    assert names(tmp_path) == {"file"}


def test_a_new_file_needs_no_hard_links(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.EPERM, "no hard links here")

    monkeypatch.setattr(os, "link", refuse)
    write_text(tmp_path / "file", "first", new=True)
    with pytest.raises(OSError):
        write_text(tmp_path / "file", "second", new=True)
    assert (tmp_path / "file").read_text() == "first"
    assert names(tmp_path) == {"file"}


def test_permissions_are_those_of_an_ordinary_file(tmp_path: Path) -> None:
    mask = os.umask(0o027)
    try:
        write_text(tmp_path / "file", "x")
    finally:
        os.umask(mask)
    assert stat.S_IMODE((tmp_path / "file").stat().st_mode) == 0o640


def test_an_error_names_the_file_that_was_wanted_not_the_temporary(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OSError) as error:
        write_text(tmp_path / "file" / "below", "x")
    assert error.value.filename == str(tmp_path / "file" / "below")
    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError) as error:
        write_text(tmp_path / "folder", "x")
    assert error.value.filename == str(tmp_path / "folder")
    assert names(tmp_path) == {"file", "folder"}


def test_json_is_strict(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"ä": [1.5, None]})
    assert json.loads((tmp_path / "a.json").read_text(encoding="utf-8")) == {"ä": [1.5, None]}
    with pytest.raises(ValueError):
        write_json(tmp_path / "b.json", float("nan"))
    assert names(tmp_path) == {"a.json"}


@pytest.mark.parametrize("size", [0, 1, 1 << 20, (1 << 20) + 3])
def test_the_checksum_is_sha256_of_all_bytes(tmp_path: Path, size: int) -> None:
    data = os.urandom(size)
    (tmp_path / "file").write_bytes(data)
    assert sha256_of_file(tmp_path / "file") == hashlib.sha256(data).hexdigest()
