"""Recordings drawn from the Kalman filter's own model: what a filter that is right is to be consistent with."""

import numpy as np

from linkside import Estimate, Log, Robot

from .robots import ARM, spring

PERIOD = 1e-3
SENSORS = [{"name": "acc", "link": "hand", "xyz": [0.02, 0.05, 0.1], "noise_std": 0.05, "axes": "xz"}]


def arm():
    joints = [spring("shoulder"), spring("elbow")]
    return Robot.from_urdf(ARM, joints, accelerometers=SENSORS, tool={"link": "hand"})


def draw(robot, noise, rows, seed, offset=0.0):
    """A log and its truth under ``noise`` without damping; ``offset`` on the motors [rad] is not of the model."""
    rng = np.random.default_rng(seed)
    n, kinds = robot.n, ("motor", "acceleration")
    arrays = noise.arrays(robot, kinds)
    assert arrays["torsion"] == 0
    q, dq, ddq = links(rng, arrays, n, rows)
    wander = np.sqrt(PERIOD) * np.array(arrays["bias_walk"]) * rng.standard_normal((rows, len(arrays["reading"])))
    wander[0] = arrays["initial_bias"] * rng.standard_normal(wander.shape[1])
    stiffness = [drive.stiffness for drive in robot.drives]
    exact = np.hstack([q + robot.inverse_dynamics(q, dq, ddq) / stiffness, robot.specific_force(q, dq, ddq)])
    readings = exact + np.cumsum(wander, axis=0) + arrays["reading"] * rng.standard_normal(exact.shape)
    readings[:, :n] += offset
    t = PERIOD * np.arange(rows)
    columns = {"t": t} | {f"theta_{joint}": readings[:, i] for i, joint in enumerate(robot.names)}
    columns |= dict(zip(robot.acceleration_channels, readings[:, n:].T, strict=True))
    status = np.zeros(rows, np.uint8)
    truth = Estimate(t, q, dq, exact[:, :n], dq, status, robot.names, tool_position=robot.tool_position(q))
    return Log.from_table(columns, robot), truth


def links(rng, arrays, n, rows):
    """Links under random increments of acceleration, eq. (10) of Axelsson, Karlsson and Norrlöf (2012)."""
    out = np.empty((rows, 3, n))
    out[0] = np.reshape(arrays["initial"], (3, n)) * rng.standard_normal((3, n)) + [[0.3, 0.9], [0, 0], [0, 0]]
    jerk = np.sqrt(PERIOD) * np.array(arrays["jerk"]) * rng.standard_normal((rows, n))
    for row in range(1, rows):
        q, dq, ddq = out[row - 1]
        ddq = ddq + jerk[row]
        out[row] = q + PERIOD * dq + 0.5 * PERIOD**2 * ddq, dq + PERIOD * ddq, ddq
    return np.ascontiguousarray(out.transpose(1, 0, 2))
