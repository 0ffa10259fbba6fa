"""Draws choose.svg: which method, by questions in their order."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
from drawing import INK, save, style

from linkside.figures.style import COLOURS

HERE = Path(__file__).parent

QUESTIONS = (
    ("Are the springs known?", "no", "calibrate first"),
    ("Only velocities, of joints taken as rigid?", "yes", "reduced-order, nicosia-tomei"),
    ("Are masses or payload unknown?", "yes", "observer"),
    ("Is there no sensor on the links?", "yes", "elastic-smoother; in a loop elastic-ekf"),
    ("Several peaks, hard limits, heavy outliers?", "yes", "particle, marginalized"),
    ("Does the estimate run in a control loop?", "yes", "ekf"),
    (None, None, "smoother"),
)
"""Question, the answer that leads to a method, and the method; the last one is for all that is left."""


@style()
def draw_all() -> None:
    """Questions on the left, one below the other; methods on the right."""
    figure, axes = plt.subplots(figsize=(8.6, 5.2), layout="constrained")
    axes.axis("off")
    axes.set(xlim=(0, 10), ylim=(-len(QUESTIONS) + 0.5, 0.6))
    for row, (question, answer, method) in enumerate(QUESTIONS):
        if question is None:
            box(axes, 2.9, -row, method, COLOURS[0])
            continue
        box(axes, 2.9, -row, question, INK)
        box(axes, 8.1, -row, method, COLOURS[0])
        arrow(axes, (5.35, -row), (6.2, -row), answer, above=True)
        arrow(axes, (2.9, -row - 0.27), (2.9, -row - 0.73), "yes" if answer == "no" else "no", above=False)
    save(figure, HERE / "choose.svg")


def box(axes: Any, x: float, y: float, text: str, colour: str) -> None:
    """A text in a frame, its middle at (x, y)."""
    frame = {"boxstyle": "round,pad=0.45", "facecolor": "none", "edgecolor": colour, "linewidth": 1.3}
    axes.text(x, y, text, ha="center", va="center", fontsize=10, bbox=frame)


def arrow(axes: Any, start: tuple[float, float], end: tuple[float, float], text: str, *, above: bool) -> None:
    """An arrow with the answer that it stands for."""
    axes.annotate("", xy=end, xytext=start, arrowprops={"arrowstyle": "->", "color": INK})
    x, y = (start[0] + end[0]) / 2, (start[1] + end[1]) / 2
    place = (x, y + 0.1, "center", "bottom") if above else (x + 0.12, y, "left", "center")
    axes.text(place[0], place[1], text, ha=place[2], va=place[3], fontsize=9)


if __name__ == "__main__":
    draw_all()
