"""An estimate and its recording over time, condensed for a report."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from linkside.robot import Robot

from .estimate import Estimate, Status
from .log import Log
from .trace import Trace

FLAGS = tuple(flag for flag in Status if flag)


@dataclass
class Overview:
    """What an estimate is over time; a `Trace` without rows where the method does not have it.

    Attributes
    ----------
    robot : Robot
        Whose links were estimated.
    tool, tool_std : Trace
        The tool's place and its standard deviations [m], three channels.
    bend : Trace
        How far the tool is from where motors alone would have it [m].
    torsion, q_std : Trace
        Links less motors, and the links' standard deviations [rad, m], a channel a joint.
    motors : Trace
        Motor positions of the recording less those of the estimate, likewise.
    forces : Trace
        Accelerometers less what they must read by the estimate [m/s²], a channel an axis.
    nis : Trace
        Normalised innovation squared of each row.
    flags : Trace
        Whether a row has each flag of `Status` but GOOD.
    """

    robot: Robot
    tool: Trace = field(default_factory=Trace)
    tool_std: Trace = field(default_factory=Trace)
    bend: Trace = field(default_factory=Trace)
    torsion: Trace = field(default_factory=Trace)
    q_std: Trace = field(default_factory=Trace)
    motors: Trace = field(default_factory=Trace)
    forces: Trace = field(default_factory=Trace)
    nis: Trace = field(default_factory=Trace)
    flags: Trace = field(default_factory=Trace)

    @classmethod
    def of(cls, robot: Robot, pieces: Iterable[tuple[Log, Estimate]]) -> Overview:
        """Look at a recording and its estimate, piece by piece, row by row the same times."""
        overview = cls(robot)
        for log, estimate in pieces:
            overview._add(log, estimate)
        return overview

    def _add(self, log: Log, estimate: Estimate) -> None:
        t, robot = estimate.t, self.robot
        self.flags.add(t, np.array([(estimate.status & flag) != 0 for flag in FLAGS], float).T)
        self.torsion.add(t, estimate.q - estimate.theta)
        self.motors.add(t, log.theta - estimate.theta)
        for trace, values in ((self.tool, estimate.tool_position), (self.tool_std, estimate.tool_std)):
            if values is not None:
                trace.add(t, values)
        if estimate.q_std is not None:
            self.q_std.add(t, estimate.q_std)
        if estimate.nis is not None:
            self.nis.add(t, estimate.nis[:, None])
        if estimate.tool_position is not None and robot.tool is not None:
            stiff = robot.tool_position(np.ascontiguousarray(estimate.theta))
            self.bend.add(t, np.linalg.norm(estimate.tool_position - stiff, axis=1)[:, None])
        if estimate.ddq is not None and log.acceleration is not None:
            read = robot.specific_force(*map(np.ascontiguousarray, (estimate.q, estimate.dq, estimate.ddq)))
            self.forces.add(t, log.acceleration - read)
