"""State feedback: poles where they were asked for, closed loops on another robot than the known one, refusals."""

import sys

import numpy as np
import pytest

import linkside
from linkside import AccelerationObserver, EstimatorError, Log, Robot
from linkside.control import inverse_dynamics
from linkside.feedback import StateFeedback, linearised, lqr, motor_only, pole_placement
from linkside.poles import damped
from linkside.trajectories import rest_to_rest

from .robots import ARM, DATA, spring

sys.path.insert(0, str(DATA.parents[1] / "examples"))
import elastic_control
from plant import Plant, run, specimen

ROBOT = Robot.load(linkside.demo.ROBOT)
START = Log.read(linkside.demo.LOG, ROBOT).theta[0]


def loop(robot, q, gains):
    a, b = linearised(robot, q)
    elastic = np.flatnonzero(robot.elastic)
    columns = np.concatenate([elastic + block * robot.n for block in range(4)])
    return np.linalg.eigvals(a - b @ gains[np.ix_(elastic, columns)])


def one_elastic(damping):
    drive = {"stiffness": 3000.0, "damping": damping, "motor_inertia": 2.0}
    return Robot.from_urdf(ARM, [spring("shoulder", **drive), spring("elbow", elastic=False)], gravity=[0, 0, 0])


@pytest.mark.parametrize("damping", [0.0, 8.0])
def test_poles_are_where_they_were_asked_for(damping):
    robot, q = one_elastic(damping), [0.2, 0.7]
    found = np.sort_complex(loop(robot, q, pole_placement(robot, q, 20.0, 90.0)))
    asked = np.sort_complex(np.concatenate([damped(20).poles(4)[:2], damped(90).poles(4)[2:]]))
    assert np.abs(found - asked).max() < 1e-9 * 90


def test_the_linear_model_is_that_of_the_plant():
    desired = inverse_dynamics(ROBOT, rest_to_rest([START, START], 0.01, 5e-4))
    plant = Plant(ROBOT, desired)
    plant.viscous, plant.dry = 0 * plant.viscous, 0 * plant.dry
    plant.model.armature = np.where(ROBOT.elastic, 0.0, 1e9)  # holds rigid joints
    a, b = linearised(ROBOT, START)
    n, e, step = ROBOT.n, 3, 1e-6
    order = [n, 0, 3 * n, 2 * n]
    for block, first in enumerate(order):
        for joint in range(e):
            slopes = []
            for sign in (1, -1):
                x = plant.state.copy()
                x[first + joint] += sign * step
                slopes.append(np.concatenate([part[:e] for part in plant.accelerations(x, plant.torque)[::-1]]))
            column = (slopes[0] - slopes[1]) / (2 * step)
            assert np.abs(column - a[2 * e :, block * e + joint]).max() < 1e-4 * np.abs(a).max()
    torque = plant.torque + np.eye(n)[0]
    gain = plant.accelerations(plant.state, torque)[1] - plant.accelerations(plant.state, plant.torque)[1]
    assert gain[0] == pytest.approx(b[2 * e, 0])


def test_the_regulator_is_stable_and_swifter_with_more_torque():
    gentle, strong = (loop(ROBOT, START, lqr(ROBOT, START, torque=torque)).real.max() for torque in (10.0, 300.0))
    assert strong < gentle < 0


@pytest.mark.parametrize("motion", elastic_control.MOTIONS)
def test_full_state_halves_overshoot_and_vibration(motion):
    angle, duration = elastic_control.MOTIONS[motion]
    found = {}
    for name, gains in (("full", pole_placement(ROBOT, START)), ("motor", motor_only(ROBOT, START))):
        t, q, true, _ = elastic_control.experiment(ROBOT, START, angle, duration, gains)
        found[name] = np.array(elastic_control.vibration(t, q, true, duration))
    assert (found["full"] <= 0.5 * found["motor"]).all(), found


@pytest.mark.parametrize("rate", [1000, 2000, 4000])
@pytest.mark.parametrize(("poles", "slow"), [(100, 30.0), (250, 30.0), (500, 30.0), (250, 50.0), (500, 50.0)])
def test_the_loop_is_stable_over_observer_poles_and_rates(rate, poles, slow):
    goal = START + np.radians([5.0, 3.0, 3.0, 0, 0, 0])
    motion = rest_to_rest([START, goal], 0.2, 1 / rate).held(0, 0.5)
    desired = inverse_dynamics(ROBOT, motion)
    observer = AccelerationObserver(ROBOT, poles, period=1 / rate)
    controller = StateFeedback(ROBOT, desired, pole_placement(ROBOT, START, slow), observer)
    states, *_ = run(Plant(specimen(ROBOT), desired), controller, len(motion), 1 / rate)
    speed = np.abs(states[:, 2 * ROBOT.n : 2 * ROBOT.n + 3])
    assert speed[-rate // 10 :].max() < 0.02 * speed.max()
    assert np.abs(states[-1, :3] - goal[:3]).max() < 2e-3


def test_torque_is_the_feedforward_where_the_estimate_is_as_desired():
    desired = inverse_dynamics(ROBOT, rest_to_rest([START, START + 0.01], 0.1, 5e-4))
    plant = Plant(ROBOT, desired, noisy=False)
    controller = StateFeedback(ROBOT, desired, pole_placement(ROBOT, START))
    theta, acceleration = plant.read()
    torque = controller.step(theta=theta, acceleration=acceleration)
    assert np.abs(torque - desired.tau[0])[ROBOT.elastic].max() < 1e-3 * np.abs(desired.tau[0]).max()


def test_a_held_torque_replaces_that_of_the_sample():
    log = Log.read(linkside.demo.LOG, ROBOT)
    one, other = (AccelerationObserver(ROBOT, period=log.period) for _ in range(2))
    for theta, tau, acceleration in zip(log.theta[:50], log.tau, log.acceleration, strict=False):
        one.step(theta=theta, tau=tau, acceleration=acceleration)
        other.step(theta=theta, tau=0 * tau, acceleration=acceleration)
        other.hold(tau)
    states = [o.step(theta=log.theta[50], tau=log.tau[50], acceleration=log.acceleration[50]) for o in (one, other)]
    assert (states[0].q == states[1].q).all()
    with pytest.raises(EstimatorError, match="tau has 2 entries, expected 6"):
        one.hold([0.0, 0.0])


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda d: StateFeedback(ROBOT, d, np.zeros((6, 6))), r"expected finite numbers \(6, 24\), got \(6, 6\)"),
        (lambda d: StateFeedback(ROBOT, d, np.full((6, 24), np.nan)), "expected finite"),
        (
            lambda d: StateFeedback(ROBOT, d, pole_placement(ROBOT, START, 400.0, 4000.0)),
            "slower poles, or sample faster",
        ),
        (lambda d: StateFeedback(one_elastic(1.0), d, np.zeros((2, 8))), "2 rows or more of 2 joints"),
        (lambda d: pole_placement(ROBOT, START, -3.0), "expected positive frequencies"),
        (lambda d: motor_only(ROBOT, START, 0.0), "expected a positive frequency"),
        (lambda d: lqr(ROBOT, START, torque=0.0), "expected positive numbers"),
    ],
)
def test_what_cannot_be_controlled_with_is_refused(call, words):
    desired = inverse_dynamics(ROBOT, rest_to_rest([START, START], 0.01, 1e-3))
    with pytest.raises(EstimatorError, match=words):
        call(desired)
