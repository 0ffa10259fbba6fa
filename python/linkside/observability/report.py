"""The result of `check`, with a report and a figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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

    def figure(self, over: Sequence[str] | None = None, at: Mapping[str, float] | None = None) -> Figure:
        """Draw where accelerations are lost: over two joints, over the workspace, and along the log.

        Parameters
        ----------
        over
            The two joints of the map; by default those that matter most.
        at
            Where other joints are held [rad, m]; by default near the middle of the log, or of the workspace, where most
            of the map is regular.

        Raises
        ------
        EstimatorError
            There is no such joint.
        """
        from .figure import check_figure

        return check_figure(self, over, at)
