"""How a gt.json holds visibility: which share "visibility" is, and where the other one stands."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.datasets.pose_rows import Rows
from evalkit.datasets.scene import SHARES, Share
from evalkit.errors import InputError

Array = NDArray[np.float64]
FIELDS = {share: f"visibility_{share}" for share in SHARES}
ROUNDING = 1e-6


def read_share(path: Path | str, document: dict[str, Any]) -> Share | None:
    """Which share a document's "visibility" is; None where it does not say.

    Raises:
        InputError: it says something else.
    """
    share = document.get("visibility")
    if share is not None and share not in SHARES:
        raise InputError(f'{path}: \'visibility\' must be "{SHARES[0]}" or "{SHARES[1]}", found {str(share)[:40]!r}.')
    return share


def other_share(rows: Rows, share: Share | None) -> Array | None:
    """The share (n,) of an image's instances that "visibility" is not; None where the document lacks it."""
    field = _other_field(share)
    if field is None:
        return None
    return rows.optional.get(field) if len(rows.value) else rows.value


def share_fields(visibility: Array, other: Array | None, share: Share | None) -> dict[str, Array]:
    """Both as instances have them."""
    field = _other_field(share)
    return {"visibility": visibility} | ({} if field is None or other is None else {field: other})


def are_shares(values: Array) -> bool:
    return bool(((values >= -ROUNDING) & (values <= 1 + ROUNDING)).all())


def _other_field(share: Share | None) -> str | None:
    return None if share is None else next(field for name, field in FIELDS.items() if name != share)
