"""dynamax's EKF on the two-link arm, compiled, in double precision; dynamax derives the model by itself.

Readings are in multiples of their noise: dynamax adds 1e-9 to their covariance, which in radians would be more than
the noise itself.
"""

from functools import partial

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from dynamax.nonlinear_gaussian_ssm import ParamsNLGSSM, extended_kalman_filter  # noqa: E402
from two_link import GRAVITY, Arm, Array, Problem, transition  # noqa: E402

KEPT = ["filtered_means", "filtered_covariances"]


def run(problem: Problem) -> tuple[Array, Array]:
    """Means (T, 10) and covariances (T, 10, 10)."""
    f, by_jerk = transition(problem.period)
    moments = problem.start, np.diag(problem.initial), problem.process
    std, inputs = np.sqrt(problem.variance), np.hstack([problem.dtheta, problem.jerk])
    means, covariances = _run(*moments, f, by_jerk, std, problem.readings / std, inputs, arm=problem.arm)
    return np.asarray(means), np.asarray(covariances)


@partial(jax.jit, static_argnames="arm")
def _run(
    mean: Array, covariance: Array, process: Array, f: Array, by_jerk: Array, std: Array, *series: Array, arm: Arm
) -> tuple[Array, Array]:
    params = ParamsNLGSSM(
        initial_mean=mean,
        initial_covariance=covariance,
        dynamics_function=lambda x, u: f @ x + by_jerk @ u[2:],
        dynamics_covariance=process,
        emission_function=lambda x, u: (readings(arm, x, u[:2]) + x[6:]) / std,
        emission_covariance=jnp.eye(len(std)),
    )
    emissions, inputs = series
    out = extended_kalman_filter(params, emissions, inputs, output_fields=KEPT)
    return out.filtered_means, out.filtered_covariances


def readings(arm: Arm, x: Array, dtheta: Array) -> Array:
    """Predicted at x, without biases; the same as `two_link.measure`."""
    q1, q2, v1, v2, a1, a2 = x[:6]
    c1, s1, c2, s2, c12, s12 = jnp.cos(q1), jnp.sin(q1), jnp.cos(q2), jnp.sin(q2), jnp.cos(q1 + q2), jnp.sin(q1 + q2)
    h, slope = arm.coupled[0] * c2 + arm.coupled[1] * s2, arm.coupled[1] * c2 - arm.coupled[0] * s2
    x1, x2 = arm.first[0] * c1 + arm.first[1] * s1, arm.second[0] * c12 + arm.second[1] * s12
    inner = (arm.whole + 2 * h) * a1 + (arm.outer + h) * a2 + slope * (2 * v1 * v2 + v2 * v2) - GRAVITY * (x1 + x2)
    outer = (arm.outer + h) * a1 + arm.outer * a2 - slope * v1 * v1 - GRAVITY * x2
    motor1 = q1 + (inner - arm.damping[0] * (dtheta[0] - v1)) / arm.stiffness[0]
    motor2 = q2 + (outer - arm.damping[1] * (dtheta[1] - v2)) / arm.stiffness[1]
    w, a = v1 + v2, a1 + a2
    px, pz = arm.link[0] * c2 - arm.link[1] * s2, arm.link[0] * s2 + arm.link[1] * c2
    rx, rz = arm.sensor
    gx, gz = arm.up[0] * c12 - arm.up[1] * s12, arm.up[0] * s12 + arm.up[1] * c12
    along = pz * a1 - px * v1 * v1 + rz * a - rx * w * w + gx
    across = -px * a1 - pz * v1 * v1 - rx * a - rz * w * w + gz
    return jnp.stack([motor1, motor2, along, across])
