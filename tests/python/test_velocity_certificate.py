"""What the gains of the velocity observers promise, on random robots: errors shrink, and the level does not chatter."""

import numpy as np
import pinocchio as pin
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from linkside import HybridGain, ReducedOrderObserver
from linkside.velocity.gain_design import christoffel, coriolis_bound

from . import two_rods
from .robots import robots

PERIOD = 1e-3
RODS = two_rods.robot()
GAINS = (13.35799, 21.39453, 29.43109, 37.46764, 45.5042, 53.54076, 61.57732, 69.61388)
BOUND, MARGIN = 1.5, 1.0
STEPS = 60


class Plant:
    """A robot by Pinocchio, links alone, in the order of the log."""

    def __init__(self, robot):
        self.robot, self.data = robot, robot.model.createData()

    def pinocchio(self, q, *velocities):
        return (self.robot.to_pinocchio(q), *(self.robot.velocity_to_pinocchio(v) for v in velocities))

    def torque(self, q, v, a):
        return pin.rnea(self.robot.model, self.data, *self.pinocchio(q, v, a))[self.robot.velocity_index]

    def mass(self, q):
        mass = pin.crba(self.robot.model, self.data, *self.pinocchio(q))
        whole = np.triu(mass) + np.triu(mass, 1).T
        return whole[np.ix_(self.robot.velocity_index, self.robot.velocity_index)]

    def slope(self, torque):
        n = self.robot.n

        def slope(_, x):
            a = pin.aba(self.robot.model, self.data, *self.pinocchio(x[:n], x[n:], torque))
            return np.concatenate([x[n:], a[self.robot.velocity_index]])

        return slope

    def motion(self, q, v, torque, period):
        rows = [np.concatenate([q, v])]
        for _ in range(STEPS):
            rows.append(two_rods.rk4(self.slope(torque), 0.0, rows[-1], period))
        return np.split(np.array(rows), 2, axis=1)


def unit(rng, n):
    v = rng.standard_normal(n)
    return v / np.linalg.norm(v)


@settings(max_examples=40, deadline=None)
@given(robots(most=4), st.floats(0.1, 2), st.floats(0.1, 2), st.integers(0, 2**32 - 1))
def test_energy_of_the_error_falls_inside_the_region(robot, speed, margin, seed):
    rng, plant = np.random.default_rng(seed), Plant(robot)
    q, v = rng.uniform(-2, 2, robot.n), speed * unit(rng, robot.n)
    torque = plant.torque(q, v, 3 * unit(rng, robot.n))

    def needed(q, speed):
        """Equation (11) along a motion, and the inertia's eigenvalues there."""
        values = np.linalg.eigvalsh([plant.mass(x) for x in q])
        coriolis = coriolis_bound(christoffel(robot, q))
        return (coriolis * (speed + margin) / values[:, 0]).max(), values.min(), values.max()

    period = min(PERIOD, 0.02 / (1 + needed(q[None], speed)[0]))
    q, v = plant.motion(q, v, torque, period)
    gain, least, greatest = needed(q, np.linalg.norm(v, axis=1).max())
    gain = 1.05 * gain + 0.1
    assume(gain * period < 0.1 and least > 1e-4 * greatest)
    observer = ReducedOrderObserver(robot, gain, side="links", period=period)
    observer.start(dq=v[0] + 0.95 * margin * np.sqrt(least / greatest) * unit(rng, robot.n))
    errors = [now - observer.step(q=at, tau=torque).dq for at, now in zip(q, v, strict=True)]
    energies = np.array([e @ plant.mass(at) @ e for e, at in zip(errors, q, strict=True)])
    assert (np.diff(energies) <= 1e-5 * energies[0]).all()
    assert energies[-1] < energies[0]


def drive(x, observer, torque, count, noise=0.0, seed=0):
    """Sample the two rods under held torques; true and estimated velocities, and levels."""
    rng = np.random.default_rng(seed)
    true, found, levels = [], [], []
    for sample in range(count):
        tau = torque(sample * PERIOD)
        state = observer.step(q=x[:2] + noise * rng.standard_normal(2), tau=tau)
        true.append(x[2:])
        found.append(state.dq)
        levels.append(state.level)
        x = two_rods.rk4(lambda _, x, u=tau: np.concatenate([x[2:], two_rods.forward(x[:2], x[2:], u)]), 0, x, PERIOD)
    return np.array(true), np.array(found), np.array(levels)


@settings(max_examples=10, deadline=None)
@given(st.floats(0.5, 8), st.floats(0, 6), st.floats(0.02, 1), st.floats(0, 3e-4), st.integers(0, 2**32 - 1))
def test_level_does_not_chatter(frequency, amplitude, hysteresis, noise, seed):
    gain = HybridGain(GAINS, BOUND, MARGIN, hysteresis=hysteresis)
    observer = ReducedOrderObserver(RODS, gain, period=PERIOD)

    def torque(t):
        return amplitude * np.array([20 * np.sin(frequency * t), 10 * np.cos(frequency * t)])

    _, found, levels = drive(two_rods.START, observer, torque, 800, noise, seed)
    speed, jumps = np.linalg.norm(found, axis=1), np.sign(np.diff(levels.astype(int), prepend=1))
    assert (speed[jumps > 0] >= (levels[jumps > 0] - 1) * BOUND - MARGIN).all()
    assert (speed[jumps < 0] <= levels[jumps < 0] * BOUND - MARGIN - hysteresis).all()
    reversals = np.count_nonzero(np.diff(jumps[jumps != 0]))
    assert reversals * hysteresis <= np.abs(np.diff(speed)).sum()
    assert (speed <= levels * BOUND - MARGIN)[levels < len(GAINS)].all()


@settings(max_examples=10, deadline=None)
@given(st.floats(0, 2 * np.pi), st.floats(2, 9), st.integers(0, 2**32 - 1))
def test_recovers_from_outside_the_region_when_the_level_is_raised(heading, speed, seed):
    start = two_rods.START.copy()
    start[2:] = speed * np.array([np.cos(heading), np.sin(heading)])
    observer = ReducedOrderObserver(RODS, HybridGain(GAINS, BOUND, MARGIN, start=len(GAINS)), period=PERIOD)
    true, found, levels = drive(start, observer, lambda _: np.zeros(2), 2500, seed=seed)
    error = np.linalg.norm(true - found, axis=1)
    assert error[0] > MARGIN
    assert error[-1] < 1e-3 * error[0]
    settled = error < MARGIN
    first = np.argmax(settled)
    assert settled[first:].all()
    within = (np.linalg.norm(true, axis=1) <= levels * BOUND) | (levels == len(GAINS))
    assert within[first:].all()


@settings(max_examples=10, deadline=None)
@given(st.floats(-np.pi, np.pi), st.floats(-9, 9), st.floats(-9, 9))
def test_level_returns_to_its_least_at_rest(elbow, one, two):
    observer = ReducedOrderObserver(RODS, HybridGain(GAINS, BOUND, MARGIN), period=PERIOD)
    observer.start(dq=[one, two])
    levels = [observer.step(q=[0.0, elbow], tau=[0, 0]).level for _ in range(2500)]
    assert levels[-1] == 1
