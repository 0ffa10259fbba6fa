"""Figures, drawn without a display; colours that colour-blind readers can tell apart (Okabe and Ito)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from linkside.files import writing
from linkside.files.parts import replacing

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
DASHES = ("-", "--", "-.", ":")
SUFFIXES = (".png", ".pdf", ".svg")


def check_writable(path: str | Path) -> None:
    """Raise `OutputError` when a figure could not be written to ``path``; nothing there is changed."""
    writing.check_writable(path, SUFFIXES)


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure in the format of its suffix, whole or not at all."""
    check_writable(path)
    path = Path(path)
    with writing.writing(path), replacing(path) as file:
        figure.savefig(file, dpi=150, format=path.suffix[1:].lower())


def finish(axes: Any, legend: bool = True) -> None:
    """Give axes a grid and no frame, and the legend beside them, where it hides nothing."""
    axes.grid(True, color="0.9")
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.margins(x=0.01)
    if legend:
        legend_beside(axes)


def legend_beside(axes: Any, **settings: Any) -> None:
    """Put the legend to the right of axes, in as many columns as keep it no higher than they are."""
    count = len(axes.get_legend_handles_labels()[1])
    place = {"loc": "upper left", "bbox_to_anchor": (1.01, 1.0), "borderaxespad": 0.0, "frameon": False}
    if count:
        axes.legend(**place, fontsize="small", ncols=1 + count // 16, **settings)


def legend_below(figure: Figure, axes: Any, columns: int = 4) -> None:
    """Put the legend of axes below the figure."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(columns, len(labels)), frameon=False)


def line_style(index: int) -> dict[str, str]:
    """Colour and dash of the line of a channel or a joint: 28 that differ, neighbours in both."""
    return {
        "color": COLOURS[index % len(COLOURS)],
        "linestyle": DASHES[(index % len(COLOURS) + index // len(COLOURS)) % len(DASHES)],
    }


def plain_log(axis: Any) -> None:
    """Label a logarithmic axis with plain numbers; if it spans less than two decades, label minor ticks too."""
    low, high = sorted(axis.get_view_interval())
    short = low > 0 and np.log10(high / low) < 2
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(FuncFormatter(lambda value, _: f"{value:g}" if short and _leading(value) else ""))


def _leading(value: float) -> bool:
    """Whether a number's first digit is 2 or 5."""
    return value > 0 and round(value / 10 ** np.floor(np.log10(value) + 1e-9)) in (2, 5)
