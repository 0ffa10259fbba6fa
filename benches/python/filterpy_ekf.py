"""filterpy's EKF on the two-link arm, with the model compiled by numba."""

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from numba_ekf import measure
from two_link import Array, Problem, transition


def run(problem: Problem) -> tuple[Array, Array]:
    """Means (T, 10) and covariances (T, 10, 10)."""
    ekf = ExtendedKalmanFilter(dim_x=10, dim_z=4, dim_u=2)
    ekf.F, ekf.B = transition(problem.period)
    ekf.Q = problem.process
    ekf.R, ekf.P, ekf.x = np.diag(problem.variance), np.diag(problem.initial), problem.start.copy()
    prediction, jacobian = np.zeros(4), np.hstack([np.zeros((4, 6)), np.eye(4)])

    def predicted(x: Array) -> Array:
        return prediction + x[6:]

    def linearised(x: Array, dtheta: Array) -> Array:  # filterpy calls this before `predicted`
        measure(problem.arm, x, dtheta, prediction, jacobian)
        return jacobian

    count = len(problem.readings)
    means, covariances = np.empty((count, 10)), np.empty((count, 10, 10))
    for k in range(count):
        if k > 0:
            ekf.predict(problem.jerk[k])
        ekf.update(problem.readings[k], linearised, predicted, args=(problem.dtheta[k],))
        means[k], covariances[k] = ekf.x, ekf.P
    return means, covariances
