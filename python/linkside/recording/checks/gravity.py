"""Checks of accelerometers and torques against what the robot must read and needs, gravity above all."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import permutations, product

import numpy as np

from linkside.arrays import FloatArray

from .finding import Finding, Verdict
from .view import View

STANDARD_GRAVITY = 9.80665

DIFFERENT = 2.5
"""Root mean square by which an accelerometer may differ from what it must read [m/s²]: a quarter of gravity."""

EXPLAINED = 0.1
"""A cause is certain when it leaves less than this share of the squared difference."""

ENOUGH = 5
"""Blocks to judge by."""

STILL = 0.5
"""Acceleration of a block in which gravity is nearly all that a sensor reads [m/s²]."""


def expected(view: View, factor: FloatArray) -> tuple[FloatArray, bool] | None:
    """What accelerometers read over a view's blocks if joints were rigid, positions times a factor, (k, m).

    NaN in blocks with motion where enough are without; the flag says whether that is so.
    """
    blocks = view.blocks
    if blocks is None or blocks.acceleration is None or not len(blocks.row):
        return None
    q, dq, ddq = (np.ascontiguousarray(a * factor) for a in (blocks.theta, blocks.dtheta, blocks.ddtheta))
    full: FloatArray = view.robot.specific_force(q, dq, ddq)
    rest: FloatArray = view.robot.specific_force(q, 0 * dq, 0 * ddq)
    still = np.all(np.abs(full - rest) < STILL, axis=1)
    calm = bool(still.sum() >= ENOUGH)
    return (np.where(still[:, None], full, np.nan) if calm else full), calm


def misfit(view: View, factor: FloatArray) -> float | None:
    """Root mean square difference of accelerometers from what they must read [m/s²]; None where nothing tells."""
    model = expected(view, factor)
    if model is None or view.blocks is None or view.blocks.acceleration is None:
        return None
    difference = view.blocks.acceleration - model[0]
    return float(np.sqrt(np.nanmean(difference**2))) if np.isfinite(difference).any() else None


def accelerometers(view: View) -> Iterator[Finding]:
    """Find accelerometers in g, with a sign turned, with axes exchanged, or turned otherwise."""
    found = expected(view, np.ones(view.robot.n))
    if found is None:
        return
    (model, calm), blocks, first = found, view.blocks, 0
    assert blocks is not None
    assert blocks.acceleration is not None
    for sensor in view.robot.accelerometers:
        axes = slice(first, first + len(sensor.axes))
        first = axes.stop
        read, should = blocks.acceleration[:, axes], model[:, axes]
        there = np.isfinite(read - should).all(axis=1)
        alive = there.sum() >= ENOUGH and (np.ptp(read[there], axis=0) > 0).any()
        if alive and np.sqrt(np.mean((read - should)[there] ** 2) * len(sensor.axes)) > DIFFERENT:
            columns = view.log.columns("acceleration")[axes]
            row = int(blocks.row[np.argmax(there)])
            yield from _accelerometer(view, columns, read[there], should[there], row, calm)


def _accelerometer(
    view: View, columns: tuple[str, ...], read: FloatArray, should: FloatArray, row: int, calm: bool
) -> Iterator[Finding]:
    apart = np.sum((read - should) ** 2, axis=0)
    size = float(np.sqrt(apart.sum() / len(read)))
    here = f"{_row(read)} m/s² where {_row(should)} is expected,"
    axis = columns[int(np.argmax(apart))]
    if (cause := _cause(columns, read, should)) is not None:
        kind, what, remedy = cause
        verdict: Verdict = "suspicious" if kind == "axes" else "refused"
        yield view.finding(kind, verdict, axis, f"{what}: {here}", remedy, at=row, size=size)
    elif calm and np.linalg.norm(np.mean(read - should, axis=0)) > DIFFERENT:
        names = ", ".join(columns)
        what = f"does not read what gravity and its place give: {names} read {here}"
        remedy = "check the sensor's rpy and link, its bias and scale, the units, and `gravity`"
        yield view.finding("gravity", "suspicious", axis, what, remedy, at=row, size=size)


def _row(values: FloatArray) -> str:
    return ", ".join(f"{x:.2f}" for x in values.mean(axis=0))


def _cause(columns: tuple[str, ...], read: FloatArray, should: FloatArray) -> tuple[str, str, str] | None:
    """Find the cause that explains the readings, usual causes before rare ones; None if there is none."""
    apart = float(np.sum((read - should) ** 2))
    causes = list(_causes(columns))
    left = np.array([np.sum((read @ factor - should) ** 2) for *_, factor in causes]) + 0.01 * apart
    usual = next(index for index, value in enumerate(left) if value <= 1.5 * left.min())
    return causes[usual][:3] if left[usual] < EXPLAINED * apart else None


def _causes(columns: tuple[str, ...]) -> Iterator[tuple[str, str, str, FloatArray]]:
    """What may be wrong, the most usual first, with the matrix that puts a row of readings right."""
    count, names = len(columns), ", ".join(columns)
    one = np.eye(count)
    yield "g", f"is in g, not in m/s² ({names})", "multiply by 9.80665", STANDARD_GRAVITY * one
    yield "sign", f"has its sign turned ({names})", "a sensor at rest reads +9.81 upwards: turn the sign", -one
    for axis in range(count if count > 1 else 0):
        flipped = one.copy()
        flipped[axis, axis] = -1
        yield "sign", f"has its sign turned ({columns[axis]} alone)", "turn its sign, or correct rpy", flipped
    for order in permutations(range(count)):
        for signs in product((1.0, -1.0), repeat=count):
            turned = np.zeros((count, count))
            turned[list(order), range(count)] = signs
            if list(order) != list(range(count)) or sum(s < 0 for s in signs) > 1:
                said = ", ".join(f"{'-' if s < 0 else ''}{columns[i]}" for i, s in zip(order, signs, strict=True))
                yield "axes", f"has its axes exchanged ({names} fit as {said})", "correct rpy or the columns", turned


def torques(view: View) -> Iterator[Finding]:
    """Find motor torques with the sign turned, or of the motor's shaft: against what motion and gravity need."""
    blocks, robot = view.blocks, view.robot
    if blocks is None or blocks.tau is None or len(blocks.row) < 10:
        return
    motors = np.array([drive.motor_inertia or 0.0 for drive in robot.drives])
    load = robot.inverse_dynamics(blocks.theta, blocks.dtheta, blocks.ddtheta)
    need = load + motors * blocks.ddtheta + robot.motor_friction(blocks.dtheta, load)
    noise = robot.config.torque.noise_std
    for joint in np.flatnonzero(robot.elastic):
        there = np.isfinite(blocks.tau[:, joint])
        read, should = blocks.tau[there, joint], need[there, joint]
        apart = float(np.sum((read - should) ** 2))
        floor = max(5 * noise, 3 * robot.drives[joint].motor_friction.coulomb)
        if there.sum() < 10 or np.sqrt(np.mean(should**2)) < floor:
            continue
        for kind, what, remedy, factor in _torque_causes(float(robot.gear_ratio[joint])):
            if np.sum((factor * read - should) ** 2) < EXPLAINED * apart:
                row, column = int(blocks.row[np.argmax(there)]), view.log.columns("tau")[joint]
                size = float(np.sqrt(apart / len(read)))
                yield view.finding(kind, "suspicious", column, what, remedy, at=row, size=size)
                break


def _torque_causes(ratio: float) -> Iterator[tuple[str, str, str, float]]:
    yield "torque sign", "has its sign turned: motion and gravity need the opposite", "turn its sign", -1.0
    if abs(ratio) > 3:
        remedy = "multiply by the gear ratio, or write `columns: {motor_side: true}`"
        yield "torque side", "is the motor shaft's: smaller than needed by the gear ratio", remedy, ratio
