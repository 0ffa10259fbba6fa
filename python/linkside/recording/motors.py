"""What a recording has of motors, and what is meant: encoders that read wrong, gears that several motors share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from linkside.arrays import FloatArray
from linkside.robot.encoders import EncoderReading

RATES = {"theta": "dtheta"}
"""Velocities that come of the same encoder as a position."""

Encoders = Mapping[str, Mapping[int, EncoderReading]]
"""By signal and joint: how encoders read that read wrong."""


def encoder_angles(arrays: Mapping[str, Any], encoders: Encoders) -> dict[str, FloatArray]:
    """Angles, and their velocities, of signals whose encoders read wrong."""
    return _through(arrays, encoders, lambda encoder, x: (encoder.angle(x), 1 / encoder.rate(encoder.angle(x))))


def encoder_readings(arrays: Mapping[str, Any], encoders: Encoders) -> dict[str, FloatArray]:
    """What such encoders read: the inverse."""
    return _through(arrays, encoders, lambda encoder, x: (encoder.of(x), encoder.rate(x)))


def _through(
    arrays: Mapping[str, Any],
    encoders: Encoders,
    law: Callable[[EncoderReading, FloatArray], tuple[FloatArray, FloatArray]],
) -> dict[str, FloatArray]:
    changed: dict[str, FloatArray] = {}
    for signal, of_joints in encoders.items():
        rate = RATES.get(signal, "")
        names = [name for name in (signal, rate) if arrays.get(name) is not None]
        if signal not in names:
            continue
        changed |= {name: np.array(arrays[name], dtype=float) for name in names}
        for joint, encoder in of_joints.items():
            changed[signal][:, joint], slope = law(encoder, np.asarray(arrays[signal])[:, joint])
            if rate in names:
                changed[rate][:, joint] *= slope
    return changed


def of_joints(arrays: Mapping[str, Any], gearing: FloatArray) -> dict[str, FloatArray]:
    """Positions, velocities and torques behind a gearing Γ, of those of its motors: Γ θ and Γ⁻ᵀ τ, rows of (T, n)."""
    return _mixed(arrays, gearing, _inverse(gearing).T)


def of_motors(arrays: Mapping[str, Any], gearing: FloatArray) -> dict[str, FloatArray]:
    """The inverse."""
    return _mixed(arrays, _inverse(gearing), gearing.T)


def _inverse(gearing: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.inv(gearing), dtype=np.float64)


def _mixed(arrays: Mapping[str, Any], motion: FloatArray, torque: FloatArray) -> dict[str, FloatArray]:
    """Each signal times a matrix; a missing reading leaves alone what does not depend on it."""
    ways = {"theta": motion, "dtheta": motion, "tau": torque}
    changed: dict[str, FloatArray] = {}
    for signal, way in ways.items():
        if (values := arrays.get(signal)) is None:
            continue
        changed[signal] = np.array(values, dtype=float)
        for joint, row in enumerate(way):
            used = np.flatnonzero(np.abs(row) > 1e-14 * np.abs(row).max())
            if list(used) != [joint] or row[joint] != 1:
                changed[signal][:, joint] = np.asarray(values)[:, used] @ row[used]
    return changed
