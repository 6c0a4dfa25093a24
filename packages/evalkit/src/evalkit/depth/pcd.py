"""Point clouds in PCD files (Point Cloud Library): ASCII, binary and compressed, with their grid."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.errors import InputError

KINDS = {"F": "f", "I": "i", "U": "u"}
WANTED = ("x", "y", "z")
MOST_POINTS = 1 << 28


def read_pcd(path: Path) -> tuple[NDArray[np.float64], tuple[int, int]]:
    """Points (n, 3) as stored, in rows of the grid, and its (width, height); a height of 1 means there is no grid.

    Raises:
        InputError: the file is no PCD file, or is damaged.
        OSError: it cannot be read.
    """
    raw = path.read_bytes()
    try:
        header, body = _header(raw)
        width, height = (int(header[key][0]) for key in ("WIDTH", "HEIGHT"))
        count = int(header.get("POINTS", [str(width * height)])[0])
        if not 0 < count == width * height <= MOST_POINTS:
            raise ValueError(f"its WIDTH {width} and HEIGHT {height} do not make its {count} POINTS")
        rows = _fields(header)
        columns = _columns(header["DATA"][0].lower(), body, rows, count)
        return np.stack([columns[name].astype(np.float64) for name in WANTED], -1), (width, height)
    except (KeyError, ValueError, IndexError, OverflowError, TypeError) as error:
        reason = f"its header lacks {error}" if isinstance(error, KeyError) else str(error)
        raise InputError(f"{path}: is no readable PCD point cloud ({reason[:120]}); save it again.") from None


def _header(raw: bytes) -> tuple[dict[str, list[str]], bytes]:
    header: dict[str, list[str]] = {}
    at = 0
    while "DATA" not in header:
        end = raw.index(b"\n", at)
        words = raw[at:end].decode("ascii", errors="replace").split()
        at = end + 1
        if words and not words[0].startswith("#"):
            header[words[0].upper()] = words[1:]
        if len(header) > 20:
            raise ValueError("it does not begin with a PCD header")
    return header, raw[at:]


def _fields(header: dict[str, list[str]]) -> list[tuple[str, str, int]]:
    """(name, NumPy type, numbers) of each field; names that occur twice, as padding's do, get a number."""
    names, sizes, types = header["FIELDS"], header["SIZE"], header["TYPE"]
    counts = header.get("COUNT", ["1"] * len(names))
    unique = [name if names.index(name) == i else f"{name}-{i}" for i, name in enumerate(names)]
    parts = zip(unique, types, sizes, counts, strict=True)
    return [(name, f"<{KINDS[kind]}{int(size)}", int(count)) for name, kind, size, count in parts]


def _columns(data: str, body: bytes, rows: list[tuple[str, str, int]], count: int) -> dict[str, NDArray[Any]]:
    if data == "ascii":
        lines = np.array(body.split()[: count * sum(c for _, _, c in rows)], dtype=float).reshape(count, -1)
        starts = np.cumsum([0, *(c for _, _, c in rows)])
        return {name: lines[:, start] for (name, _, _), start in zip(rows, starts, strict=False)}
    if data == "binary":
        table = np.frombuffer(body, np.dtype([(name, kind, (c,)) for name, kind, c in rows]), count)
        return {name: table[name][:, 0] for name in WANTED}
    if data != "binary_compressed":
        raise ValueError(f"its DATA is '{data}', not ascii, binary or binary_compressed")
    packed, whole = (int(n) for n in np.frombuffer(body, "<u4", 2))
    plain = decompress_lzf(body[8 : 8 + packed], whole)
    columns, at = {}, 0
    for name, kind, c in rows:  # compressed clouds are stored field by field
        columns[name] = np.frombuffer(plain, kind, count * c, at).reshape(count, c)[:, 0]
        at += columns[name].itemsize * count * c
    return columns


def decompress_lzf(packed: bytes, whole: int) -> bytes:
    """LZF as PCL writes it: runs of up to 32 literal bytes, and copies of what was written up to 8 KiB before.

    Raises:
        ValueError: the data are damaged.
    """
    out = bytearray()
    at, end = 0, len(packed)
    while at < end:
        control = packed[at]
        at += 1
        if control < 32:
            out += packed[at : at + control + 1]
            at += control + 1
            continue
        length = control >> 5
        if length == 7:
            length += packed[at]
            at += 1
        start = len(out) - ((control & 31) << 8) - packed[at] - 1
        at += 1
        length += 2
        if start < 0 or len(out) + length > whole:
            raise ValueError("its compressed data are damaged")
        piece = out[start : start + length]
        while len(piece) < length:  # a copy may run into what it writes itself
            piece += piece[: length - len(piece)]
        out += piece
    if len(out) != whole:
        raise ValueError("its compressed data are damaged")
    return bytes(out)
