"""The result of a calibration, with its robot.yaml, report and figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from linkside.report import Input

from .result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Calibration(Result):
    """A result with its robot.yaml, its report and its figures."""

    def write(self, source: str | Path, out: str | Path) -> None:
        """Write the robot.yaml ``source`` with the estimates in place of its values; see `output.write`."""
        from .output import write

        write(self, source, out)

    def write_report(self, out: str | Path, inputs: Sequence[Input] = ()) -> None:
        """Write a report with figures, one HTML file; ``inputs`` are the files it is made from, by `report.inputs`."""
        from .report import page

        page(self, inputs).write(out)

    def profile(self, first: str, second: str, points: int = 15) -> Figure:
        """Draw the posterior over a pair of parameters, see `figures.profile`."""
        from .figures import profile

        return profile(self, first, second, points)
