"""Draws docs/transmissions.png: torque over motor angle of each law, the link being held fast."""

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from linkside import Robot, Sensor, simulate

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


def main() -> None:
    """Draw them side by side."""
    figure, panels = plt.subplots(2, 3, figsize=(9, 5), layout="constrained", sharex=True)
    for axes, (name, drive) in zip(panels.flat, LAWS.items(), strict=True):
        axes.plot(*measured(drive), linewidth=1)
        axes.set_title(name, fontsize=10)
        axes.grid(alpha=0.3)
    for axes in panels[-1]:
        axes.set_xlabel("motor angle, link held [mrad]")
    for axes in panels[:, 0]:
        axes.set_ylabel("torque [N m]")
    figure.savefig(HERE / "transmissions.png", dpi=110)


if __name__ == "__main__":
    main()
