"""Particle filters with accelerations marginalised: against the Kalman filter, and against the same in plain NumPy."""

import numpy as np
import pytest

from linkside import EstimatorError, ExtendedKalmanFilter, MarginalizedParticleFilter, Noise, ParticleFilter

from .test_kalman_filter import rest_position
from .test_particle import LINEAR, errors, recording

WANDERING = LINEAR.updated(position_walk=1e-2, velocity_walk=3.0)
"""Over a sample of the slide, links wander about as much as their acceleration moves them."""


@pytest.mark.parametrize(("proposal", "kernel"), [("linearised", None), ("linearised", 0.5), ("bootstrap", None)])
def test_on_a_linear_model_errors_shrink_with_the_root_of_n(proposal, kernel):
    settings = {"accelerations": True, "proposal": proposal, "kernel": kernel, "noise": WANDERING}
    few, many = (errors(MarginalizedParticleFilter, count, 12, **settings) for count in (200, 200 * 64))
    # A factor of 64 in N is one of 8; 12 seeds know a root mean square to within some 20 %.
    assert (few / many > 4).all(), (few, many)
    assert (few / many < (16, 16, 32)).all(), (few, many)
    assert (many[:2] < 0.1).all(), many


def test_on_a_linear_model_smoothing_tends_to_rauch_tung_and_striebels():
    settings = {"accelerations": True, "noise": WANDERING}
    few, many = (errors(MarginalizedParticleFilter, count, 12, "smooth", **settings) for count in (200, 200 * 16))
    assert (few[:2] / many[:2] > 2.5).all(), (few, many)
    assert (many[:2] < 0.2).all(), many


@pytest.mark.parametrize("method", [ParticleFilter, MarginalizedParticleFilter])
def test_walks_are_the_kalman_filters_where_they_are_drawn_too(method):
    assert (errors(method, 6400, 4, noise=WANDERING)[:2] < 0.15).all()


@pytest.mark.parametrize("proposal", [{"iterations": 2}, {"proposal_tail": 4}])
def test_other_proposals_find_the_same(proposal):
    error = errors(MarginalizedParticleFilter, 6400, 4, noise=WANDERING, accelerations=True, **proposal)
    assert (error < 0.15).all(), error


def test_marginalising_accelerations_makes_the_likelihood_less_random():
    # Where jerk is larger, the accelerometer alone says what the acceleration is, and nothing is left to marginalise.
    noise = WANDERING.updated(jerk=10.0, velocity_walk=2.0)
    plain, biases, both = (
        errors(method, 200, 40, kernel=None, noise=noise, **settings)[2]
        for method, settings in (
            (ParticleFilter, {}),
            (MarginalizedParticleFilter, {}),
            (MarginalizedParticleFilter, {"accelerations": True}),
        )
    )
    assert both < 0.7 * biases
    assert both < 0.7 * plain


ARM = Noise(jerk=15.0, position=2e-5, position_walk=3e-4, velocity_walk=1e-2, motor_bias=3e-6, torsion=0.0)


def reference(robot, log, noise, count, seed):
    """Plain NumPy: Schön, Gustafsson and Nordlund (2005), algorithm 1, noises correlated, particles moved by the model.

    h is affine in l = (q̈, b): h = h₀(q, q̇) + H(q, q̇) l.
    """
    rng, n, m = np.random.default_rng(seed), robot.n, robot.n + len(robot.acceleration_channels)
    arrays, kinds = noise.arrays(robot, ("motor", "acceleration")), robot.drives
    stiffness = np.array([drive.stiffness for drive in kinds])
    readings = np.hstack([log.theta, log.acceleration])
    start, eye = np.concatenate([rest_position(robot, log.theta[0]), np.zeros(n)]), np.eye(n)
    initial = np.array(arrays["initial"])
    x = start + initial[: 2 * n] * rng.standard_normal((count, 2 * n))
    mean = np.zeros((count, n + m))
    p = np.tile(np.diag(np.concatenate([initial[2 * n :], arrays["initial_bias"]]) ** 2), (count, 1, 1))
    means, likelihoods = [], []
    for i in range(len(log)):
        if i:
            h = log.t[i] - log.t[i - 1]
            gain = np.vstack([h * h / 2 * eye, h * eye])
            jerk = np.diag(np.square(arrays["jerk"]))
            white = np.array([[h**5 / 20, h**4 / 8, h**3 / 6], [h**4 / 8, h**3 / 3, h**2 / 2], [h**3 / 6, h**2 / 2, h]])
            q_n = np.kron(white[:2, :2], jerk) + np.diag(np.square(arrays["link_walk"]) * h)
            q_l, q_ln = np.diag(np.square(arrays["bias_walk"]) * h), np.zeros((n + m, 2 * n))
            q_l = np.block([[white[2, 2] * jerk, np.zeros((n, m))], [np.zeros((m, n)), q_l]])
            q_ln[:n] = np.kron(white[2:, :2], jerk)
            a = np.hstack([gain, np.zeros((2 * n, m))])
            u = np.zeros(n) if log.ddqref is None else (log.ddqref[i] - log.ddqref[i - 1]) / h
            drift = np.concatenate([h**3 / 6 * u, h**2 / 2 * u])
            ahead = np.hstack([x[:, :n] + h * x[:, n:], x[:, n:]]) + mean @ a.T + drift
            s_n, s_ln = a @ p @ a.T + q_n, p @ a.T + q_ln
            x = ahead + np.einsum("kij,kj->ki", np.linalg.cholesky(s_n), rng.standard_normal((count, 2 * n)))
            k = np.linalg.solve(s_n, s_ln.transpose(0, 2, 1)).transpose(0, 2, 1)
            mean = mean + np.einsum("kij,kj->ki", k, x - ahead) + np.concatenate([h * u, np.zeros(m)])
            p = p + q_l - k @ s_ln.transpose(0, 2, 1)
        q, dq = x[:, :n], x[:, n:]
        still = np.zeros_like(q)
        by_ddq, specific_force = robot.acceleration_map(q, dq)
        h_0 = np.hstack([q + robot.inverse_dynamics(q, dq, still) / stiffness, specific_force])
        slope = np.concatenate([robot.mass_matrix(q) / stiffness[:, None], by_ddq], axis=1)
        slope = np.concatenate([slope, np.tile(np.eye(m), (count, 1, 1))], axis=2)
        error = readings[i] - h_0 - np.einsum("kij,kj->ki", slope, mean)
        s = slope @ p @ slope.transpose(0, 2, 1) + np.diag(np.square(arrays["reading"]))
        whitened = np.linalg.solve(np.linalg.cholesky(s), error[..., None])[..., 0]
        logs = -0.5 * (whitened**2).sum(axis=1) - 0.5 * np.linalg.slogdet(2 * np.pi * s)[1]
        k = np.linalg.solve(s, slope @ p).transpose(0, 2, 1)
        mean, p = mean + np.einsum("kij,kj->ki", k, error), p - k @ slope @ p
        weights = np.exp(logs - logs.max())
        likelihoods.append(logs.max() + np.log(weights.mean()))
        weights /= weights.sum()
        means.append(weights @ np.hstack([x, mean]))
        chosen = np.searchsorted(np.cumsum(weights), (np.arange(count) + rng.random()) / count).clip(0, count - 1)
        x, mean, p = x[chosen], mean[chosen], p[chosen]
    return np.array(means), np.array(likelihoods)


@pytest.mark.parametrize("proposal", ["linearised", "bootstrap"])
def test_on_an_arm_it_is_the_plain_filter(proposal):
    robot, log = recording()
    log, count = log[:25], 4000
    means, likelihoods = reference(robot, log, ARM, count, 1)
    settings = {"particles": count, "proposal": proposal, "kernel": None, "damping": False}
    settings |= {"start": "rest", "tolerances": False}
    method = MarginalizedParticleFilter(robot, ARM, accelerations=True, **settings)
    ours = method.run(log, covariance=True)
    std = np.sqrt(np.diagonal(ours.covariance, axis1=1, axis2=2))
    assert np.sqrt(np.mean(((ours.state - means) / std) ** 2)) < 0.1
    assert np.abs(ours.log_likelihood - likelihoods).max() < 0.2


def test_on_an_arm_it_is_close_to_the_kalman_filter():
    robot, log = recording()
    log, noise = log[:300], ARM.updated(torsion=3e-3)
    settings = {"accelerations": True, "particles": 2000, "kernel": 1.0}
    method = MarginalizedParticleFilter(robot, noise, **settings, tolerances=False)
    kalman = ExtendedKalmanFilter(robot, noise, tolerances=False).run(log, covariance=True)
    ours = method.run(log, covariance=True)
    std = np.sqrt(np.diagonal(kalman.covariance, axis1=1, axis2=2))
    assert np.sqrt(np.mean(((ours.state - kalman.state) / std) ** 2)) < 0.3


def test_a_start_of_two_peaks_is_resolved():
    robot, log = recording()
    log, kalman = log[:200], ExtendedKalmanFilter(robot, ARM).run(log[:200])
    starts = [kalman.q[0] + 0.02, kalman.q[0]]
    method = MarginalizedParticleFilter(robot, ARM, accelerations=True, initial=starts, particles=500, kernel=None)
    assert np.abs(method.run(log).q[-1] - kalman.q[-1]).max() < 1e-4


def test_links_need_not_wander():
    """White jerk, integrated, leaves a path from which accelerations do not follow."""
    robot, log = recording()
    method = MarginalizedParticleFilter(robot, Noise(jerk=15.0), accelerations=True, particles=500)
    kalman = ExtendedKalmanFilter(robot, Noise(jerk=15.0), tolerances=False).run(log[:100])
    ours = method.run(log[:100])
    assert np.sqrt(np.mean(((ours.q - kalman.q) / kalman.q_std) ** 2)) < 0.5


def test_outliers_are_refused():
    robot, log = recording()
    with pytest.raises(EstimatorError, match="outliers"):
        MarginalizedParticleFilter(robot, ARM, accelerations=True, outliers={"acceleration": 4.0}).run(log[:3])
