"""Figures as parts of a page: SVG, or where that would be too long, PNG."""

from __future__ import annotations

import base64
import io
import re
import zlib
from typing import Any

import matplotlib as mpl
from markupsafe import Markup
from matplotlib.figure import Figure

SETTINGS: dict[Any, Any] = {"svg.fonttype": "none", "path.simplify": True, "font.family": "sans-serif"}
"""Text stays text: it can be searched, and it is short."""

NOTHING = dict.fromkeys(("Date", "Creator", "Format", "Type"))
"""Without these SVG has no metadata, whose name spaces look like addresses."""

LONGEST_SVG = 400_000
"""Characters of a figure; one that is longer is drawn in points."""

DPI = 120


def drawing(figure: Figure, name: str) -> Markup:
    """Draw a figure for a page.

    Parameters
    ----------
    figure
        The figure.
    name
        Its description for those who do not see it; figures of a page differ in it.
    """
    text = _svg(figure, name)
    return Markup(text) if len(text) <= LONGEST_SVG else picture(figure, name)


def picture(figure: Figure, name: str) -> Markup:
    """The same as PNG."""
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=DPI)
    width = round(96 * figure.get_figwidth())
    encoded = base64.b64encode(data.getvalue()).decode("ascii")
    return Markup('<img alt="{}" style="{}" src="data:image/png;base64,{}">').format(name, _style(width), encoded)


def _svg(figure: Figure, name: str) -> str:
    text = io.StringIO()
    salt = f"{zlib.crc32(name.encode()):08x}"
    with mpl.rc_context(SETTINGS | {"svg.hashsalt": salt}):
        figure.savefig(text, format="svg", metadata=NOTHING)
    svg = text.getvalue()
    svg = svg[svg.index("<svg") :]
    # Names of groups are numbered in each figure: together with another's they would be there twice.
    svg = re.sub(r'\bid="([^"]+)"', rf'id="{salt}-\1"', svg)
    svg = re.sub(r'"#([^"]+)"', rf'"#{salt}-\1"', svg)
    svg = re.sub(r"url\(#([^)]+)\)", rf"url(#{salt}-\1)", svg)
    svg = re.sub(r' (width|height)="[\d.]+pt"', "", svg, count=2)
    start = Markup('<svg role="img" aria-label="{}" style="{}"').format(name, _style(round(96 * figure.get_figwidth())))
    return start + Markup(svg.removeprefix("<svg"))


def _style(width: int) -> str:
    """As wide as it was drawn, or as the page is; no narrower than can be read."""
    return f"max-width:{width}px;min-width:{min(width, max(320, round(0.55 * width)))}px"
