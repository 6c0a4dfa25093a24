"""Locks on the shards of a folder, so that several builds may fill it side by side, also from several machines.

The lock of shard n is a lock of the operating system on byte n of dataset.json, so it goes when the process ends,
however it ends. Network file systems carry such locks from machine to machine; where one carries none, only --shards
keeps builds apart.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import struct
from collections.abc import Iterator
from pathlib import Path

from evalkit.datasets.shard_folder import DATASET_FILE
from evalkit.errors import InputError

NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EINVAL)
TAKEN = (errno.EAGAIN, errno.EACCES)
READ_ONLY = (errno.EROFS, errno.EACCES, errno.EPERM)
FLOCK = "hhqqi4x"  # struct flock of Linux on 64 bits: type, whence, start, length, pid


@contextlib.contextmanager
def shards_locked(folder: Path, shards: range) -> Iterator[bool]:
    """Hold a range of shards of a folder that has its dataset.json; yields whether this file system has locks.

    Raises:
        InputError: another build holds one of them.
    """
    try:
        handle = os.open(folder / DATASET_FILE, os.O_RDWR)
    except OSError as error:
        if error.errno not in READ_ONLY:
            raise
        yield False  # a folder that nobody can write; a missing shard will raise the error
        return
    try:
        yield _lock(handle, folder, shards)
    finally:
        os.close(handle)


def _lock(handle: int, folder: Path, shards: range) -> bool:
    """A lock that belongs to the open file: closing another handle of the file in this process does not drop it."""
    if not shards:
        return True  # where a length of 0 would mean all that follow
    wanted = struct.pack(FLOCK, fcntl.F_WRLCK, os.SEEK_SET, shards.start, len(shards), 0)
    try:
        fcntl.fcntl(handle, fcntl.F_OFD_SETLK, wanted)
    except OSError as error:
        if error.errno in NO_LOCKS:
            return False
        if error.errno not in TAKEN:
            raise
        raise InputError(
            f"{folder}: another 'simgen build' is at work in this folder, on some of the same shards; "
            "wait for it, give other --shards, or choose another folder with -o."
        ) from None
    return True
