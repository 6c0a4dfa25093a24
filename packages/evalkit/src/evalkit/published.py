"""The figures that papers published, with their sources, and what a run must share with them to be comparable."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Table:
    """One published table: a figure for each method (row) and object (column)."""

    title: str
    source: str
    columns: tuple[str, ...]
    rows: dict[str, tuple[float, ...]]


TABLES: tuple[Table, ...] = ()
