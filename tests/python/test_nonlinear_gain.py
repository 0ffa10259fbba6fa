"""Gains that depend on the posture: held to closed forms, to what no map can exceed, and to the printed observer."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from linkside import Estimate, EstimatorError, GainMap, Log, NicosiaTomeiObserver, ReducedOrderObserver, Robot
from linkside.robot.workspace import prismatic
from linkside.velocity.gain_design import design_gain
from linkside.velocity.shaped_gain import approximate_inverse, reduce_deformation, shaped

from . import two_rods
from .robots import robots

DATA = Path(__file__).parents[1] / "data"
RODS = two_rods.robot()
GRID = np.stack([np.zeros(2001), np.linspace(-np.pi, np.pi, 2001)], axis=1)
MASS = np.array([two_rods.mass(q) for q in GRID])
PERIOD = 1e-3


def eigenvalues(gain):
    """Of Q on a fine grid, the arm's inertia in closed form."""
    product = MASS @ gain.jacobian(GRID)
    return np.linalg.eigvalsh(product + product.transpose(0, 2, 1))


def ratio(gain):
    values = eigenvalues(gain)
    return values[:, 0].min() / values[:, -1].max()


@pytest.mark.parametrize(("harmonics", "expected"), [(0, 0.107), (1, 0.170), (2, 0.392), (3, 0.553), (5, 0.854)])
def test_deformation_is_reduced_as_far_as_can_be(harmonics, expected):
    found = reduce_deformation(RODS, harmonics)
    assert ratio(found.map) == pytest.approx(expected, abs=1e-3)
    assert ratio(found.map) == pytest.approx(found.ratio, rel=5e-3)
    assert found.limit == pytest.approx(found.ratio, rel=1.1e-3)
    assert found.ratio <= found.limit


@pytest.mark.parametrize(("gain", "expected"), [(np.eye(2), 0.0187), (np.linalg.inv(MASS[:-1].mean(axis=0)), 0.102)])
def test_deformation_of_constant_gains(gain, expected):
    given = shaped(RODS, GainMap.constant(gain))
    assert given.ratio == pytest.approx(expected, abs=5e-4)
    assert ratio(given.map) == pytest.approx(expected, abs=5e-4)


def test_inverse_is_approximated_row_by_row():
    found = approximate_inverse(RODS, 12)
    inverse = np.linalg.inv(MASS)
    projected = inverse.copy()
    projected[:, :, 0] = inverse[:-1, :, 0].mean(axis=0)  # no gradient depends on y₂ alone in its first entry
    np.testing.assert_allclose(found.map.jacobian(GRID), projected, atol=1e-4)
    assert found.apart == pytest.approx(0.175, abs=5e-4)
    assert eigenvalues(found.map)[:, 0].min() / 2 == pytest.approx(0.2246, abs=2e-3)


def test_no_map_lowers_the_peak_of_the_gain():
    constant = design_gain(RODS, 1.5, 1.0).gain
    maps = [*(reduce_deformation(RODS, h) for h in (0, 1, 2, 5)), approximate_inverse(RODS)]
    peaks = [m.for_speed(1.5, 1.0).peak for m in maps]
    assert min(peaks) > constant
    assert all(27 < peak < 49 for peak in peaks[1:])
    identity = shaped(RODS, GainMap.constant(np.eye(2))).for_speed(1.5, 1.0)
    assert identity.peak == pytest.approx(constant, rel=1e-3)


@settings(max_examples=10, deadline=None)
@given(robots(most=3), st.integers(0, 2**32 - 1))
def test_limits_hold_for_any_map(robot, seed):
    found = reduce_deformation(robot, 1, samples=64)
    assert found.ratio <= found.limit * (1 + 1e-9)
    rng = np.random.default_rng(seed)
    change = 0.3 * np.linalg.norm(found.map.linear) * rng.standard_normal((robot.n, robot.n))
    waves = found.map.waves
    other = GainMap(found.map.linear + change, waves, found.map.sine, found.map.cosine)
    assert shaped(robot, other, samples=64).ratio <= found.limit * (1 + 1e-9)
    assert (waves[:, prismatic(robot)] == 0).all()
    assert (waves == np.round(waves)).all()
    assume(found.ratio > 1e-6)
    s, scaled = found._survey, found.for_speed(1.0, 0.5)
    assert scaled.peak >= ((1.5 * s.coriolis - s.friction) / s.least).max() * (1 - 1e-9)


@settings(max_examples=25)
@given(st.integers(1, 4), st.integers(0, 3), st.integers(0, 2**32 - 1))
def test_jacobian_is_the_slope_of_the_map(n, count, seed):
    rng = np.random.default_rng(seed)
    waves = rng.integers(-2, 3, (count, n)).astype(float)
    gain = GainMap(rng.standard_normal((n, n)), waves, *rng.standard_normal((2, count, n)))
    q, step = rng.uniform(-3, 3, n), 1e-5
    slope = np.stack([(gain(q + step * e) - gain(q - step * e)) / (2 * step) for e in np.eye(n)], axis=1)
    np.testing.assert_allclose(gain.jacobian(q), slope, atol=1e-8)
    np.testing.assert_allclose((gain * 2.0).jacobian(q), 2 * gain.jacobian(q))


def torque(t):
    return np.array([20 * np.cos(t / 2), -10 * np.cos(t)])


def test_observer_follows_the_equations_as_printed():
    gain = reduce_deformation(RODS, 3).for_speed(1.5, 1.0).map

    def slope(t, x):
        q, v, z = x.reshape(3, 2)
        found = z + gain(q)
        rate = two_rods.forward(q, found, torque(t)) - gain.jacobian(q) @ found
        return np.concatenate([v, two_rods.forward(q, v, torque(t)), rate])

    x = np.concatenate([two_rods.START, -gain(two_rods.START[:2])])
    observer = ReducedOrderObserver(RODS, gain, period=PERIOD, start="rest")
    apart, errors = [], []
    for sample in range(1500):
        t = sample * PERIOD
        found = observer.step(q=x[:2], tau=torque(t + PERIOD / 2)).dq
        apart.append(found - x[4:] - gain(x[:2]))
        errors.append(np.linalg.norm(found - x[2:4]))
        x = two_rods.rk4(slope, t, x, PERIOD)
    assert np.abs(apart).max() < 1e-3  # of speeds up to 1.1 rad/s
    assert errors[-1] < 3e-3 * errors[0]


def recording(name):
    robot = Robot.load(DATA / name / "robot.yaml")
    return robot, Log.read(DATA / name / "log.parquet", robot), Estimate.read(DATA / name / "truth.parquet")


def test_a_constant_map_is_a_constant_gain():
    robot, log, _ = recording("kr15_six_axes")
    mapped = ReducedOrderObserver(robot, GainMap.constant(80 * np.eye(robot.n))).run(log)
    plain = ReducedOrderObserver(robot, 80).run(log)
    np.testing.assert_allclose(mapped.dq, plain.dq, atol=1e-4)


def test_run_is_step_and_missing_readings_are_bridged():
    robot, log, truth = recording("kr15_six_axes")
    shape = approximate_inverse(robot, 1)
    observer = ReducedOrderObserver(robot, shape.map * (600 / shape.peak))
    theta = log.theta.copy()
    theta[1000:1010] = np.nan
    theta[1500:, 3] -= 2 * np.pi
    columns = {f"{s}_{n}": v[:, j] for s, v in (("theta", theta), ("tau", log.tau)) for j, n in enumerate(robot.names)}
    whole = observer.run(Log.from_table({"t": log.t, **columns}, robot, check=False))
    steps = [observer.step(q=q, tau=tau).dq for q, tau in zip(theta, log.tau, strict=True)]
    np.testing.assert_array_equal(whole.dq, steps)
    assert np.sqrt(((whole.dq - truth.dtheta)[200:] ** 2).mean(axis=0)).max() < 0.02


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: GainMap(np.eye(2), np.ones((1, 3)), np.ones((1, 2)), np.ones((1, 2))), r"waves .* \(1, 2\)"),
        (lambda: GainMap(np.ones((2, 3)), *np.ones((3, 0, 2))), r"linear .* expected \(2, 2\)"),
        (lambda: shaped(RODS, GainMap.constant(np.eye(3))), "for 3 joints, expected 2"),
        (lambda: shaped(RODS, GainMap.constant(-np.eye(2))).for_speed(1.0, 1.0), "no positive gain at the posture"),
        (lambda: shaped(RODS, GainMap.constant(np.eye(2))).for_speed(0.0, 1.0), "speed is 0.0"),
        (lambda: reduce_deformation(RODS, -1), "harmonics is -1"),
        (lambda: approximate_inverse(RODS, 40, samples=64), "40 waves are too many for 64 postures"),
        (lambda: NicosiaTomeiObserver(RODS, GainMap.constant(np.eye(2)), period=PERIOD), "a gain map has no spring"),
        (lambda: ReducedOrderObserver(RODS, GainMap.constant(np.eye(3)), period=PERIOD), "9 entries, expected 4"),
        (lambda: ReducedOrderObserver(RODS, GainMap.constant(3000 * np.eye(2)), period=PERIOD), "too fast"),
        (lambda: ReducedOrderObserver(RODS, GainMap.constant(np.full((2, 2), np.nan)), period=PERIOD), "finite"),
    ],
)
def test_refuses(call, words):
    with pytest.raises(EstimatorError, match=words):
        call()
