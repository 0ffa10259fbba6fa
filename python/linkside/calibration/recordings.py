"""Whether recordings can be calibrated with: motion, sensors within their range, one robot."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from linkside.errors import EstimatorError, LogError
from linkside.recording.continuity import refuse_uneven
from linkside.recording.log import Log
from linkside.recording.motion import LEAST_MOTION, moving
from linkside.robot import Robot
from linkside.robot.requirements import refuse_unsupported

from .prepared import kinds

SATURATED = 10
"""A sensor that stays at its extreme value for this many samples is saturated."""


def use_torque(robot: Robot, logs: Sequence[Log], torque: bool | None) -> bool:
    """Whether motor torques are readings: as asked for, else where there is nothing better.

    Raises
    ------
    EstimatorError
        No sensor of the links, and no torques.
    """
    seen = bool(kinds(robot, logs))
    if torque is None:
        torque = not seen and all(log.tau is not None for log in logs)
    if torque:
        for log in logs:
            log.require("tau", purpose="calibration with motor torques")
    elif not seen:
        raise EstimatorError(
            "motor positions alone do not determine a spring: record accelerometers, link encoders, gyroscopes, joint "
            "torques or motor torques"
        )
    return torque


def refuse(robot: Robot, logs: Sequence[Log]) -> None:
    """Refuse recordings that cannot be used, before any work is done.

    Raises
    ------
    EstimatorError
        No recording, or a robot without an elastic joint.
    LogError
        Read for another robot, a column that is missing, no motion, an accelerometer at the end of its range.
    """
    if not logs:
        raise EstimatorError("there is no log to calibrate with")
    refuse_unsupported(robot, "calibration")
    if not robot.elastic.any():
        raise EstimatorError("no joint of the robot is elastic: there is nothing to calibrate")
    for log in logs:
        _refuse_foreign(robot, log)
        log.require("theta", purpose="calibration")
        if robot.acceleration_channels:
            log.require("acceleration", purpose="calibration")
        log.require_start("calibration")
        refuse_uneven(log, purpose="calibration", instead="", share=0.5)
        if not (moving(log) & robot.elastic).any():
            raise LogError(
                f"{log.source}: no elastic joint's motor moves by more than {LEAST_MOTION} rad: "
                "nothing to calibrate with"
            )
        _refuse_saturated(robot, log)


def _refuse_foreign(robot: Robot, log: Log) -> None:
    ours = {"theta": [f"theta_{joint}" for joint in robot.names], "acceleration": robot.acceleration_channels}
    for signal, names in ours.items():
        expected = tuple(robot.columns.names.get(name, name) for name in names)
        if log.columns(signal) != expected:
            read = ", ".join(log.columns(signal)) or "none"
            raise LogError(
                f"{log.source}: read for another robot, with the columns {read}; "
                f"this one's for {signal} are {', '.join(expected) or 'none'}"
            )


def _refuse_saturated(robot: Robot, log: Log) -> None:
    if log.acceleration is None:
        return
    for name, values in zip(robot.acceleration_channels, log.acceleration.T, strict=True):
        for extreme in (np.nanmin(values), np.nanmax(values)):
            at = values == extreme
            if _longest_run(at) >= SATURATED:
                raise LogError(
                    f"{log.source}: {name} stays at its extreme value {extreme:g} for {_longest_run(at)} samples: "
                    "a sensor at the end of its range; record with a wider one, or set those samples to NaN"
                )


def _longest_run(flags: npt.NDArray[np.bool_]) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return int(np.max(edges[1::2] - edges[::2], initial=0))
