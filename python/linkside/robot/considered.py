"""Parameters that are known to a tolerance only: they widen standard deviations and are not estimated."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from . import correlations
from .correlations import AXES, OF_SENSORS
from .joints import JointConfig
from .robot import Robot

CoreTolerance = tuple[str, int, int, float]
"""A parameter as the core has it: kind, joint or sensor, axis, standard deviation."""


@dataclass(frozen=True)
class Uncertain:
    """A parameter that is not known exactly.

    Attributes
    ----------
    name : str
        Such as ``stiffness_a1``.
    kind, index, axis
        What it is of.
    std : float
        Its standard deviation: a share of the value, or in the unit of robot.yaml's ``tolerances``.
    """

    name: str
    kind: str
    index: int
    axis: int
    std: float

    @property
    def as_tuple(self) -> CoreTolerance:
        """For the core."""
        return self.kind, self.index, self.axis, self.std


def considered(robot: Robot, *, motors: bool = False) -> list[Uncertain]:
    """Give the parameters whose tolerances count, in the order of the core; ``motors``: those of the motors as well.

    Those that ``tolerances.calibrated`` names have the standard errors that a calibration found.
    Stiffness, and damping and hardening where they are declared, of elastic joints; how much a joint that is taken as
    rigid gives way; lost motion of transmissions; masses of links; friction of links; the past of friction elements;
    mounting of accelerometers.
    """
    found = [
        *_of_joints(robot),
        *_of_pasts(robot),
        *_of_sensors(robot),
        *(_of_motors(robot) if motors else ()),
    ]
    known = robot.config.tolerances.calibrated
    return [replace(one, std=known.get(one.name, one.std)) for one in found]


def with_expected_damping(robot: Robot) -> Robot:
    """Give springs that state no damping what is expected of a vibration that nothing on the links measures.

    With σ the tolerance of ln K, the mean over all such springs of a vibration of frequency ω is exp(−σ²ω²t²/8) cos ωt.
    It has fallen to 1/e when one with a damping ratio of σ/√8 has, at which standard deviations let it die as well.
    The damping is that ratio's at the zero posture, and is itself known to `tolerances.damping`.
    """
    undamped = [j for j, drive in enumerate(robot.drives) if drive.elastic and not drive.damping]
    if not undamped or robot.accelerometers or robot.gyroscopes or robot.trackers:
        return robot
    stds = {one.name: one.std for one in considered(robot)}
    inertias = np.diag(robot.mass_matrix(np.zeros(robot.n)))
    joints = list(robot.drives)
    for j in undamped:
        stiffness, std = joints[j].stiffness or 0.0, stds[f"stiffness_{joints[j].name}"]
        damping = std / 2**0.5 * np.sqrt(stiffness * inertias[j])
        joints[j] = joints[j].model_copy(update={"damping": float(damping)})
    return Robot(robot.config.model_copy(update={"joints": tuple(joints)}), robot.tree, robot.notes)


def core_settings(robot: Robot, uncertain: Sequence[Uncertain]) -> dict[str, Any]:
    """Give the settings of a filter of the core that say what of ``robot`` is uncertain."""
    return {
        "tolerances": [one.as_tuple for one in uncertain],
        "correlations": correlations.pairs(robot.config.tolerances.correlations, [one.name for one in uncertain]),
    }


def _of_joints(robot: Robot) -> Iterator[Uncertain]:
    wide = robot.config.tolerances
    for j, drive in enumerate(robot.drives):
        stds = {"mass": wide.mass_scale}
        if drive.elastic:
            stds["stiffness"] = wide.stiffness
            stds["damping"] = wide.damping if drive.damping else 0.0
            stds["cubic_stiffness"] = 0.5 * drive.cubic_stiffness
        else:
            stds["yielding"] = (2 * np.pi * wide.rigid_frequency) ** -2
        stds["link_friction"] = wide.link_friction if brakes(drive) else 0.0
        if not drive.passive:
            stds["encoder_zero"] = wide.encoder_zero
            stds["lost_motion"] = wide.lost_motion
            yield from _of_lines(j, drive)
        for kind, std in stds.items():
            if std:
                name = "mass_scale" if kind == "mass" else kind
                yield Uncertain(f"{name}_{drive.name}", kind, j, 0, float(std))


def _of_lines(j: int, drive: JointConfig) -> Iterator[Uncertain]:
    """Sine and cosine of each part of an encoder's reading whose phase no run tells."""
    for line, (amplitude, _) in enumerate(drive.encoder_error.unknown(drive.gear_ratio)):
        for part, name in enumerate(("sine", "cosine")):
            yield Uncertain(
                f"encoder_{name}_{drive.name}_{line}", "encoder_line", j, 2 * line + part, amplitude / 2**0.5
            )


def brakes(drive: JointConfig) -> bool:
    """Whether a link has friction."""
    bearing = drive.bearing_friction
    return any((*drive.link_friction, bearing.viscous, bearing.coulomb, bearing.stribeck, bearing.load))


def _of_pasts(robot: Robot) -> Iterator[Uncertain]:
    """Give where friction elements were at the start: anywhere between their limits."""
    for j, drive in enumerate(robot.drives):
        if drive.hysteresis:
            yield Uncertain(f"hysteresis_{drive.name}", "hysteresis", j, 0, 3**-0.5)


def _of_sensors(robot: Robot) -> Iterator[Uncertain]:
    wide = robot.config.tolerances
    for s, sensor in enumerate(robot.accelerometers):
        for kind in OF_SENSORS:
            for axis in range(3):
                if kind != "scale" or AXES[axis] in sensor.axes:
                    yield Uncertain(f"{kind}_{sensor.name}_{AXES[axis]}", kind, s, axis, getattr(wide, kind))


def _of_motors(robot: Robot) -> Iterator[Uncertain]:
    wide = robot.config.tolerances
    driven = ((j, drive) for j, drive in enumerate(robot.drives) if not drive.passive)
    for j, drive in driven:
        yield Uncertain(f"torque_constant_{drive.name}", "torque_constant", j, 0, wide.torque_constant)
        if drive.motor_friction.viscous or drive.motor_friction.coulomb or any(drive.gear_loss):
            yield Uncertain(f"motor_friction_{drive.name}", "motor_friction", j, 0, wide.motor_friction)
        if drive.elastic:
            yield Uncertain(f"motor_inertia_{drive.name}", "motor_inertia", j, 0, wide.motor_inertia)
