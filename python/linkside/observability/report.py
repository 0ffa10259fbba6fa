"""What `check` found, to be read and looked at."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from linkside.text import as_text

from .result import CheckResult
from .words import check_tables

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class CheckReport(CheckResult):
    """CheckResult with a report in words and a figure."""

    def to_text(self, width: int = 100) -> str:
        """Report in words and tables, without colours."""
        return as_text(check_tables(self), width)

    def figure(self) -> Figure:
        """Draw where accelerations are lost: over the two joints that matter most, and along the log."""
        from .figure import check_figure

        return check_figure(self)
