"""How threads wait for each other: briefly awake, then asleep.

The threads of PyTorch's and numba's OpenMP meet at a barrier after every small piece of work, hundreds of times an
image. By default they spin there for milliseconds. On a machine that does something else as well, the thread that
is waited for may have lost its core to the one that spins, and prediction takes many times as long. Whoever set one of
these variables keeps it.
"""

from __future__ import annotations

import os

WAITING = {
    "GOMP_SPINCOUNT": "1000",  # GNU's OpenMP: some ten microseconds, as long as an undisturbed barrier takes
    "KMP_BLOCKTIME": "0",  # Intel's and LLVM's, in milliseconds
}


def wait_briefly() -> None:
    """Have threads wait so in this process and its children; without effect on OpenMP libraries already loaded."""
    if "OMP_WAIT_POLICY" in os.environ:
        return
    for name, value in WAITING.items():
        os.environ.setdefault(name, value)
