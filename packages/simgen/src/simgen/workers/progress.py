"""The line that shows how far a build is: scenes, scenes a second, time left, drops redone."""

from __future__ import annotations

from types import TracebackType
from typing import Any

from tqdm import tqdm

FORMAT = "{percentage:3.0f}%|{bar}| {n_fmt}/{total_fmt} scenes [{elapsed}<{remaining}, {rate_noinv_fmt}{postfix}]"


class SceneProgress:
    """A progress bar of `total` scenes on stderr; a context manager."""

    def __init__(self, total: int) -> None:
        self.total, self.redone = total, 0
        self._bar: tqdm[Any] = tqdm(total=total, unit=" scenes", bar_format=FORMAT)

    def __enter__(self) -> SceneProgress:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.close()

    @property
    def done(self) -> int:
        """Scenes that are shown as done."""
        return int(self._bar.n)

    def show(self, done: int, redone: int) -> None:
        """Scenes done and drops redone so far; fewer than before where a worker died."""
        if redone != self.redone:
            self.redone = redone
            self._bar.set_postfix_str(f"{redone} drops redone", refresh=False)
        if done > self._bar.n:
            self._bar.update(done - self._bar.n)
        elif done < self._bar.n:
            self._bar.n = done
            self._bar.refresh()
