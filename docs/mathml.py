"""Formulas of the pages as MathML, which browsers draw by themselves: no script, and nothing to fetch."""

from __future__ import annotations

from typing import Any

from latex2mathml.converter import convert


def fence(source: str, language: str, css_class: str, options: Any, md: Any, **settings: Any) -> str:
    """A block of TeX as pymdownx.superfences wants it."""
    return f'<div class="{css_class}">{convert(source.strip(), display="block")}</div>'
