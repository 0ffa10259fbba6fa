"""What a repeat of the motion showed, and what was learnt from it."""

from __future__ import annotations

from dataclasses import dataclass

WORTH = 0.1
"""A step is not taken if it moves the tool by a smaller share of the standard deviation of its estimate.

Where the estimate is off by its standard deviation, such a step makes the error smaller by 0.5 %, or larger, if it has
by chance something of the shape of the estimate's error.
"""


@dataclass(frozen=True)
class Trial:
    """Errors of one repeat of the motion, the step that they call for, and the errors expected after it.

    Attributes
    ----------
    number : int
        From 0, the repeat without a correction.
    rms : (n,)
        Error of the links, rms [rad].
    std : (n,)
        Standard deviation of the estimate, rms, as far as the method has one [rad].
    step : (n,)
        By how much links are to move differently, rms [rad].
    tool_rms, tool_std, tool_step : float, optional
        The same of the tool's position, where the robot has a tool, and the method a standard deviation [m].
    expected : (n,)
        Error that the model expects of the next repeat, rms [rad].
    used : float
        Share of the rows that were learnt from.
    held : tuple of str
        Limits that held the step back, ``"torque of axis2"``.
    """

    number: int
    rms: tuple[float, ...]
    std: tuple[float, ...]
    step: tuple[float, ...]
    tool_rms: float | None
    tool_std: float | None
    tool_step: float | None
    expected: tuple[float, ...]
    used: float
    held: tuple[str, ...] = ()

    @property
    def reached(self) -> bool:
        """Whether the step is so small beside the estimate's own standard deviation that it is not taken.

        Judged by the tool, or by every link where there is none.
        """
        if self.tool_step is not None and self.tool_std is not None:
            return self.tool_step <= WORTH * self.tool_std
        return all(step <= WORTH * std for step, std in zip(self.step, self.std, strict=True))
