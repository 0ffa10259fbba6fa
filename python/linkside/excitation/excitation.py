"""A planned motion, the standard errors to expect, and its file."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from linkside.arrays import FloatArray
from linkside.files.tables import ArrowTable
from linkside.recording.layout import as_columns
from linkside.recording.writer import EstimateWriter
from linkside.robot import Robot
from linkside.robot.limits import Limits
from linkside.text import Titled, as_text

from .expected import ExpectedErrors, MotorMotion
from .words import errors_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class Excitation:
    """A planned motion of the motors, and the standard errors of a calibration with it.

    Attributes
    ----------
    robot : Robot
        The robot that it was planned for.
    motion : MotorMotion
        The motion of the motors.
    limits : Limits
        The limits of the motion.
    torque : (T, n)
        Torques of the motors along it, if the robot is as robot.yaml says [N m].
    before, after : ExpectedErrors
        Standard errors to expect without it, and with it.
    """

    robot: Robot
    motion: MotorMotion
    limits: Limits
    torque: FloatArray
    before: ExpectedErrors
    after: ExpectedErrors

    def __repr__(self) -> str:
        """Robot, duration and what is identifiable in one line."""
        told = f"{len(self.after.identifiable)} of {len(self.after.parameters)} parameters identifiable"
        return f"Excitation({self.robot!r}, {self.motion.t[-1]:g} s at {1 / self.motion.period:g} Hz, {told})"

    def write(self, path: str | PathLike[str]) -> None:
        """Write a Parquet or CSV file (by suffix), whole or not at all, which `Log.read` takes for the same robot.

        Columns ``theta_<joint>``, ``dtheta_<joint>`` and ``ddqref_<joint>``, in the units and on the side of the gear
        that robot.yaml says of recordings.

        Raises
        ------
        OutputError
            When that cannot be.
        """
        motion = self.motion
        signals = {"t": motion.t, "theta": motion.theta, "dtheta": motion.dtheta, "ddqref": motion.ddtheta}
        with EstimateWriter(str(path)) as writer:
            writer.write(ArrowTable(pa.table(as_columns(self.robot, signals, "planned motion")), "planned motion"))

    def tables(self) -> list[Titled]:
        """Give the motion, and the standard errors to expect, as tables."""
        return [self._motion_table(), errors_table(self.before, self.after)]

    def to_text(self) -> str:
        """Report in words."""
        return as_text(self.tables(), 160)

    def figure(self) -> Figure:
        """Draw the motion, and standard errors before and after."""
        from .figure import excitation_figure

        return excitation_figure(self.robot, self.motion, self.before, self.after)

    def _motion_table(self) -> Titled:
        heads = ("joint", "from", "to", "velocity", "of its limit", "acceleration", "torque", "of its limit")
        table = Titled(f"Motion, {self.motion.t[-1]:g} s; rad or m, N m or N", heads)
        for j, name in enumerate(self.robot.names):
            theta = self.motion.theta[:, j]
            peak = [float(np.abs(a[:, j]).max()) for a in (self.motion.dtheta, self.motion.ddtheta, self.torque)]
            share = peak[0] / self.limits.velocity[j], peak[2] / self.limits.torque[j]
            cells = [f"{x:.3g}" for x in (theta.min(), theta.max(), peak[0])]
            torque = "" if np.isinf(self.limits.torque[j]) else f"{share[1]:.0%}"
            table.add_row(name, *cells, f"{share[0]:.0%}", f"{peak[1]:.3g}", f"{peak[2]:.3g}", torque)
        return table
