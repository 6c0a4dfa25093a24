"""The one error that a user is meant to read."""

from __future__ import annotations

from typing import Any


class InputError(ValueError):
    """Something the user handed us cannot be used.

    The message is one sentence that names the file (or option) and the mend. The commands print it without a
    traceback and exit with code 2; library callers catch it as a ``ValueError``.
    """


def shortened(value: Any) -> str:
    """A value out of a document, as such a sentence quotes it: the first 40 characters of it, if it has more."""
    text = repr(value)
    return text if len(text) <= 40 else text[:40] + "…"
