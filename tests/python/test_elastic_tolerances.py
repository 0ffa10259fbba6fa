"""Tolerances that count in the filter and smoother on the elastic-joint model, against plants that truly differ."""

import numpy as np
import pytest
import scipy.linalg

from linkside import ElasticJointFilter, ElasticJointSmoother, ElasticNoise, Log, Robot

from .test_elastic_filter import DRIVE, GRAVITY, SLIDE, B, D, F, K, M

NOISE = ElasticNoise(link_acceleration=0.05, motor_acceleration=0.05, transmission=1e-5, motor_velocity=2e-3)
TOLERANCES = {
    "stiffness": 0.03,
    "damping": 0.1,
    "mass_scale": 0.02,
    "motor_inertia": 0.03,
    "torque_constant": 0.01,
    "motor_friction": 0.1,
}
STEP, ROWS, SETTLED = 1e-3, 900, 400


def slide() -> Robot:
    """A cart on a vertical slide behind a spring, without a sensor on it: nothing teaches the parameters."""
    return Robot.from_urdf(SLIDE, joints=[DRIVE], encoder={"resolution": 1e-6}, tolerances=TOLERANCES)


def drawn(rng: np.random.Generator) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Signals of a cart whose numbers are drawn from their tolerances, and where it was: torques change linearly."""
    k, d, m, b, gain, f = (
        nominal * np.exp(TOLERANCES[name] * rng.standard_normal())
        for name, nominal in zip(TOLERANCES, (K, D, M, B, 1.0, F), strict=True)
    )
    big = np.zeros((7, 7))  # q, dq, theta, dtheta, torque, its slope, one
    spring = np.array([-k, -d, k, d])
    big[0, 1] = big[2, 3] = big[4, 5] = 1
    big[1, :4], big[3, :4] = spring / m, -spring / b
    big[3, 3] -= f / b
    big[3, 4], big[1, 6] = gain / b, -GRAVITY
    step = scipy.linalg.expm(big * STEP)
    t = np.arange(ROWS) * STEP
    held = M * GRAVITY + 25 * np.sin(9 * t) + 12 * np.sin(23 * t)
    x = np.array([0.0, 0.0, m * GRAVITY / k, 0.0])
    states, tau, read = [x], held[0], [held[0]]
    for i in range(1, ROWS):
        # A motor controller keeps the slide from falling; what it asks for is what is measured.
        asked = held[i] - 2e3 * x[2] - 200.0 * x[3]
        x = (step @ np.array([*x, tau, (asked - tau) / STEP, 1.0]))[:4]
        x[[1, 3]] += NOISE.link_acceleration * np.sqrt(STEP) * rng.standard_normal(2)
        tau = asked
        states.append(x)
        read.append(asked)
    path = np.array(states)
    theta = path[:, 2] + 1e-5 * rng.standard_normal(ROWS)
    speed = path[:, 3] + 2e-3 * rng.standard_normal(ROWS)
    return {"t": t, "theta_x": theta, "dtheta_x": speed, "tau_x": np.array(read)}, path[:, 0]


@pytest.mark.parametrize("estimator", [ElasticJointFilter, ElasticJointSmoother])
def test_over_carts_drawn_from_their_tolerances_errors_are_as_large_as_said(estimator):
    robot, rng = slide(), np.random.default_rng(7)
    count = 40
    squares, naive = [], []
    for _ in range(count):
        columns, q = drawn(rng)
        log = Log.from_table(columns, robot)
        honest, noise_only = (estimator(robot, NOISE, start="rest", tolerances=t).run(log) for t in (True, False))
        np.testing.assert_array_equal(honest.q, noise_only.q)
        rows = slice(SETTLED, ROWS - 50)
        squares.append((((honest.q[:, 0] - q) / honest.q_std[:, 0])[rows] ** 2).mean())
        naive.append((((noise_only.q[:, 0] - q) / noise_only.q_std[:, 0])[rows] ** 2).mean())
    # χ² of as many degrees as carts, at 3.3 deviations: an error that is one cart's stays with it.
    assert abs(np.mean(squares) - 1.0) < 3.3 * np.sqrt(2 / count)
    assert np.mean(naive) > 5
