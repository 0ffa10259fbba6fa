"""How the figures of these pages look: SVG on a transparent ground, with ink that turns light on a dark page."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

INK = "#222222"
LIGHT = {INK: "#dddddd", "#000000": "#ffffff", "#e5e5e5": "#444444"}
"""Colours on a dark page, by those on a light one: text and axes, black lines, the grid."""

SETTINGS = {
    "svg.hashsalt": "linkside",  # the same file each time
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
    "path.simplify_threshold": 0.5,
} | dict.fromkeys(("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color"), INK)


@contextmanager
def style() -> Iterator[None]:
    """Make the figures that are drawn within look like the others of the pages."""
    with plt.rc_context(SETTINGS):
        yield
    plt.close("all")


def save(figure: Figure, path: Path) -> None:
    """Write a figure for pages of both kinds; call it within `style`."""
    figure.savefig(path, metadata={"Date": None})
    head, opening, rest = path.read_text().partition("<defs>")
    path.write_text(f"{head}{dark_sheet()}\n {opening}{rest}")
    print(f"figure: {path}", flush=True)


def dark_sheet() -> str:
    """Return the style sheet that exchanges colours where the reader's system asks for dark pages."""
    rules = " ".join(
        f'[style*="{kind}: {on_light}"] {{{kind}: {on_dark} !important}}'
        for on_light, on_dark in LIGHT.items()
        for kind in ("fill", "stroke")
    )
    return f"<style>@media (prefers-color-scheme: dark) {{{rules}}}</style>"
