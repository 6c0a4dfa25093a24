"""Our commands, run as a user types them, from the environment that runs the benchmark."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path


def run(command: str, *arguments: object) -> None:
    """Run one of simgen, posenet and evalkit, and show it.

    Raises:
        subprocess.CalledProcessError: it failed.
    """
    words = [command, *map(str, arguments)]
    print(f"$ {' '.join(words)}", flush=True)
    subprocess.run([str(Path(sys.executable).with_name(command)), *words[1:]], check=True)
