"""Plan a motion that makes parameters identifiable."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import scipy.linalg

from linkside.arguments import positive, whole
from linkside.arrays import FloatArray
from linkside.errors import EstimatorError
from linkside.recording.log import Log
from linkside.robot import Robot
from linkside.robot.limits import Limits, joint_index

from .excitation import Excitation
from .expected import ExpectedErrors, MotorMotion, Sensing, expect, motion_of
from .limits import complete
from .planner import PER_PERIOD, Planner, Progress, Room
from .series import TERMS, FourierSeries

SHARE, HIGHEST = 0.5, 10.0
"""Default bandwidth: this share of the lowest frequency of a link on its spring, and at most this frequency."""

REST = 0.25
"""At rest before and after a motion [s]."""

RATE = 1000.0
"""Samples a second where robot.yaml does not say [Hz]."""


def expected_errors(robot: Robot, logs: Log | Sequence[Log], free: Iterable[str] | None = None) -> ExpectedErrors:
    """Find which parameters are identifiable from recordings or planned motions, and how well.

    Only the motors' positions are used: the sensors are assumed to be those of robot.yaml, with its noise.

    Parameters
    ----------
    robot
        The robot as robot.yaml has it.
    logs
        One or several.
    free
        Kinds or names of parameters; those that `calibrate` frees by default.

    Raises
    ------
    EstimatorError
        The robot has no sensor on its links, or something that calibration does not account for.
    """
    logs = [logs] if isinstance(logs, Log) else list(logs)
    return expect(Sensing(robot, free), [motion_of(robot, log) for log in logs])


def excite(
    robot: Robot,
    logs: Log | Sequence[Log] = (),
    free: Iterable[str] | None = None,
    *,
    limits: Limits | None = None,
    duration: float = 10.0,
    rate: float | None = None,
    bandwidth: float | None = None,
    posture: Mapping[str, float] | None = None,
    reach: float = 0.5,
    one_by_one: bool = False,
    evaluations: int = 200,
    seed: int = 0,
    progress: Progress | None = None,
) -> Excitation:
    """Plan a motion of the motors that makes springs, masses and poses of sensors identifiable.

    Each joint moves along a finite Fourier series that begins and ends at rest. Of all series within the limits it is
    the one after whose recording the volume of the parameters' covariance is smallest (D-optimality), from the Fisher
    information of `calibrate`'s likelihood, with the ``tolerances`` of robot.yaml as a prior.

    Parameters
    ----------
    robot
        The robot as robot.yaml has it.
    logs
        Recordings that will be used for the calibration as well: the motion adds what they lack.
    free
        Kinds or names of parameters that calibration will free; those that `calibrate` frees by default.
    limits
        Of all joints; those of the URDF by default.
    duration
        Of the motion, without the rest of 0.25 s before and after [s].
    rate
        Of the recording [Hz]; robot.yaml's ``rate_hz`` by default, or 1000.
    bandwidth
        Highest frequency of the motion [Hz]. By default half the lowest frequency at which a link vibrates on its
        spring, at most 10.
    posture
        Where the motion begins and ends, by joint [rad, m]; by default the middle of each joint's range.
    reach
        How far joints move from there, within their range [rad, m].
    one_by_one
        Whether joints move one after the other instead of together; each has an equal part of ``duration``.
    evaluations
        Motions that are tried.
    seed
        Seed of the random directions that the search starts from: the same seed gives the same motion.
    progress
        Called with the number of motions tried so far and the best cost.

    Raises
    ------
    EstimatorError
        A setting out of range, a joint without a limit, a posture outside the limits or that motors cannot hold, a
        robot without a sensor on its links.
    """
    sensing = Sensing(robot, free)
    logs = [logs] if isinstance(logs, Log) else list(logs)
    limits = complete(robot, limits or Limits.of(robot))
    rate = positive("rate", rate or robot.config.rate_hz or RATE)
    duration, reach = positive("duration", duration), positive("reach", reach)
    whole("evaluations", evaluations, least=2)
    at = _posture(robot, limits, posture or {})
    room = np.minimum(reach, np.minimum(limits.position[1] - at, at - limits.position[0]))
    every = np.arange(robot.n)
    groups = np.split(every, robot.n) if one_by_one else [every]
    series = _series(robot, at, round(rate * duration / len(groups)) / rate, rate, bandwidth)
    recorded = [motion_of(robot, log) for log in logs]
    before = expect(sensing, recorded)
    known, parts = np.eye(len(sensing.free)) + before.information, []
    for group in groups:
        search = Planner(sensing, series, Room(at, room, limits, group), known, rate)
        x = search.best(max(2, evaluations // len(groups)), seed, progress)
        known = known + search.information(search.motion(x, search.t))
        parts.append(search.motion(x, np.arange(round(series.duration * rate) + 1) / rate))
    motion = _joined(parts, at, round(REST * rate), rate)
    return Excitation(
        robot, motion, limits, search.elastic_torque(motion), before, expect(sensing, [*recorded, motion])
    )


def _posture(robot: Robot, limits: Limits, given: Mapping[str, float]) -> FloatArray:
    low, high = limits.position
    at = np.asarray((low + high) / 2)
    for name, value in given.items():
        j = joint_index(robot, name, "posture")
        if not low[j] < value < high[j]:
            raise EstimatorError(
                f"posture of '{name}': {value:g} is not between its limits, {low[j]:g} and {high[j]:g}"
            )
        at[j] = value
    return at


def _series(robot: Robot, at: FloatArray, duration: float, rate: float, bandwidth: float | None) -> FourierSeries:
    """The functions of time that motions are made of."""
    if bandwidth is None:
        bandwidth = min(SHARE * _lowest_frequency(robot, at), HIGHEST, rate / PER_PERIOD)
    bandwidth = positive("bandwidth", bandwidth)
    if bandwidth > rate / PER_PERIOD:
        raise EstimatorError(f"bandwidth is {bandwidth:g} Hz, expected at most {1 / PER_PERIOD:g} of the rate {rate:g}")
    if bandwidth * duration < TERMS:
        raise EstimatorError(
            f"duration is {duration:g} s, which has fewer than {TERMS} periods of the highest frequency, "
            f"{bandwidth:.3g} Hz; move for longer"
        )
    return FourierSeries(duration, bandwidth)


def _lowest_frequency(robot: Robot, at: FloatArray) -> float:
    """At which the links swing on their springs while motors stand still [Hz]."""
    own = np.flatnonzero(robot.elastic)
    stiffness = np.diag([robot.drives[j].stiffness or 0.0 for j in own])
    mass = robot.mass_matrix(at[None])[0][np.ix_(own, own)]
    least = scipy.linalg.eigh(stiffness, mass, eigvals_only=True)[0]
    return float(np.sqrt(least) / (2 * np.pi))


def _joined(parts: Sequence[MotorMotion], at: FloatArray, rest: int, rate: float) -> MotorMotion:
    """One motion after the other, at rest before and after; each begins where the one before ended."""
    arrays = []
    for name in ("theta", "dtheta", "ddtheta"):
        still = np.tile(at, (rest, 1)) if name == "theta" else np.zeros((rest, len(at)))
        rows = [getattr(part, name)[int(i > 0) :] for i, part in enumerate(parts)]
        arrays.append(np.concatenate([still, *rows, still]))
    return MotorMotion(np.arange(len(arrays[0])) / rate, *arrays)
