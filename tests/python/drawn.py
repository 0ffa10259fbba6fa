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
    decay, variance = bias_step(arrays, PERIOD)
    bias = np.sqrt(variance) * rng.standard_normal((rows, len(arrays["reading"])))
    bias[0] = arrays["initial_bias"] * rng.standard_normal(bias.shape[1])
    for row in range(1, rows):
        bias[row] += decay * bias[row - 1]
    stiffness = [drive.stiffness for drive in robot.drives]
    exact = np.hstack([q + robot.inverse_dynamics(q, dq, ddq) / stiffness, robot.specific_force(q, dq, ddq)])
    readings = exact + bias + arrays["reading"] * rng.standard_normal(exact.shape)
    readings[:, :n] += offset
    t = PERIOD * np.arange(rows)
    columns = {"t": t} | {f"theta_{joint}": readings[:, i] for i, joint in enumerate(robot.names)}
    columns |= dict(zip(robot.acceleration_channels, readings[:, n:].T, strict=True))
    status = np.zeros(rows, np.uint8)
    truth = Estimate(t, q, dq, exact[:, :n], dq, status, robot.names, tool_position=robot.tool_position(q))
    return Log.from_table(columns, robot), truth


def jerk_noise(h):
    """Covariance of position, velocity and acceleration after ``h`` of white jerk of density one."""
    return np.array([[h**5 / 20, h**4 / 8, h**3 / 6], [h**4 / 8, h**3 / 3, h**2 / 2], [h**3 / 6, h**2 / 2, h]])


def bias_step(arrays, h):
    """Decay of each channel's bias over ``h``, and the variance that it gains: Gauss and Markov's process."""
    walk, time = np.array(arrays["bias_walk"]), np.array(arrays["bias_time"])
    gained = np.full(walk.shape, h)
    bounded = np.isfinite(time)
    gained[bounded] = -0.5 * time[bounded] * np.expm1(-2 * h / time[bounded])
    return np.exp(-h / time), walk**2 * gained


def links(rng, arrays, n, rows):
    """Links under white jerk, eqs. (9)–(11) of Axelsson, Karlsson and Norrlöf (2012), noise all the time."""
    out = np.empty((rows, 3, n))
    out[0] = np.reshape(arrays["initial"], (3, n)) * rng.standard_normal((3, n)) + [[0.3, 0.9], [0, 0], [0, 0]]
    gained = rng.standard_normal((rows, n, 3)) @ np.linalg.cholesky(jerk_noise(PERIOD)).T
    gained *= np.array(arrays["jerk"])[:, None]
    for row in range(1, rows):
        q, dq, ddq = out[row - 1]
        out[row] = q + PERIOD * dq + 0.5 * PERIOD**2 * ddq, dq + PERIOD * ddq, ddq
        out[row] += gained[row].T
    return np.ascontiguousarray(out.transpose(1, 0, 2))
