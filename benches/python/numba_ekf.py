"""An EKF on the two-link arm as one would write it by hand for numba: loops, compiled for this machine.

Readings one after the other, so that nothing is inverted; the structure of F is used, and so is that of the biases.
"""

import numpy as np
from numba import njit
from two_link import Array, Problem
from two_link import measure as python_measure

JOINTS, MOVING, READINGS, STATES = 2, 6, 4, 10

measure = njit(python_measure)


@njit
def run(problem: Problem) -> tuple[Array, Array]:
    """Means (T, 10) and covariances (T, 10, 10)."""
    count = len(problem.readings)
    means, covariances = np.empty((count, STATES)), np.empty((count, STATES, STATES))
    x, p = problem.start.copy(), np.diag(problem.initial)
    prediction, jacobian = np.empty(READINGS), np.empty((READINGS, MOVING))
    g = np.empty(STATES)
    for k in range(count):
        if k > 0:
            predict(problem, x, p, problem.jerk[k])
        measure(problem.arm, x, problem.dtheta[k], prediction, jacobian)
        correct(problem, x, p, prediction, jacobian, problem.readings[k], g)
        means[k] = x
        covariances[k] = p
    return means, covariances


@njit
def predict(problem: Problem, x: Array, p: Array, jerk: Array) -> None:
    """x ← F x + G u, P ← F P Fᵀ + Q."""
    t = problem.period
    half = 0.5 * t * t
    for j in range(JOINTS):
        x[j] += t * x[2 + j] + half * x[4 + j] + half * t / 3 * jerk[j]
        x[2 + j] += t * x[4 + j] + half * jerk[j]
        x[4 + j] += t * jerk[j]
        for i in range(STATES):
            p[j, i] += t * p[2 + j, i] + half * p[4 + j, i]
            p[2 + j, i] += t * p[4 + j, i]
    for i in range(STATES):
        for j in range(JOINTS):
            p[i, j] += t * p[i, 2 + j] + half * p[i, 4 + j]
            p[i, 2 + j] += t * p[i, 4 + j]
    for j in range(JOINTS):
        for a in range(3):
            for b in range(3):
                p[2 * a + j, 2 * b + j] += problem.process[2 * a + j, 2 * b + j]
    for i in range(READINGS):
        p[MOVING + i, MOVING + i] += problem.process[MOVING + i, MOVING + i]


@njit
def correct(problem: Problem, x: Array, p: Array, prediction: Array, jacobian: Array, reading: Array, g: Array) -> None:
    """Use the readings; all are linearised at the x that this starts from."""
    moved = np.zeros(MOVING)
    for i in range(READINGS):
        bias = MOVING + i
        for a in range(STATES):
            g[a] = p[bias, a]
        for b in range(MOVING):
            for a in range(STATES):
                g[a] += jacobian[i, b] * p[b, a]
        s, innovation = g[bias] + problem.variance[i], reading[i] - prediction[i] - x[bias]
        for b in range(MOVING):
            s += jacobian[i, b] * g[b]
            innovation -= jacobian[i, b] * moved[b]
        for a in range(STATES):
            gain = g[a] / s
            x[a] += gain * innovation
            if a < MOVING:
                moved[a] += gain * innovation
            for b in range(STATES):
                p[a, b] -= gain * g[b]
