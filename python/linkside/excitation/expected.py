"""Standard errors that a calibration will have, by its own information, before anything is recorded."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkside.arrays import FloatArray
from linkside.calibration.motors import motors, quietest
from linkside.calibration.parameters import BY_LINK_ENCODERS, NOISE, Parameter, choose
from linkside.calibration.prepared import Prepared, kinds
from linkside.calibration.problem import Evidence
from linkside.calibration.response import ResponseProblem
from linkside.calibration.run import filters
from linkside.calibration.uncertainty import Untold, enough, stands_in, uncertainty, unidentifiable
from linkside.errors import EstimatorError
from linkside.recording.layout import as_columns, signal_columns
from linkside.recording.log import Log
from linkside.recording.motion import moving
from linkside.robot import Robot
from linkside.robot.requirements import refuse_unsupported
from linkside.robot.sensors import ThreeAxes


@dataclass(frozen=True, eq=False)
class MotorMotion:
    """How motors move, link side.

    Attributes
    ----------
    t : (T,)
        Times, evenly spaced [s].
    theta, dtheta, ddtheta : (T, n)
        Positions, velocities and accelerations [rad, rad/s, rad/s²].
    """

    t: FloatArray
    theta: FloatArray
    dtheta: FloatArray
    ddtheta: FloatArray

    @property
    def period(self) -> float:
        """Time between samples [s]."""
        return float(self.t[-1] - self.t[0]) / (len(self.t) - 1)

    @property
    def arrays(self) -> dict[str, FloatArray]:
        """As the core takes it."""
        return {"t": self.t, "theta": self.theta, "dtheta": self.dtheta, "ddtheta": self.ddtheta}


@dataclass(frozen=True, eq=False)
class ExpectedErrors:
    """Standard errors that a calibration will have if the robot is as robot.yaml says.

    Attributes
    ----------
    parameters : tuple of Parameter
        All that it would free.
    std : (p,)
        Standard errors, in tolerances; 1 if nothing is known beyond robot.yaml.
    reasons : dict of str to str
        Parameters that the motion does not identify, and why.
    information : (p, p)
        Fisher's, in tolerances.
    """

    parameters: tuple[Parameter, ...]
    std: FloatArray
    reasons: dict[str, str]
    information: FloatArray

    def error(self, name: str) -> float:
        """Give a parameter's standard error in its unit."""
        index = [p.name for p in self.parameters].index(name)
        return float(self.std[index] * self.parameters[index].slope(0.0))

    @property
    def identifiable(self) -> tuple[str, ...]:
        """Names of the parameters that are identifiable."""
        return tuple(p.name for p in self.parameters if p.name not in self.reasons)


class Sensing:
    """A robot's sensors on its links, and what a calibration by them would free.

    Parameters
    ----------
    robot
        As robot.yaml has it.
    free
        Kinds or names of parameters; those that `calibrate` frees by default.

    Raises
    ------
    EstimatorError
        The robot has no sensor on its links, or something that calibration does not account for.
    """

    def __init__(self, robot: Robot, free: Iterable[str] | None = None) -> None:
        refuse_unsupported(robot, "calibration")
        robot.require_masses("planning a motion")
        if not robot.elastic.any():
            raise EstimatorError("no joint of the robot is elastic: there is nothing to calibrate")
        self.robot, self.noise = robot, _noise(robot)
        if not self.noise:
            raise EstimatorError(
                "robot.yaml has no sensor behind the springs, and motor positions alone do not determine them; add "
                "accelerometers, gyroscopes, a link_encoder or a joint_torque sensor"
            )
        chosen = choose(robot, free, False, {})
        if free is None and "q" not in self.noise:
            chosen = [p for p in chosen if p.kind not in BY_LINK_ENCODERS]
        self.free = tuple(p for p in chosen if p.kind not in NOISE)
        if not self.free:
            raise EstimatorError("free: none of these parameters is identifiable from sensors on links")

    def log(self, t: FloatArray, theta: FloatArray) -> Log:
        """Give a recording of a motion in which the sensors read nothing yet."""
        step = self.robot.config.encoder.resolution
        columns = signal_columns(self.robot)
        signals = {kind: np.zeros((len(t), len(columns[kind]))) for kind in self.noise}
        read = np.round(theta / step) * step if step else theta
        table = as_columns(self.robot, {"t": t, "theta": read, **signals}, "planned motion")
        return Log.from_table(table, self.robot, "planned motion", check=False)

    def problem(self, recordings: Sequence[Prepared]) -> ResponseProblem:
        """Give the problem that a calibration would solve."""
        return ResponseProblem(self.robot, recordings, self.free)

    def start(self, problem: ResponseProblem) -> FloatArray:
        """Where the search would begin, z of each parameter."""
        at = filters(problem)
        return np.array([at.get(p.name, 0.0) for p in self.free])

    def recorded(self, motion: MotorMotion, seed: int = 0) -> Prepared:
        """Give what sensors and encoders would read along a motion, with their noise."""
        log = self.log(motion.t, motion.theta)
        blank = Prepared.of(self.robot, log, kinds(self.robot, [log]))
        exact = self.problem([replace(blank, motors=motion.arrays)])
        [readings] = exact.predicted(self.start(exact))
        std = np.concatenate([np.broadcast_to(self.noise[kind], len(log.columns(kind))) for kind in exact.kinds])
        random = np.random.default_rng(seed)
        return replace(blank, readings=readings + std * random.standard_normal(readings.shape))


def motion_of(robot: Robot, log: Log) -> MotorMotion:
    """Give how motors moved in a recording."""
    return MotorMotion(**motors(robot, log, quietest(robot, log)))


def expect(sensing: Sensing, motions: Sequence[MotorMotion]) -> ExpectedErrors:
    """Find what a calibration by recordings of some motions would tell; of none, what robot.yaml's tolerances say."""
    free, p = sensing.free, len(sensing.free)
    if not motions:
        return ExpectedErrors(free, np.ones(p), {q.name: "nothing is recorded" for q in free}, np.zeros((p, p)))
    recordings = [sensing.recorded(motion, seed) for seed, motion in enumerate(motions)]
    blank = sensing.problem(recordings)
    z = sensing.start(blank)
    evidence = blank.settled(z).evidence(z, detail=True)
    moves = np.any([moving(recording.log) for recording in recordings], axis=0)
    still = [name for name, does in zip(sensing.robot.names, moves, strict=True) if not does]
    untold = unidentifiable(free, z, evidence, still)
    # What stands in for another is left out. All else stays uncertain: a load that hides a spring does not become
    # known by being left out.
    kept = [i for i, q in enumerate(free) if q.name not in untold.reasons or not stands_in(q)]
    std = np.ones(p)
    found = uncertainty(_of(evidence, kept), min(recording.period for recording in recordings)).std
    std[kept] = np.minimum(found, 1.0)
    hidden = _hidden(free, std, untold)
    return ExpectedErrors(free, std, untold.reasons | hidden, evidence.information)


def _hidden(free: Sequence[Parameter], std: FloatArray, untold: Untold) -> dict[str, str]:
    """Parameters that are not identifiable unless others are known."""
    left_out = [q.name for q in free if q.name in untold.reasons and not (q.name in untold.considered or stands_in(q))]
    reason = f"it is identifiable only if {' and '.join(left_out)} {'is' if len(left_out) == 1 else 'are'} known"
    return {q.name: reason for q, s in zip(free, std, strict=True) if q.name not in untold.reasons and s > enough(q)}


def _of(evidence: Evidence, kept: list[int]) -> Evidence:
    """The evidence on some of the parameters."""
    return replace(
        evidence,
        gradient=evidence.gradient[kept],
        information=evidence.information[np.ix_(kept, kept)],
        scores=[scores[:, kept] for scores in evidence.scores],
    )


def _noise(robot: Robot) -> dict[str, FloatArray | float]:
    """Standard deviations of what sensors on links read, by signal."""
    config = robot.config
    found: dict[str, FloatArray | float] = {}
    carried: dict[str, Sequence[ThreeAxes]] = {
        "acceleration": robot.accelerometers,
        "rate": robot.gyroscopes,
        "position": robot.trackers,
    }
    for kind, carriers in carried.items():
        if carriers:
            found[kind] = np.array([sensor.noise_std for sensor in carriers for _ in sensor.axes])
    if config.link_encoder is not None:
        found["q"] = config.link_encoder.resolution / np.sqrt(12)
    if config.joint_torque is not None:
        found["torque"] = config.joint_torque.noise_std
    return found
