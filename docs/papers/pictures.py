"""Draws the pictures of the papers' pages: one figure of each repeated experiment."""

from importlib import import_module
from pathlib import Path

from drawing import save, style

HERE = Path(__file__).parent
PICTURES = {
    "deluca2007": "control_short",
    "axelsson2012": "error",
    "ulrich2011": "tool_path",
    "cristofaro2023": "bounded",
}


def draw_all() -> None:
    """Repeat each experiment, and keep its picture."""
    for paper, picture in PICTURES.items():
        with style():
            found = import_module(f"linkside.papers.{paper}").reproduce()
            save(found.figures[picture], HERE / f"{paper}.svg")
