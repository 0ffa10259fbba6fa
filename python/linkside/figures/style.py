"""Figures, drawn without a display; colours that colour-blind readers can tell apart (Okabe and Ito)."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from linkside.errors import OutputError
from linkside.files.parts import open_part, publish

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
SUFFIXES = (".png", ".pdf", ".svg")


def check_writable(path: str | Path) -> None:
    """Raise `OutputError` when a figure could not be written to ``path``; nothing there is changed."""
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise OutputError(f"{path}: a file that ends in {', '.join(SUFFIXES)} is expected")
    if path.exists() and not (path.is_file() and os.access(path, os.W_OK)):
        raise OutputError(f"{path}: this cannot be written over")
    try:
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror}") from error


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure in the format of its suffix, whole or not at all."""
    check_writable(path)
    path = Path(path)
    part = None
    try:
        part, file = open_part(path)
        with file:
            figure.savefig(file, dpi=150, format=path.suffix[1:].lower())
            publish(part, file, path)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror}") from error
    finally:
        if part is not None:
            part.unlink(missing_ok=True)


def finish(axes: Any, legend: bool = True) -> None:
    """Give axes a grid and no frame."""
    axes.grid(True, color="0.9")
    axes.spines[["top", "right"]].set_visible(False)
    axes.margins(x=0.01)
    if legend:
        axes.legend(frameon=False)
