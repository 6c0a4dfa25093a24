"""What h5py makes of a damaged file, as one sentence."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from evalkit.errors import InputError

# By where the damage lies: which of them is not documented, and one flipped bit can raise any.
RAISED = (OSError, KeyError, RuntimeError, TypeError, ValueError)


@contextmanager
def damage_named(path: Path | str, sentence: str = "damaged or incomplete ({error})") -> Iterator[None]:
    """Within the block, what reading a damaged shard raises becomes an InputError: `sentence`, and the mend.

    Raises:
        InputError: the block raised it, or the file is damaged; `{error}` in `sentence` stands for what was raised.
    """
    try:
        yield
    except InputError:
        raise
    except RAISED as error:
        raise InputError(f"{path}: {sentence.format(error=error)}; delete it and run 'simgen build' again.") from None
