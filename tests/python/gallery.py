"""Robots on which every figure must hold: one, two, six and seven joints, long names, a slide, many channels."""

from functools import cache

import numpy as np

from linkside import Estimate, Log, Robot, demo

from .robots import ARM, DATA, EXAMPLES, spring

ROWS, PERIOD = 400, 1e-3


def from_file(path, joints, sensors, tool):
    """Robot of a public URDF, springs falling towards the tool."""
    drives = [spring(name, stiffness=4e4 / (1 + i), motor_inertia=2.0 / (1 + i)) for i, name in enumerate(joints)]
    mounted = [{"name": f"acc_{link}", "link": link, "xyz": [0.05, 0.04, 0.1], "noise_std": 0.05} for link in sensors]
    return Robot.from_urdf((EXAMPLES / path).read_text(), drives, accelerometers=mounted, tool={"link": tool})


def arm(urdf=ARM, names=("shoulder", "elbow"), **settings):
    sensor = {"name": "acc", "link": "hand", "xyz": [0.02, 0.05, 0.1], "noise_std": 0.05}
    settings = {"accelerometers": [sensor], "tool": {"link": "hand"}} | settings
    return Robot.from_urdf(urdf, [spring(name) for name in names], **settings)


UR10 = [f"{name}_joint" for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")]
PANDA = [f"panda_joint{i}" for i in range(1, 8)]
BUILT = {
    "one joint": lambda: arm(names=("elbow",)),
    "two joints": lambda: Robot.load(DATA / "arm2_square/robot.yaml"),
    "a slide": lambda: arm(ARM.replace('"elbow" type="revolute"', '"elbow" type="prismatic"')),
    "six joints, three of them elastic": lambda: Robot.load(demo.ROBOT),
    "long names, twelve channels": lambda: from_file(
        "ur_description/urdf/ur10_robot.urdf",
        UR10,
        ["forearm_link", "wrist_1_link", "wrist_2_link", "wrist_3_link"],
        "tool0",
    ),
    "seven joints, fifteen channels": lambda: from_file(
        "panda_description/urdf/panda.urdf",
        PANDA,
        ["panda_link3", "panda_link4", "panda_link5", "panda_link6", "panda_link7"],
        "panda_link8",
    ),
}


@cache
def robot(name):
    return BUILT[name]()


@cache
def recorded(name):
    """A recording on the jerk-driven model, with its truth: each joint swings about a posture that is not singular."""
    machine, rng = robot(name), np.random.default_rng(1)
    t = PERIOD * np.arange(ROWS)
    centre = 0.5 + 0.3 * np.arange(machine.n) * (-1.0) ** np.arange(machine.n)
    w = 2 * np.pi * (1.0 + 0.3 * np.arange(machine.n))
    swing = 0.2 / (1 + np.arange(machine.n))
    phase = t[:, None] * w
    q, dq, ddq = centre + swing * (1 - np.cos(phase)), swing * w * np.sin(phase), swing * w * w * np.cos(phase)
    stiffness = np.array([d.stiffness if d.elastic else np.inf for d in machine.drives], float)
    theta = q + machine.inverse_dynamics(q, dq, ddq) / stiffness + 1e-6 * rng.standard_normal(q.shape)
    force = machine.specific_force(q, dq, ddq) + 0.05 * rng.standard_normal((ROWS, len(machine.acceleration_channels)))
    table = {"t": t} | {f"theta_{joint}": theta[:, i] for i, joint in enumerate(machine.names)}
    table |= {f"tau_{joint}": np.zeros(ROWS) for joint in machine.names}
    table |= dict(zip(machine.acceleration_channels, force.T, strict=True))
    tool = machine.tool_position(q)
    truth = Estimate(t, q, dq, theta, dq, np.zeros(ROWS, np.uint8), machine.names, tool_position=tool)
    return Log.from_table(table, machine, check=False), truth
