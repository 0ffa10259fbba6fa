"""Calibrate a robot from its own recordings."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import numpy as np

from linkside.arrays import FloatArray
from linkside.errors import EstimatorError, LinksideError, NumericalError
from linkside.files.yaml_source import suggest
from linkside.kalman.noise import Noise
from linkside.mapping import Map, here
from linkside.recording.log import Log
from linkside.recording.motion import moving
from linkside.robot import Robot

from .acceptance import filters_gain, objections
from .calibration import Calibration
from .parameters import BY_LINK_ENCODERS, OF_LINK_ENCODERS, Bounds, Parameter, choose
from .posterior import Posterior
from .prepared import kinds, recordings
from .recordings import refuse, use_torque
from .response import ResponseProblem
from .response_run import ResponseRun
from .result import Estimated
from .search import Progress, Search
from .uncertainty import Alone, Contradiction, Uncertainty, compare, uncertainty, unidentifiable


@contextmanager
def _in_our_words() -> Iterator[None]:
    """Turn errors of the libraries below into our own."""
    try:
        yield
    except LinksideError:
        raise
    except np.linalg.LinAlgError as error:
        message = "calibration: the recordings do not distinguish the free parameters (a matrix is singular)"
        raise NumericalError(f"{message}; leave some out of free, or check the tolerances") from error
    except (ValueError, ArithmeticError) as error:
        raise EstimatorError(f"calibration: {error}") from error


@_in_our_words()
def calibrate(
    robot: Robot,
    logs: Log | Sequence[Log],
    free: Iterable[str] | None = None,
    *,
    noise: Noise | None = None,
    torque: bool | None = None,
    bounds: Bounds | None = None,
    held_out: Sequence[Log] = (),
    start: Mapping[str, float] | None = None,
    progress: Progress | None = None,
    run: Map = here,
) -> Calibration:
    """Find a robot's parameters from its own recordings, without external measurements.

    The posterior probability of the free parameters is maximised, with a Gaussian prior around the values of robot.yaml
    whose widths are its ``tolerances``. The motors, as measured, drive the links of the model through their springs;
    what accelerometers and other sensors of the links should then read, and with ``torque`` what the motors should
    give, is compared with what was read (output error; L. Ljung, "System identification", 1999). Gradients are exact.
    Errors of more than four standard deviations count linearly (Huber 1964), so that outliers have a bounded influence.

    Parameters
    ----------
    robot
        The robot as robot.yaml has it.
    logs
        One recording or several of the same robot, with motion in them.
    free
        Kinds of parameters such as ``"stiffness"``, or names such as ``"stiffness_axis2"``; by default
        `parameters.DEFAULT`. Those that are not identifiable from the recordings stay as they are, see
        `Calibration.refused`.
    noise
        Noise levels of the Kalman filter that judges the outcome.
    torque
        Whether motor torques are measurements, by the motor's equation of motion: needed for motor inertia, friction
        and coupling, and to distinguish stiffness from mass. By default only for a robot without accelerometers.
    bounds
        Least and largest value by name of a parameter.
    held_out
        Recordings that are used only to test the result.
    start
        Where to start, by name, in tolerances, as in a `Step` of an interrupted run. By default robot.yaml, and springs
        far from it.
    progress
        Called with a `Step` whenever a better point is found.
    run
        Evaluates the recordings, see `linkside.fleet.mapped`. The result does not depend on it.

    Raises
    ------
    EstimatorError
        A name that is not a parameter, or not one of this robot; bounds that contradict each other or robot.yaml;
        nothing to calibrate.
    LogError
        A recording without motion, with a saturated accelerometer, or of another robot.
    NumericalError
        The links fly away at the values of robot.yaml.
    """
    began = time.perf_counter()
    logs = [logs] if isinstance(logs, Log) else list(logs)
    refuse(robot, logs)
    if held_out:
        refuse(robot, held_out)
    torque = use_torque(robot, logs, torque)
    free = None if free is None else tuple(free)
    chosen = choose(robot, free, torque, bounds or {})
    _refuse_without_part(chosen, free or (), logs)
    _refuse_unknown(chosen, start or {})
    # A torque that is held from sample to sample is early by half of one on average, and by one at most.
    earliest = -max(log.period for log in logs)
    chosen = [replace(p, low=earliest) if p.kind == "torque_delay" else p for p in chosen]
    if free is None and "q" not in kinds(robot, logs):
        chosen = [p for p in chosen if p.kind not in BY_LINK_ENCODERS]
    moves = np.any([moving(log) for log in logs], axis=0)
    still = [name for name, does in zip(robot.names, moves, strict=True) if not does]
    problem = ResponseProblem(robot, recordings(robot, logs, torque), chosen, run=run)
    solved = ResponseRun(problem, still, start or {}, progress)
    solved.solve()
    after, found = solved.after()
    foretold = solved.foretold() if len(solved.problem.free) else None
    gain = None
    if foretold is not None and robot.acceleration_channels and not any(drive.hysteresis for drive in robot.drives):
        gain = filters_gain(robot, logs, noise or Noise(), solved.problem.free, solved.z)
    return Calibration(
        estimates=_estimates(solved.problem.free, solved.z, found),
        refused=solved.refused,
        before=solved.before,
        after=after,
        held_out=solved.held_out(held_out) if held_out else None,
        contradictions=_contradictions(solved.problem, solved.z),
        notes=solved.notes,
        foretold=foretold,
        objections=objections(
            solved.problem.free, solved.z, found.std, solved.unit(solved.problem.free), foretold, gain
        ),
        evaluations=solved.evaluations,
        seconds=time.perf_counter() - began,
        problem=solved.problem,
        z=solved.z,
        uncertainty=found,
    )


def _refuse_without_part(chosen: Sequence[Parameter], asked: Sequence[str], logs: Sequence[Log]) -> None:
    """Refuse, by name, parameters on which neither the recordings nor the method can depend."""
    for p in (p for p in chosen if p.kind in asked or p.name in asked):
        if p.kind in OF_LINK_ENCODERS and not all(log.q is not None for log in logs):
            raise EstimatorError(
                f"free: '{p.name}' shows in link encoders only, and a log has none (columns q_<joint>)"
            )


def _refuse_unknown(free: Sequence[Parameter], start: Mapping[str, float]) -> None:
    known = [parameter.name for parameter in free]
    for name, z in start.items():
        if name not in known:
            raise EstimatorError(f"start: '{name}' is not a free parameter of this calibration; {suggest(name, known)}")
        if not np.isfinite(z):
            raise EstimatorError(f"start: '{name}' is {z}, expected a finite number")


def _estimates(free: Sequence[Parameter], z: FloatArray, found: Uncertainty) -> tuple[Estimated, ...]:
    rows = zip(free, z.tolist(), found.std.tolist(), found.widening.tolist(), strict=True)
    return tuple(Estimated(p, p.value(x), std * p.slope(x), wide, p.exceeds(x)) for p, x, std, wide in rows)


def _contradictions(problem: ResponseProblem, z: FloatArray) -> tuple[Contradiction, ...]:
    """Estimate from each recording alone, starting at the joint estimate."""
    if len(problem.logs) < 2:
        return ()
    fits = problem.run(partial(_alone, z), [problem.alone(i, z) for i in range(len(problem.logs))])
    return tuple(compare(problem, list(fits)))


def _alone(z: FloatArray, problem: Posterior) -> Alone:
    """Estimate from the only recording of a problem."""
    best = Search(problem).maximise(z)
    evidence = problem.evidence(best, detail=True)
    log = problem.logs[0]
    still = [name for name, does in zip(problem.robot.names, moving(log), strict=True) if not does]
    untold = unidentifiable(problem.free, best, evidence, still)
    return Alone(best, uncertainty(evidence, log.period), frozenset(untold.reasons))
