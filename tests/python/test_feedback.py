"""State feedback: poles where they were asked for, closed loops on another robot than the known one, refusals."""

from itertools import product

import numpy as np
import pytest

import linkside
from linkside import AccelerationObserver, EstimatorError, Log, Robot, simulate
from linkside.control import inverse_dynamics
from linkside.control.closed_loop import closed_loop_poles
from linkside.control.feedback import StateFeedback, linearised, lqr, motor_only, pole_placement
from linkside.control.trajectories import rest_to_rest
from linkside.observers.poles import damped
from linkside.papers import deluca2007
from linkside.robot.joints import MotorFriction

from .robots import ARM, spring

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


def test_the_linear_model_is_that_of_the_forward_dynamics():
    drives = [joint.model_copy(update={"motor_friction": MotorFriction()}) for joint in ROBOT.drives]
    held = [joint if joint.elastic else joint.model_copy(update={"motor_inertia": 1e9}) for joint in drives]
    robot = Robot(ROBOT.config.model_copy(update={"joints": tuple(held)}), ROBOT.tree)
    a, b = linearised(robot, START)
    tau = robot.gravity_torque(START)
    rest, stiffness = np.zeros(6), np.array([drive.stiffness or np.inf for drive in robot.drives])
    state = np.stack([START + tau / stiffness, START, rest, rest])

    def accelerations(state, tau):
        theta, q, dtheta, dq = state
        ddq, ddtheta = robot.forward_dynamics(q, dq, theta, dtheta, tau)
        return np.concatenate([ddtheta[:3], ddq[:3]])

    for block in range(4):
        for joint in range(3):
            change = np.zeros_like(state)
            change[block, joint] = 1e-6
            column = (accelerations(state + change, tau) - accelerations(state - change, tau)) / 2e-6
            assert np.abs(column - a[6:, 3 * block + joint]).max() < 1e-6 * np.abs(a).max()
    gain = accelerations(state, tau + np.eye(6)[0]) - accelerations(state, tau)
    assert gain == pytest.approx(b[6:, 0], abs=1e-9)


def test_the_regulator_is_stable_and_swifter_with_more_torque():
    gentle, strong = (loop(ROBOT, START, lqr(ROBOT, START, torque=torque)).real.max() for torque in (10.0, 300.0))
    assert strong < gentle < 0


@pytest.mark.parametrize(("rate", "poles"), [(1000, 150.0), (2000, 250.0), (4000, 500.0)])
@pytest.mark.parametrize("motion", deluca2007.MOTIONS)
def test_full_state_halves_overshoot_and_vibration(motion, rate, poles):
    angle, duration = deluca2007.MOTIONS[motion]
    found = {}
    for name, gains in (("full", pole_placement(ROBOT, START)), ("motor", motor_only(ROBOT, START))):
        motion = deluca2007.experiment(ROBOT, START, angle, duration, gains, poles, 1 / rate)
        found[name] = np.array(motion.settling(duration))
    assert (found["full"] <= 0.5 * found["motor"]).all(), found


SPECIMEN = ROBOT.scaled(stiffness=0.95, damping=1.05, motor_inertia=1.05, mass=1.05)


@pytest.fixture(scope="module")
def specimens():
    """Robots of which every parameter is 5 % too large or too small."""
    names = ("stiffness", "damping", "motor_inertia", "mass")
    return [ROBOT.scaled(**dict(zip(names, factors, strict=True))) for factors in product((0.95, 1.05), repeat=4)]


@pytest.mark.parametrize("rate", [1000, 2000, 4000])
@pytest.mark.parametrize("poles", [100, 150, 250, 500])
def test_the_linear_loop_is_stable_over_observer_poles_and_rates(rate, poles, specimens):
    observer, gains = AccelerationObserver(ROBOT, poles), pole_placement(ROBOT, START)
    for robot in (ROBOT, *specimens):
        slowest = np.log(closed_loop_poles(observer, gains, START, 1 / rate, robot)[0]) * rate
        assert slowest.real < -10


@pytest.mark.parametrize(("rate", "poles"), [(1000, 100), (1000, 500), (4000, 100), (4000, 500)])
def test_the_loop_is_stable_in_simulation(rate, poles):
    goal = START + np.radians([5.0, 3.0, 3.0, 0, 0, 0])
    motion = rest_to_rest([START, goal], 0.2, 1 / rate).held(0, 0.8)
    desired = inverse_dynamics(ROBOT, motion)
    observer = AccelerationObserver(ROBOT, poles)
    controller = StateFeedback(ROBOT, desired, pole_placement(ROBOT, START), observer)
    run = simulate(SPECIMEN, controller, 1.0, rate, q=START, feedback=observer, substeps=4000 // rate)
    speed = np.abs(run.truth["dq"])
    assert speed[-rate // 10 :].max() < 0.01 * speed.max()
    assert np.abs(run.truth["q"][-1] - goal).max() < 2e-3


def test_a_loop_that_an_observer_is_too_slow_for_is_refused():
    desired = inverse_dynamics(ROBOT, rest_to_rest([START, START], 0.01, 5e-4))
    gains = pole_placement(ROBOT, START, rigid=50.0)
    StateFeedback(ROBOT, desired, gains, AccelerationObserver(ROBOT, 250.0))
    with pytest.raises(EstimatorError, match="a faster observer"):
        StateFeedback(ROBOT, desired, gains, AccelerationObserver(ROBOT, 100.0))


def test_torque_is_the_feedforward_where_the_estimate_is_as_desired():
    desired = inverse_dynamics(ROBOT, rest_to_rest([START, START + 0.01], 0.1, 5e-4))
    controller = StateFeedback(ROBOT, desired, pole_placement(ROBOT, START))
    rest = np.zeros(6)
    torque = controller.step(theta=desired.theta[0], acceleration=ROBOT.specific_force(START, rest, rest))
    assert np.abs(torque - desired.tau[0]).max() < 1e-9 * np.abs(desired.tau[0]).max()


def test_the_simulator_runs_the_same_law_and_observer():
    desired = inverse_dynamics(ROBOT, rest_to_rest([START, START + 0.02], 0.1, 5e-4))
    controller = StateFeedback(ROBOT, desired, pole_placement(ROBOT, START))
    run = simulate(SPECIMEN, controller, 0.15, 2000, q=START, feedback=controller.observer, substeps=2)
    assert run.log.tau is not None
    for theta, acceleration, tau in zip(run.log.theta, run.log.acceleration, run.log.tau, strict=True):
        torque = controller.step(theta=theta, acceleration=acceleration)
        assert np.abs(torque - tau).max() < 1e-6 * np.abs(tau).max()


def test_a_controller_of_another_robot_is_refused_in_simulation():
    desired = inverse_dynamics(ROBOT, rest_to_rest([START, START], 0.01, 1e-3))
    controller = StateFeedback(ROBOT, desired, pole_placement(ROBOT, START))
    with pytest.raises(EstimatorError, match="controller is of 6 joints, expected 2"):
        simulate(one_elastic(1.0), controller, 0.1, 1000)


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
            "slower poles.* or sample faster",
        ),
        (lambda d: StateFeedback(one_elastic(1.0), d, np.zeros((2, 8))), "2 rows or more of 2 joints"),
        (lambda d: pole_placement(ROBOT, START, -3.0), "expected positive frequencies"),
        (lambda d: motor_only(ROBOT, START, 0.0), "expected positive frequencies"),
        (lambda d: pole_placement(ROBOT, START, rigid=0.0), "expected positive frequencies"),
        (lambda d: lqr(ROBOT, START, torque=0.0), "expected positive numbers"),
    ],
)
def test_what_cannot_be_controlled_with_is_refused(call, words):
    desired = inverse_dynamics(ROBOT, rest_to_rest([START, START], 0.01, 1e-3))
    with pytest.raises(EstimatorError, match=words):
        call(desired)
