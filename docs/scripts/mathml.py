"""Formulas as MathML, which browsers draw by themselves: no script, no font and no network is needed.

``zensical.toml`` names :func:`block` as what renders a fenced block in the language ``math``.
"""

from __future__ import annotations

from typing import Any

from latex2mathml.converter import convert


def block(source: str, *_: Any, **__: Any) -> str:
    """One formula in LaTeX as a block of HTML. Lines are formulas of their own, one below the other."""
    lines = [convert(line, display="block") for line in source.splitlines() if line.strip()]
    return '<div class="formula">' + "".join(lines) + "</div>"
