"""Inverse dynamics of elastic joints against collocation, and against Pinocchio's forward dynamics."""

import numpy as np
import pinocchio as pin
import pytest
from numpy.polynomial import Chebyshev, chebyshev
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline

from linkside import EstimatorError, Robot
from linkside.control import derivative_order, inverse_dynamics
from linkside.control.trajectories import Trajectory, rest_to_rest, spline

from .robots import ARM, spring

POINTS = [[0.2, -0.4], [1.0, 0.2]]
CASES = {
    "undamped": ((0.0, 0.0), 0.0, 4),
    "undamped, coupled": ((0.0, 0.0), 0.4, 6),
    "damped": ((8.0, 6.0), 0.0, 3),
    "damped, coupled": ((8.0, 6.0), 0.4, 4),
    "one damped, coupled": ((0.0, 6.0), 0.4, 5),
}


def arm(damping=(0.0, 0.0), coupling=0.0, **settings):
    joints = [
        spring(name, stiffness=k, damping=d, motor_inertia=b, **settings)
        for name, k, d, b in zip(("shoulder", "elbow"), (3000.0, 2000.0), damping, (2.0, 1.5), strict=True)
    ]
    return Robot.from_urdf(ARM, joints, coupling={"shoulder": {"elbow": coupling}})


def move(period=1e-3, degree=17):
    return rest_to_rest(POINTS, 1.0, period, degree=degree)


@pytest.mark.parametrize("case", CASES)
def test_torque_is_that_of_collocation(case):
    """Links by Pinocchio at Chebyshev nodes, each transmission's equation by collocation, from the outside in."""
    damping, coupling, order = CASES[case]
    robot = arm(damping, coupling)
    assert derivative_order(robot) == order
    motion = move()
    found = inverse_dynamics(robot, motion)
    theta, tau = collocated(robot)
    assert np.abs(found.theta - theta(motion.t)).max() < 1e-10
    assert np.abs(found.tau - tau(motion.t)).max() < 1e-8 * np.abs(found.tau).max()


def collocated(robot, nodes=72):
    """Motor positions and torques as functions of time."""
    t = 0.5 - 0.5 * np.cos(np.pi * np.arange(nodes) / (nodes - 1))
    exact = exactly(t)
    data = robot.model.createData()
    load = np.array([pin.rnea(robot.model, data, *state) for state in zip(*exact, strict=True)])
    vander = chebyshev.chebvander(2 * t - 1, nodes - 1)
    slope = 2 * np.stack([chebyshev.chebval(2 * t - 1, chebyshev.chebder(row)) for row in np.eye(nodes)], axis=1)
    acceleration, theta, tau = np.zeros_like(load), [None, None], [None, None]
    for i, drive in reversed(list(enumerate(robot.drives))):
        r = load[:, i] + acceleration @ robot.coupling[i]
        matrix, right = drive.damping * slope + drive.stiffness * vander, r.copy()
        if drive.damping:  # at rest in the beginning
            matrix[0], right[0] = vander[0], r[0] / drive.stiffness
        torsion = Chebyshev(np.linalg.solve(matrix, right), [0, 1])
        theta[i] = torsion + Chebyshev.fit(t, exact[0][:, i], 17, domain=[0, 1])
        acceleration[:, i] = theta[i].deriv(2)(t)
        tau[i] = drive.motor_inertia * acceleration[:, i] + exact[2] @ robot.coupling[:, i] + r
    torque = [Chebyshev.fit(t, values, nodes - 1, domain=[0, 1]) for values in tau]
    return (lambda s: np.stack([f(s) for f in theta], axis=1)), (lambda s: np.stack([f(s) for f in torque], axis=1))


def exactly(t):
    """Position, velocity and acceleration of the same motion, as SciPy has the incomplete beta function."""
    from scipy.special import beta, betainc

    low, high = np.array(POINTS)
    u, scale = t[:, None], 1 / beta(9, 9)
    rate = scale * u**8 * (1 - u) ** 8
    second = scale * 8 * (u * (1 - u)) ** 7 * (1 - 2 * u)
    return low + (high - low) * betainc(9, 9, u), (high - low) * rate, (high - low) * second


@pytest.mark.parametrize("case", CASES)
def test_torque_alone_makes_the_model_follow(case):
    damping, coupling, _ = CASES[case]
    robot = arm(damping, coupling)
    motion = move()
    found = inverse_dynamics(robot, motion)
    q, theta = integrated(robot, found)
    assert np.abs(q - found.q[::100]).max() < 1e-8
    assert np.abs(theta - found.theta[::100]).max() < 1e-8


def integrated(robot, desired):
    """Positions of links and motors under the desired torque, every 0.1 s, by Pinocchio and SciPy."""
    torque = make_interp_spline(desired.t, desired.tau, k=7)
    data = robot.model.createData()
    damping, inertia = (np.array([getattr(d, name) for d in robot.drives]) for name in ("damping", "motor_inertia"))

    def rate(t, x):
        q, theta, dq, dtheta = x.reshape(4, 2)
        transmitted = elastic(robot, theta - q) + damping * (dtheta - dq)
        mass = pin.crba(robot.model, data, q)
        mass = np.triu(mass) + np.triu(mass, 1).T
        matrix = np.block([[mass, robot.coupling], [robot.coupling.T, np.diag(inertia)]])
        bias = pin.nonLinearEffects(robot.model, data, q, dq) + [d.link_friction[5] for d in robot.drives] * dq
        accelerations = np.linalg.solve(matrix, np.concatenate([transmitted - bias, torque(t) - transmitted]))
        return np.concatenate([dq, dtheta, accelerations])

    start = np.concatenate([desired.q[0], desired.theta[0], desired.dq[0], desired.dtheta[0]])
    times = desired.t[::100]
    tolerances = {"rtol": 1e-10, "atol": 1e-11, "max_step": 5e-3}
    out = solve_ivp(rate, times[[0, -1]], start, "DOP853", times, **tolerances).y.T
    return out[:, :2], out[:, 2:4]


def elastic(robot, torsion):
    return np.array([d.stiffness * x + d.cubic_stiffness * x**3 for d, x in zip(robot.drives, torsion, strict=True)])


@pytest.mark.parametrize("damping", [(0.0, 0.0), (8.0, 6.0)])
def test_hardening_springs_and_friction_of_the_links_are_accounted_for(damping):
    robot = arm(damping, cubic_stiffness=2e6, link_friction=[0, 0, 0, 0, 0, 3.0])
    found = inverse_dynamics(robot, move())
    q, theta = integrated(robot, found)
    assert np.abs(q - found.q[::100]).max() < 1e-8
    assert np.abs(theta - found.theta[::100]).max() < 1e-8
    assert np.abs(found.torsion - inverse_dynamics(arm(damping), move()).torsion).max() > 1e-3


@pytest.mark.parametrize(("case", "degree"), [("undamped", 7), ("damped", 5)])
def test_derivatives_before_the_last_suffice_to_be_continuous(case, degree):
    robot = arm(CASES[case][0])
    found = inverse_dynamics(robot, move(degree=degree))
    assert found.dtheta[0] == pytest.approx(0, abs=1e-12)
    with pytest.raises(EstimatorError, match=rf"continuous up to derivative {degree // 2 - 1}.*degree={degree}"):
        inverse_dynamics(robot, move(degree=degree - 2))


def test_a_motion_that_is_known_too_little_is_refused():
    robot, motion = arm(), move()
    with pytest.raises(EstimatorError, match="given up to derivative 3, this robot's torque needs derivative 4"):
        inverse_dynamics(robot, Trajectory(motion.t, motion.derivatives[:4], 8))
    three = spline([0, 1], [[0, 0, 0], [1, 1, 1]], 0.01)
    with pytest.raises(EstimatorError, match="3 joints, the robot has 2"):
        inverse_dynamics(robot, three)
    bad = motion.derivatives.copy()
    bad[2, 5, 1] = np.nan
    with pytest.raises(EstimatorError, match="a derivative of the motion is NaN"):
        inverse_dynamics(robot, Trajectory(motion.t, bad, 8))


def test_more_derivatives_make_damped_joints_more_exact_between_samples():
    robot, fine = arm((8.0, 6.0)), move(1e-3)
    reference = inverse_dynamics(robot, fine).tau[::10]
    coarse = move(1e-2)

    def error(orders):
        few = Trajectory(coarse.t, np.ascontiguousarray(coarse.derivatives[: orders + 1]), 8)
        return np.abs(inverse_dynamics(robot, few).tau - reference).max()

    assert error(5) < error(4) / 10 < error(3) / 100
