"""Poles of the sampled loop: where control and estimation separate, where they do not, and in simulation."""

import numpy as np
import pytest
from scipy.linalg import expm

from linkside import AccelerationObserver, EstimatorError, Robot, Sensor, simulate
from linkside.control import inverse_dynamics
from linkside.control.closed_loop import closed_loop_poles
from linkside.control.feedback import StateFeedback, linearised, motor_only, pole_placement
from linkside.control.trajectories import rest_to_rest
from linkside.observers.poles import damped

from .robots import ARM, spring

SENSOR = {"name": "imu", "link": "fore", "xyz": [0.1, 0.0, 0.3]}
Q = [0.2, 0.7]


def arm(gravity=(0, 0, -9.81), **settings):
    drives = [spring(name, stiffness=3000.0, damping=8.0, motor_inertia=2.0) for name in ("shoulder", "elbow")]
    return Robot.from_urdf(ARM, drives, gravity=list(gravity), accelerometers=[SENSOR], **settings)


def near(found, expected):
    """Largest distance of an expected pole to the nearest that was found."""
    return np.abs(found[:, None] - expected).min(axis=0).max()


@pytest.mark.parametrize("form", ["current", "predictor"])
@pytest.mark.parametrize("bias", [False, True])
@pytest.mark.parametrize("coupling", [{}, {"shoulder": {"elbow": 0.3}}])
def test_estimation_and_control_separate_where_parameters_and_accelerations_are_exact(form, bias, coupling):
    robot, h = arm(gravity=(0, 0, 0), coupling=coupling), 1e-4
    observer = AccelerationObserver(robot, 100.0, form=form, bias=bias, period=h)
    gains = pole_placement(robot, Q, 10.0)
    found = closed_loop_poles(observer, gains, Q, h)
    a, b = linearised(robot, Q)
    both = expm(h * np.block([[a, b], [np.zeros((2, 10))]]))
    control = np.linalg.eigvals(both[:8, :8] - both[:8, 8:] @ gains)
    # Between samples the acceleration is not quite a straight line; with coupling it jumps with the torque.
    assert near(found, control) < (0.1 if coupling else 1e-3) * h * 100
    if form == "current" and not (bias and coupling):  # there the joints' equal poles are defective
        assert near(found, np.exp(damped(100).poles(4 + bias) * h)) < (0.1 if coupling else 0.02) * h * 100


def test_a_rigid_joint_is_controlled_through_its_observers_lag():
    rigid = [spring(name, elastic=False, motor_inertia=2.0) for name in ("shoulder", "elbow")]
    robot, h = Robot.from_urdf(ARM, rigid, gravity=[0, 0, 0], accelerometers=[SENSOR]), 1e-5
    mass = robot.mass_matrix(Q) + 2.0 * np.eye(2)
    gains = np.hstack([100.0 * mass, 0 * mass, 18.0 * mass, 0 * mass])
    found = np.log(closed_loop_poles(AccelerationObserver(robot, 40.0, period=h), gains, Q, h)[:10]) / h
    c = np.poly(damped(40.0).poles(3)).real[1:]
    loop = np.zeros((5, 5))
    loop[0, 1] = loop[2, 3] = loop[3, 4] = 1.0
    loop[1, 2:4] = -100.0, -18.0
    loop[2:, 0] += c
    loop[2:, 2] -= c
    assert near(found, np.linalg.eigvals(loop)) < 0.02


@pytest.mark.parametrize(("design", "frequency"), [(pole_placement, 10.0), (motor_only, 30.0)])
def test_the_slowest_pole_is_that_of_the_simulated_loop(design, frequency):
    drives = [spring("shoulder", stiffness=3000.0, damping=8.0, motor_inertia=2.0), spring("elbow", elastic=False)]
    robot = Robot.from_urdf(ARM, drives, accelerometers=[SENSOR])
    specimen, rate = robot.scaled(stiffness=0.9, mass=1.1), 500.0
    gains = design(robot, Q, frequency, rigid=40.0)
    observer = AccelerationObserver(robot, 200.0)
    desired = inverse_dynamics(robot, rest_to_rest([Q, Q], 0.01, 1 / rate))
    controller = StateFeedback(robot, desired, gains, observer)
    exact = {"theta": Sensor(), "acceleration": Sensor()}
    feedback = {"feedback": observer, "sensors": exact, "substeps": 8}
    run = simulate(specimen, controller, 1.2, rate, q=[0.201, 0.699], **feedback)
    pole = closed_loop_poles(observer, gains, Q, 1 / rate, specimen)[0]
    q = run.truth["q"][300:, 0]
    # Two poles obey y₊₊ = s y₊ − p y + constant; the others have died away.
    system = np.column_stack([q[1:-1], q[:-2], np.ones(len(q) - 2)])
    fit = np.linalg.lstsq(system, q[2:], rcond=None)[0]
    roots = np.roots([1.0, -fit[0], -fit[1]])
    assert np.abs(roots - pole).min() < 0.02 * abs(np.log(pole))


def test_damping_keeps_the_loop_stable_where_a_sensor_hardly_sees():
    """Stretched out, the sensor is in line with both axes: gravity would be taken for huge accelerations."""
    drives = [spring(name, stiffness=3000.0, damping=8.0, motor_inertia=2.0) for name in ("shoulder", "elbow")]
    robot = Robot.from_urdf(ARM, drives, accelerometers=[SENSOR | {"xyz": [0.0, 0.0, 0.3]}])
    q = [0.2, 1e-7]
    gains = pole_placement(robot, q, 10.0)
    damped_there, not_damped = (
        closed_loop_poles(AccelerationObserver(robot, 100.0, worst_acceleration_std=std), gains, q, 1e-3)
        for std in (10.0, 1e9)
    )
    assert abs(damped_there[0]) < 1 < abs(not_damped[0])


def test_other_joints_are_refused():
    robot = arm()
    with pytest.raises(EstimatorError, match=r"expected gains \(2, 8\) and a specimen of 2 joints"):
        closed_loop_poles(AccelerationObserver(robot), np.zeros((2, 2)), Q, 1e-3)
