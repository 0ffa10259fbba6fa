"""Draws transmissions.svg (torque over motor angle of each law, link held), and the other pictures of its page."""

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from drawing import save, style

from linkside import Robot, Sensor, simulate
from linkside.figures import COLOURS, finish

HERE = Path(__file__).parent
HELD = """<robot name="held"><link name="base"/><link name="arm"><inertial><mass value="1"/>
  <inertia ixx="1e9" ixy="0" ixz="0" iyy="1e9" iyz="0" izz="1e9"/></inertial></link>
  <joint name="axis" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/></joint></robot>"""
LAWS: dict[str, dict[str, Any]] = {
    "stiffness, cubic_stiffness": {"stiffness": 5e3, "cubic_stiffness": 2e9},
    "stiffness_table": {"stiffness_table": {"torque": [5, 15], "stiffness": [4e3, 8e3, 1.6e4]}},
    "backlash": {"stiffness": 1e4, "backlash": {"half_gap": 8e-4}},
    "hysteresis, dahl": {"stiffness": 5e3, "hysteresis": [{"stiffness": 1e4, "limit": 3.0}]},
    "hysteresis, slip": {
        "stiffness": 5e3,
        "hysteresis": [{"stiffness": k, "limit": w, "law": "slip"} for k, w in ((1e4, 1.5), (3e3, 2.5))],
    },
    "ripple": {"stiffness": 5e3, "ripple": [{"order": 2000, "amplitude": 5e-5, "of": "output"}]},
}
FRICTION: dict[str, tuple[float, dict[str, Any]]] = {
    "coulomb, asymmetry, viscous": (0.0, {"motor_friction": {"coulomb": 8, "asymmetry": 3, "viscous": 20}}),
    "stribeck": (0.0, {"motor_friction": {"coulomb": 8, "stribeck": 5, "stribeck_velocity": 0.05}}),
    "efficiency, under +40 N m": (40.0, {"efficiency": {"driving": 0.8, "back_driving": 0.7}}),
}
ENDS = [{"link": "base", "xyz": [0.5, 0, 0]}, {"link": "arm", "xyz": [0.2, 0, 0]}]
GAS = {"pressure": 5e6, "volume": 2e-4, "length": 0.3, "area": 2e-4, "exponent": 1.2}
COUNTERBALANCES: dict[str, dict[str, Any]] = {
    "spring": {"ends": ENDS, "spring": {"stiffness": 3e3, "length": 0.2}},
    "gas": {"ends": ENDS, "gas": {**GAS, "acts": "pull"}},
    "series": {"joints": ["axis"], "series": [{"order": 1, "sine": -200}, {"order": 3, "sine": 40}]},
}
ENCODERS: dict[str, dict[str, Any]] = {
    "zero, scale": {"zero": 1e-3, "scale": 1.0005},
    "beside the centre: order 1": {"harmonics": [{"order": 1, "amplitude": 1e-3, "phase": 0.5, "of": "output"}]},
    "lines: orders n and n/2": {
        "harmonics": [
            {"order": 60, "amplitude": 2e-4, "phase": 0.0, "of": "output"},
            {"order": 30, "amplitude": 1e-4, "phase": 1.0, "of": "output"},
        ]
    },
}
TIME, AMPLITUDE, RATE = 3.0, 2e-3, 1000.0


def measured(drive: dict[str, Any]) -> tuple[Any, Any]:
    """Motor angle [mrad] and torque on the link [N m] while the motor goes to and fro, each time less far."""
    joint = {"name": "axis", "motor_inertia": 1.5, "damping": 1.0, **drive}
    robot = Robot.from_urdf(HELD, [joint], gravity=[0, 0, 0])

    def servo(t: float, state: Any) -> Any:
        goal = AMPLITUDE * (1 - 0.2 * t) * np.sin(2 * np.pi * t)
        return 1e5 * (goal - state.theta) - 600.0 * state.dtheta

    sensors = {"torque": Sensor()}
    run = simulate(robot, servo, TIME, RATE, q=[0], theta=[0], sensors=sensors, substeps=4)
    assert run.log.torque is not None
    return 1e3 * run.truth["theta"][:, 0], run.log.torque[:, 0]


def friction(load: float, drive: dict[str, Any]) -> tuple[Any, Any]:
    """Speed [rad/s] and the torque that friction takes of a motor [N m]."""
    joint = {"name": "axis", "motor_inertia": 1.5, "stiffness": 1e4, **drive}
    speed = np.linspace(-0.3, 0.3, 2001)[:, None]
    return speed[:, 0], Robot.from_urdf(HELD, [joint]).motor_friction(speed, np.full_like(speed, load))[:, 0]


def lift(counterbalance: dict[str, Any]) -> tuple[Any, Any]:
    """Joint angle [rad] and the torque that a counterbalance gives the link [N m]."""
    joint = {"name": "axis", "motor_inertia": 1.5, "stiffness": 1e4}
    robot = Robot.from_urdf(HELD, [joint], counterbalances=[counterbalance], gravity=[0, 0, 0])
    angle = np.linspace(-np.pi, np.pi, 401)[:, None]
    return angle[:, 0], -robot.gravity_torque(angle)[:, 0]


def misread(error: dict[str, Any]) -> tuple[Any, Any]:
    """Angle [rad] and how far a reading is from it [mrad]."""
    joint = {"name": "axis", "motor_inertia": 1.5, "stiffness": 1e4, "encoder_error": error}
    angle = np.linspace(-np.pi, np.pi, 1801)
    encoder = Robot.from_urdf(HELD, [joint]).encoder_readings["theta"][0]
    return angle, 1e3 * (encoder.of(angle) - angle)


def row(curves: dict[str, tuple[Any, Any]], abscissa: str, ordinate: str, file: str) -> None:
    """Draw curves side by side."""
    figure, panels = plt.subplots(1, len(curves), figsize=(9, 2.7), layout="constrained")
    for axes, (name, curve) in zip(panels, curves.items(), strict=True):
        axes.plot(*curve, color=COLOURS[0], linewidth=1)
        axes.set_title(name, fontsize=10)
        axes.set_xlabel(abscissa)
        finish(axes, legend=False)
    panels[0].set_ylabel(ordinate)
    save(figure, HERE / file)


@style()
def draw_all() -> None:
    """Draw them side by side."""
    frictions = {name: friction(*law) for name, law in FRICTION.items()}
    row(frictions, "motor speed [rad/s]", "friction [N m]", "friction.svg")
    row(
        {name: lift(law) for name, law in COUNTERBALANCES.items()},
        "joint angle [rad]",
        "torque [N m]",
        "counterbalances.svg",
    )
    encoders = {name: misread(error) for name, error in ENCODERS.items()}
    row(encoders, "angle [rad]", "reading less angle [mrad]", "encoders.svg")
    figure, panels = plt.subplots(2, 3, figsize=(9, 5), layout="constrained", sharex=True)
    for axes, (name, drive) in zip(panels.flat, LAWS.items(), strict=True):
        axes.plot(*measured(drive), color=COLOURS[0], linewidth=1)
        axes.set_title(name, fontsize=10)
        finish(axes, legend=False)
    for axes in panels[-1]:
        axes.set_xlabel("motor angle, link held [mrad]")
    for axes in panels[:, 0]:
        axes.set_ylabel("torque [N m]")
    save(figure, HERE / "transmissions.svg")
