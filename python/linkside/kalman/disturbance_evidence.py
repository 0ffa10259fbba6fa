"""Whether a recording shows disturbance torques of links: by its innovations without and with them."""

from __future__ import annotations

from typing import Any

import numpy as np

from linkside import _core
from linkside.arrays import FloatArray
from linkside.recording.estimate import Estimate
from linkside.recording.log import Log
from linkside.robot import Robot

from .link_disturbance import LinkDisturbance, given_law, stiffness

DECISIVE = 0.1
"""Gain of log-likelihood a reading that shows a disturbance torque."""

MOST_NIS = 2.0
"""Normalised innovation squared a reading above which a disturbance torque does not explain what contradicts."""

BROKEN = ("stuck", "saturated", "dead", "wrap")
"""Kinds of faults that no disturbance torque explains."""

STEP = 4.0
"""A torsion or torque that jumps by more than this many times its largest change nearby is a fault of its sensor."""

SPAN, AROUND = 4, 16
"""Readings on each side of a step, and of what is around."""

TURNED = 0.4
"""A torque sensor whose readings are those of the model to such a part, but for the sign, is turned."""

SCALED = 0.05
"""A link encoder's scale that is off by more is a fault: its readings ask for a disturbance torque like a spring's."""

LARGEST = 10.0
"""A disturbance torque is at most this many times its expected size."""


def is_seen(kinds: tuple[str, ...]) -> bool:
    """Whether channels of these ``kinds`` tell where a link is however it is pushed."""
    return bool({"q", "torque"} & set(kinds))


def is_suspicious(plain: Estimate) -> bool:
    """Whether readings contradict the model that an estimate was made with."""
    nis, used = _fit(plain)
    return float(nis.sum()) > _core.largest_nis(float(used.sum()))


def of_load(noise: Any, robot: Robot, log: Log, plain: Estimate) -> LinkDisturbance:
    """By ``noise``, and where that does not say it as large as what the links need, or joint torque sensors lack."""
    if noise.link_disturbance is not None:
        return given_law(noise, robot)
    load = _load(robot, plain)
    variance = _mean_square(load)
    if log.torque is not None:
        variance = variance + _mean_square(load - log.torque)
    return LinkDisturbance(np.sqrt(variance), noise.link_disturbance_time)


def of_estimate(law: LinkDisturbance, found: Estimate) -> LinkDisturbance:
    """As large as an estimate by ``law`` says that disturbances are; as before where no sensor sees them."""
    assert found.disturbance is not None
    assert found.disturbance_std is not None
    open_still = np.minimum(_mean_square(found.disturbance_std), law.std**2)
    std = np.sqrt(_mean_square(found.disturbance) + open_still)
    return LinkDisturbance(np.minimum(std, LARGEST * law.std), law.time)


def explains(found: Any, plain: Any) -> bool:
    """Whether disturbance torques explain what contradicts the model without: a generalised likelihood ratio."""
    nis, used = _fit(found)
    count = float(used.sum())
    gain = float(found.log_likelihood.sum() - plain.log_likelihood.sum())
    return gain > DECISIVE * count and float(nis.sum()) < MOST_NIS * count


def looks_broken(robot: Robot, log: Log, kinds: tuple[str, ...], plain: Estimate, found: Estimate) -> bool:
    """Whether a sensor is at fault rather than a link pushed; a torque would explain both.

    By its own looks; by a torsion or torque that changes from one reading to the next, as nothing behind a spring does;
    by a joint torque sensor that reads the model's torque with the wrong sign; by a link encoder that is off in
    proportion to where it is.
    """
    channels = {name for kind in ("q", "torque") if kind in kinds for name in log.columns(kind)}
    if any(one.kind in BROKEN and one.channel in channels for one in plain.findings):
        return True
    spring, load = stiffness(robot), _load(robot, found)
    doubt = np.median(found.q_std, axis=0)  # type: ignore[arg-type] # a filter has it
    if "torque" in kinds and log.torque is not None:
        turned = _mean_square(log.torque + load) < TURNED**2 * _mean_square(load)
        if turned.any() or (_step(log.torque / spring) > doubt).any():
            return True
    if "q" in kinds and log.q is not None:
        assert found.disturbance is not None
        stepped = _step(log.q - log.theta) > doubt
        return bool(stepped.any() or (_scale(log.q, found.disturbance / spring) > SCALED).any())
    return False


def _fit(estimate: Any) -> tuple[FloatArray, FloatArray]:
    return estimate.nis, estimate.used


def _load(robot: Robot, estimate: Estimate) -> FloatArray:
    """Torques that links need to move as in an estimate (T, n)."""
    assert estimate.ddq is not None  # a filter has it
    load = robot.inverse_dynamics(estimate.q, estimate.dq, estimate.ddq)
    return load + robot.link_friction(estimate.dq, load)


def _mean_square(torque: FloatArray) -> FloatArray:
    there = np.isfinite(torque)
    return np.asarray((np.where(there, torque, 0.0) ** 2).sum(axis=0) / np.maximum(there.sum(axis=0), 1))


def _step(readings: FloatArray) -> FloatArray:
    """The largest change of readings (T, n) from one to the next that stands alone, zero where none does."""
    return np.array([_largest_step(column[np.isfinite(column)]) for column in readings.T])


def _largest_step(readings: FloatArray) -> float:
    if len(readings) < 4 * AROUND:
        return 0.0
    means = np.convolve(readings, np.full(SPAN, 1 / SPAN), "valid")
    change = np.abs(means[SPAN:] - means[:-SPAN])
    # A step shows in the windows across it; a vibration or a push goes on before or after.
    most = np.lib.stride_tricks.sliding_window_view(change, AROUND - SPAN).max(axis=1)
    before, after = most[: -AROUND - SPAN], most[AROUND + SPAN :]
    alone = change[AROUND : AROUND + len(before)]
    return float(np.where(alone > STEP * np.maximum(before, after), alone, 0.0).max())


def _scale(q: FloatArray, off: FloatArray) -> FloatArray:
    """By what part of itself each position (T, n) is off, where that is all that is ``off`` about it."""
    there = np.isfinite(q)
    position = np.where(there, q, 0.0)
    power = np.maximum((position**2).sum(axis=0), 1e-300)
    slope = (position * off).sum(axis=0) / power
    rest = (np.where(there, off - slope * position, 0.0) ** 2).sum(axis=0)
    return np.asarray(np.where(rest < 0.02 * slope**2 * power, np.abs(slope), 0.0))
