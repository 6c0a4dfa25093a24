"""JSON files of anybody's, read with a sentence where they are none."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from evalkit.errors import InputError


def load_json(path: Path | str, object_hook: Any = None) -> Any:
    """Parse a JSON file of anybody's.

    Raises:
        InputError: it is not UTF-8, truncated, not JSON, or nested too deep.
        OSError: the file cannot be read.
    """
    try:
        text = Path(path).read_bytes().decode("utf-8-sig")  # some editors write a byte order mark
        return json.loads(text, object_hook=object_hook)
    except RecursionError:
        raise InputError(f"{path}: the JSON is nested too deep to be a document of ours.") from None
    except ValueError as error:  # JSONDecodeError, UnicodeDecodeError, integers of thousands of digits
        raise InputError(f"{path}: not a valid JSON file ({error}); is it truncated?") from None
