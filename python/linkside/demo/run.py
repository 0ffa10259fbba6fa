"""The observer on the recording inside the package, compared with motor positions alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkside.arrays import FloatArray
from linkside.demo import LOG, ROBOT, TRUTH
from linkside.observers.acceleration import AccelerationObserver
from linkside.recording.estimate import Estimate, EstimateError
from linkside.recording.log import Log
from linkside.robot import Robot


@dataclass(frozen=True, eq=False)
class DemoResult:
    """What the demonstration found.

    Attributes
    ----------
    t : (T,)
        Time [s].
    errors : dict of str to EstimateError
        By guess: from motors alone, and from the observer.
    tool : (T, 3)
        Where the tool truly is [m].
    tool_error : dict of str to (T, 3) array
        How far the tool is from there, likewise [m].
    joint : str
        The joint that moves most.
    torsion, torsion_true : (T,)
        Its torsion θ − q, estimated and true [rad].
    """

    t: FloatArray
    errors: dict[str, EstimateError]
    tool: FloatArray
    tool_error: dict[str, FloatArray]
    joint: str
    torsion: FloatArray
    torsion_true: FloatArray


def run() -> DemoResult:
    """Estimate the recording inside the package, and compare with its truth."""
    robot = Robot.load(ROBOT)
    log = Log.read(LOG, robot)
    truth = Estimate.read(TRUTH)
    guesses = {"motors alone": motor_guess(robot, log), "observer": AccelerationObserver(robot).run(log)}
    moved = int(np.argmax(np.ptp(truth.q, axis=0)))
    torsion, torsion_true = (e.theta[:, moved] - e.q[:, moved] for e in (guesses["observer"], truth))
    errors = {name: guess.error_against(truth) for name, guess in guesses.items()}
    assert truth.tool_position is not None
    away = {name: _tool(guess) - truth.tool_position for name, guess in guesses.items()}
    return DemoResult(log.t, errors, truth.tool_position, away, robot.names[moved], torsion, torsion_true)


def motor_guess(robot: Robot, log: Log) -> Estimate:
    """Take the links to be where the motors are, as a controller without a model of the springs does."""
    unknown = np.full_like(log.theta, np.nan)
    status = np.zeros(len(log), np.uint8)
    tool = robot.tool_position(log.theta)
    return Estimate(log.t, log.theta, unknown, log.theta, unknown, status, robot.names, tool_position=tool)


def _tool(guess: Estimate) -> FloatArray:
    assert guess.tool_position is not None
    return guess.tool_position
