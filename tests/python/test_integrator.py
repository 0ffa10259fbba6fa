"""The adaptive integrator against SciPy on Pinocchio's dynamics, the rigid limit, energy, and its own tolerance."""

import itertools

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from linkside import EstimatorError, NumericalError, Robot, Sensor, simulate

from .processors import outputs
from .robots import ARM, spring

NAMES = ("q", "dq", "theta", "dtheta")
START = {"q": [0.3, -0.4], "dq": [1.0, -2.0], "dtheta": [0.8, -1.5], "tau": [0, 0]}
FRICTION = {
    "motor_friction": {"viscous": 5.0, "coulomb": 2.0, "stribeck": 1.0, "stribeck_velocity": 0.1},
    "link_friction": [0.5, 15.0, 5.0, 2.0, 10.0, 0.5],
}
WINDING = {"cubic_stiffness": 1e6, "soft_windup": {"stiffness": 2e3, "shape": 500.0}}


def arm(stiffness=1e4, **settings):
    drives = [spring(name, **{"stiffness": stiffness, **settings}) for name in ("shoulder", "elbow")]
    return Robot.from_urdf(ARM, drives, coupling={"shoulder": {"elbow": 0.3}})


def push(t, state):
    return [20 * np.sin(9 * t), 8 * np.cos(7 * t)]


def still(t, state):
    return [0.0, 0.0]


def states(run):
    return np.hstack([run.truth[name] for name in NAMES])


class Oracle:
    """The arm in NumPy on Pinocchio's mass matrix and nonlinear effects."""

    def __init__(self, robot):
        self.robot, self.data, self.drives = robot, robot.model.createData(), robot.drives

    def friction(self, dq, dtheta):
        link, motor = np.zeros(2), np.zeros(2)
        for j, drive in enumerate(self.drives):
            g, f = drive.link_friction, drive.motor_friction
            link[j] = (
                g[0] * (np.tanh(g[1] * dq[j]) - np.tanh(g[2] * dq[j])) + g[3] * np.tanh(g[4] * dq[j]) + g[5] * dq[j]
            )
            peak = f.stribeck * np.exp(-((dtheta[j] / f.stribeck_velocity) ** 2)) if f.stribeck else 0.0
            motor[j] = f.viscous * dtheta[j] + (f.coulomb + peak) * dtheta[j] / np.hypot(dtheta[j], 2e-3)
        return link, motor

    def rate(self, t, x, tau):
        q, dq, theta, dtheta = x.reshape(4, 2)
        args = self.robot.model, self.data, self.robot.to_pinocchio(q)
        load = pin.nonLinearEffects(*args, self.robot.velocity_to_pinocchio(dq)).copy()
        mass = pin.crba(*args).copy()
        mass = np.triu(mass) + np.triu(mass, 1).T
        torsion, pull = theta - q, np.zeros(2)
        for j, d in enumerate(self.drives):
            soft = d.soft_windup.stiffness * np.exp(-d.soft_windup.shape * torsion[j] ** 2)
            pull[j] = (d.stiffness - soft + d.cubic_stiffness * torsion[j] ** 2) * torsion[j]
            pull[j] += d.damping * (dtheta[j] - dq[j])
        link, motor = self.friction(dq, dtheta)
        s, b = self.robot.coupling, np.diag([d.motor_inertia for d in self.drives])
        ddx = np.linalg.solve(np.block([[mass, s], [s.T, b]]), np.concatenate([pull - load - link, tau - pull - motor]))
        return np.concatenate([dq, ddx[:2], dtheta, ddx[2:]])

    def run(self, controller, x, times):
        rows = [x]
        for begin, end in itertools.pairwise(times):
            tau = np.asarray(controller(begin, None))
            solution = solve_ivp(self.rate, (begin, end), rows[-1], method="Radau", args=(tau,), rtol=1e-10, atol=1e-12)
            rows.append(solution.y[:, -1])
        return np.array(rows)


@pytest.mark.parametrize(
    "settings", [{**FRICTION, **WINDING}, {"stiffness": 1e6, "damping": 3e3, **FRICTION}], ids=["nonlinear", "stiff"]
)
def test_states_are_those_of_scipy(settings):
    robot = arm(**settings)
    with pytest.raises(EstimatorError, match="or the adaptive integrator"):
        simulate(robot, push, 0.2, 30.0, **START)
    run = simulate(robot, push, 0.2, 30.0, **START, integrator="adaptive", rtol=1e-9, atol=1e-11)
    expected = Oracle(robot).run(push, states(run)[0], run.truth["t"])
    assert np.ptp(expected[:, 0]) > 0.1
    assert_allclose(states(run), expected, atol=2e-8, rtol=0)


def test_a_stiff_arm_moves_as_the_rigid_one():
    drives = [{"name": name, "elastic": False, "motor_inertia": 1.5} for name in ("shoulder", "elbow")]
    rigid = simulate(Robot.from_urdf(ARM, drives), push, 0.5, 1000.0, q=[0.3, 0.4])
    stiff = [spring(d["name"]) | {"stiffness": 1e11, "damping": 1e6} for d in drives]
    elastic = Robot.from_urdf(ARM, stiff)
    with pytest.raises(EstimatorError, match="adaptive"):
        simulate(elastic, push, 0.5, 1000.0, q=[0.3, 0.4])
    run = simulate(elastic, push, 0.5, 1000.0, q=[0.3, 0.4], integrator="adaptive", rtol=1e-7, atol=1e-8)
    assert np.ptp(rigid.truth["q"][:, 0]) > 0.05
    assert_allclose(run.truth["q"], rigid.truth["q"], atol=1e-6)
    assert_allclose(run.truth["dtheta"], rigid.truth["dq"], atol=1e-5)


def energy(robot, truth):
    data, total = robot.model.createData(), []
    for q, dq, theta, dtheta in zip(*(truth[name] for name in NAMES), strict=True):
        args = robot.model, data, robot.to_pinocchio(q)
        links = pin.computePotentialEnergy(*args) + pin.computeKineticEnergy(*args, robot.velocity_to_pinocchio(dq))
        total.append(links + 0.75 * dtheta @ dtheta + 5e3 * (theta - q) @ (theta - q) + dq @ robot.coupling @ dtheta)
    return np.array(total)


def test_a_free_robot_keeps_its_energy():
    robot = arm(damping=0.0)
    run = simulate(robot, still, 2.0, 100.0, **START, integrator="adaptive", rtol=1e-10, atol=1e-12)
    total = energy(robot, run.truth)
    assert_allclose(total, total[0], rtol=1e-7)


def test_errors_are_in_proportion_to_the_tolerance():
    robot = arm(**FRICTION)
    settings = {"duration": 0.3, "rate": 100.0, **START}
    exact = states(simulate(robot, push, **settings, substeps=200))
    errors = []
    for tolerance in 10.0 ** -np.arange(4, 10):
        run = simulate(robot, push, **settings, integrator="adaptive", rtol=tolerance, atol=tolerance)
        errors.append(np.abs(states(run) - exact).max() / tolerance)
    assert max(errors) < 100
    assert max(errors) < 30 * min(errors)
    default = simulate(robot, push, **settings, integrator="adaptive")
    assert np.abs(states(default) - exact).max() < 1e-4


def test_samples_and_ticks_are_on_time():
    """What is read and commanded at a sample does not depend on how many samples there are in between."""
    settings = {**START, "integrator": "adaptive", "rtol": 1e-10, "atol": 1e-12}
    slow = simulate(arm(), lambda t, state: [5.0, -3.0], 0.3, 7.0, **settings)
    fast = simulate(arm(), lambda t, state: [5.0, -3.0], 0.3, 91.0, **settings, sensors={"theta": Sensor()})
    assert_allclose(fast.truth["t"][::13], slow.truth["t"], rtol=1e-15)
    assert_allclose(states(fast)[::13], states(slow), atol=1e-8, rtol=0)
    assert_allclose(fast.log.theta, fast.truth["theta"], rtol=0)


def test_results_do_not_depend_on_the_processors_instructions():
    program = (
        "import hashlib; from linkside import *; r = Robot.load(demo.ROBOT); hold = r.gravity_torque([0.3] * r.n);"
        "run = simulate(r, lambda t, state: 1.1 * hold, 0.1, 500.0, q=[0.3] * r.n, integrator='adaptive');"
        "print(hashlib.sha256(run.truth['q'].tobytes() + run.log.acceleration.tobytes()).hexdigest())"
    )
    assert len(outputs(program)) == 1


def bad(match, error=EstimatorError, robot=None, controller=still, **settings):
    with pytest.raises(error, match=match):
        simulate(robot or arm(), controller, 0.1, 100.0, **settings)


def test_settings_out_of_range():
    bad("integrator is 'euler', expected 'rk4' or 'adaptive'", integrator="euler")
    bad("substeps is 4, but the adaptive", integrator="adaptive", substeps=4)
    bad("rtol is 0.001, but steps of 'rk4' are fixed", rtol=1e-3, substeps=4)
    bad("atol is 0.1, but", atol=0.1, substeps=4)
    for value in (0.0, 1.0, np.nan):
        bad("rtol is", integrator="adaptive", rtol=value)
    for value in (0.0, np.inf, np.nan):
        bad("atol is", integrator="adaptive", atol=value)


def test_a_motion_too_abrupt_names_time_and_joint():
    drives = [spring("shoulder"), spring("elbow", link_friction=[0, 0, 0, 50.0, 1e300, 0])]
    robot = Robot.from_urdf(ARM, drives)
    settings = {"dq": [0, 2.0], "tau": [0, 0], "integrator": "adaptive", "rtol": 1e-13, "atol": 1e-15}
    bad(r"tolerance at t = 0\.\d+ s .* joint 1 is too abrupt", NumericalError, robot, **settings)


def test_a_loop_that_runs_away_names_the_time():
    wild = lambda t, state: 1e3 * state.dtheta + 1e150  # noqa: E731
    bad("not finite at t = 0", NumericalError, controller=wild, integrator="adaptive")
