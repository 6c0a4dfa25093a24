"""What the library logs, shown to whoever typed a command."""

from __future__ import annotations

import logging
import sys

from tqdm import tqdm


class _BesideProgressBars(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        tqdm.write(self.format(record), file=sys.stderr)


def show_log() -> None:
    """Print what posenet says from now on (INFO and above) as plain sentences on stderr."""
    log = logging.getLogger("posenet")
    if not log.handlers:
        log.addHandler(_BesideProgressBars())
    log.setLevel(logging.INFO)
