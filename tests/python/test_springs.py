"""Springs by tables and behind play: their laws, motion by them, and estimates that know of them."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad, solve_ivp
from scipy.interpolate import PchipInterpolator

from linkside import (
    AccelerationObserver,
    ConfigError,
    ElasticJointFilter,
    ElasticJointSmoother,
    EstimatorError,
    ExtendedKalmanFilter,
    ParticleFilter,
    RauchTungStriebelSmoother,
    Robot,
    Sensor,
    simulate,
)
from linkside.control import inverse_dynamics
from linkside.control.controllers import JointPD
from linkside.control.trajectories import rest_to_rest
from linkside.observability import check
from linkside.observability.words import check_words

from .robots import ARM, spring
from .test_elastic_filter import SLIDE

INERTIA, GAP, SLOPE, ROUND = 1.5, 1.8e-3, 0.01, 1e-4
POINTS = {"torsion": [1e-3, 2e-3, 4e-3, 8e-3], "torque": [5.0, 14.0, 40.0, 120.0]}
RATES = {"torque": [10.0, 40.0], "stiffness": [8e3, 1.2e4, 1.8e4]}
PLAY = {"half_gap": GAP, "slope": SLOPE, "rounding": ROUND}


def arm(**drive):
    drives = [spring("shoulder", **drive), spring("elbow", **drive)]
    tip = {"name": "tip", "link": "hand", "xyz": [0.1, 0, 0.3], "noise_std": 0.02}
    return Robot.from_urdf(ARM, drives, accelerometers=[tip], encoder={"resolution": 1e-6})


def table(points, **settings):
    return {"stiffness": None, "stiffness_table": points | settings}


def torque(robot, torsion):
    """Of the shoulder's spring, from what its motor does alone."""
    zero, torsion = np.zeros((len(torsion), 2)), np.asarray(torsion)
    theta = np.column_stack([torsion, 0 * torsion])
    return -INERTIA * robot.forward_dynamics(zero, zero, theta, zero, zero)[1][:, 0]


def odd(law):
    return lambda x: np.sign(x) * law(np.abs(x))


def spline(x):
    """SciPy's, with the straight line that ours has beyond the last point."""
    torsion, load = np.array([0.0, *POINTS["torsion"]]), np.array([0.0, *POINTS["torque"]])
    both = PchipInterpolator(np.append(-torsion[:0:-1], torsion), np.append(-load[:0:-1], load))
    beyond = load[-1] + both.derivative()(torsion[-1]) * (np.abs(x) - torsion[-1])
    return np.where(np.abs(x) <= torsion[-1], both(np.clip(x, -torsion[-1], torsion[-1])), np.sign(x) * beyond)


def lines(x):
    """The last point is so far out that the line goes on."""
    return np.interp(x, [0.0, *POINTS["torsion"], 24e-3], [0.0, *POINTS["torque"], 440.0])


def rates(x):
    (t1, t2), (k1, k2, k3) = RATES["torque"], RATES["stiffness"]
    d1, d2 = t1 / k1, t1 / k1 + (t2 - t1) / k2
    return np.where(x < d1, k1 * x, np.where(x < d2, t1 + k2 * (x - d1), t2 + k3 * (x - d2)))


def engaged(x):
    root = [np.sqrt((x + a) ** 2 + ROUND**2) for a in (GAP, -GAP)]
    return x - (1 - SLOPE) * 0.5 * (root[0] - root[1])


LAWS = {
    "spline": (table(POINTS), spline, 0.02),
    "lines": (table(POINTS, interpolation="linear"), odd(lines), 8e-3),
    "rates": (table(RATES), odd(rates), 0.05),
    "play": ({"backlash": PLAY}, lambda x: 1e4 * engaged(x), 0.02),
    "play before a spline": (table(POINTS) | {"backlash": PLAY}, lambda x: spline(engaged(x)), 9e-3),
}


@pytest.mark.parametrize("law", LAWS)
def test_springs_are_as_declared(law):
    settings, expected, most = LAWS[law]
    torsion = np.linspace(-most, most, 401)
    assert_allclose(torque(arm(**settings), torsion), expected(torsion), rtol=1e-11, atol=1e-11)


def test_a_table_of_both_directions_need_not_be_odd():
    points = {"torsion": [-2e-3, 0.0, 1e-3], "torque": [-50.0, 0.0, 9.0], "interpolation": "linear"}
    assert_allclose(torque(arm(**table(points)), [-1e-3, 5e-4, 2e-3]), [-25.0, 4.5, 18.0], rtol=1e-12)


@pytest.mark.parametrize("law", LAWS)
def test_a_cart_moves_as_scipy_says(law):
    """A cart of 30 kg and its motor, pushed back and forth through the spring's range."""
    settings, expected, most = LAWS[law]
    robot = Robot.from_urdf(SLIDE, [spring("x", **settings)], gravity=[0, 0, 0])
    period, times = 1e-3, np.arange(301) * 1e-3
    push = 2.0 * float(expected(np.array([0.5 * most]))[0]) * np.sin(40 * times)

    def rate(t, x, force):
        q, dq, theta, dtheta = x
        load = float(expected(np.array([theta - q]))[0]) + 5.0 * (dtheta - dq)
        return [dq, load / 30.0, dtheta, (force - load) / INERTIA]

    x, reference = np.zeros(4), [np.zeros(4)]
    for force in push[:-1]:
        x = solve_ivp(rate, (0, period), x, "DOP853", rtol=1e-9, atol=1e-13, args=(force,)).y[:, -1]
        reference.append(x)
    for steps in ({"substeps": 20}, {"integrator": "adaptive", "rtol": 1e-10, "atol": 1e-12}):
        start = {"q": [0], "theta": [0], "tau": [0]}
        truth = simulate(robot, lambda t, state: push[[round(t / period)]], 0.3, 1000.0, **start, **steps).truth
        ours = np.column_stack([truth[k][:, 0] for k in ("q", "dq", "theta", "dtheta")])
        assert np.abs(ours[:, 2] - ours[:, 0]).max() > 0.3 * most
        assert_allclose(ours, reference, atol=1e-6 * np.abs(ours).max())


@pytest.mark.parametrize("law", LAWS)
def test_a_free_arm_keeps_its_energy(law):
    settings, expected, _ = LAWS[law]
    robot = arm(**settings, damping=0.0)
    truth = simulate(
        robot, lambda t, state: np.zeros(2), 0.5, 2000.0, q=[0.3, -0.4], dq=[1.0, -2.0], tau=[0, 0], substeps=20
    ).truth
    chosen, total = slice(None, None, 40), []
    edges = np.array([*POINTS["torsion"], GAP, 10 / 8e3, 10 / 8e3 + 30 / 1.2e4])
    for q, dq, theta, dtheta in zip(*(truth[k][chosen] for k in ("q", "dq", "theta", "dtheta")), strict=True):
        stored = sum(
            quad(
                lambda x: float(expected(np.array([x]))[0]), 0, x, points=np.sort(np.append(edges, -edges)), limit=200
            )[0]
            for x in theta - q
        )
        height = 9.81 * (3 * 0.2 * np.cos(q[0]) + 2 * (0.5 * np.cos(q[0]) + 0.2 * np.cos(q.sum())))
        total.append(0.5 * dq @ robot.mass_matrix(q) @ dq + 0.5 * INERTIA * dtheta @ dtheta + stored + height)
    assert np.ptp(total) < 1e-6 * np.ptp(0.5 * INERTIA * truth["dtheta"] ** 2)


METHODS = {
    "EKF": lambda robot: ExtendedKalmanFilter(robot),
    "smoother": lambda robot: RauchTungStriebelSmoother(robot),
    "elastic filter": lambda robot: ElasticJointFilter(robot, motor_torque="held"),
    "elastic smoother": lambda robot: ElasticJointSmoother(robot, motor_torque="held"),
    "observer": lambda robot: AccelerationObserver(robot),
    "particles": lambda robot: ParticleFilter(robot, particles=200),
}

KALMAN = {name: method for name, method in METHODS.items() if name != "observer"}


def errors(true, told, methods=METHODS, seed=3, duration=1.5):
    """Root mean square of the links' errors after the start [rad], by method."""
    times = np.linspace(0, duration, 151)
    phase = times[:, None] * [5.0, 7.0]
    reference = [1.2, -0.3] * np.sin(phase) ** 2
    control = JointPD(kp=3e3, kd=150.0, times=times, theta=reference)
    sensors = {"theta": Sensor(noise=1e-6), "acceleration": Sensor(noise=0.02)}
    run = simulate(true, control, duration, 1000.0, sensors=sensors, substeps=10, seed=seed)
    truth = run.truth["q"]
    return {
        name: np.sqrt(np.mean((method(told).run(run.log).q - truth)[200:] ** 2)) for name, method in methods.items()
    }


@pytest.mark.parametrize("law", ["spline", "rates"])
def test_estimates_know_the_table_that_robot_yaml_declares(law):
    true = arm(**LAWS[law][0])
    plain = arm(stiffness=true.drives[0].stiffness)
    right, wrong, clean = errors(true, true), errors(true, plain, KALMAN), errors(plain, plain)
    for method in KALMAN:
        assert wrong[method] > 100 * right[method], method
    for method in METHODS:
        assert right[method] < 2 * clean[method], method


def test_estimates_know_the_play_that_robot_yaml_declares():
    """In the gap accelerometers tell where a link is, not as well as a motor behind a spring, far better than it."""
    true, plain = arm(backlash=PLAY), arm()
    right, wrong = errors(true, true, KALMAN), errors(true, plain, KALMAN)
    for method in KALMAN:
        assert wrong[method] > (10 if method in ("EKF", "smoother", "particles") else 100) * right[method], method
        assert wrong[method] > 0.5 * GAP, method
    with pytest.raises(EstimatorError, match="'shoulder', 'elbow' backlash, which the acceleration-driven observer"):
        AccelerationObserver(true)


@pytest.mark.parametrize("law", ["spline", "play", "play before a spline"])
def test_inverse_dynamics_twists_the_spring_as_declared(law):
    settings, expected, _ = LAWS[law]
    robot = arm(**settings, damping=0.0)
    desired = inverse_dynamics(robot, rest_to_rest([[0.2, 0.1], [0.7, 0.5]], 0.5, 1e-3, degree=13))
    load = robot.inverse_dynamics(desired.q, desired.dq, desired.ddq)
    assert_allclose(expected(desired.theta - desired.q), load, atol=1e-7 * np.abs(load).max())


@pytest.mark.parametrize(
    ("drive", "expected"),
    [
        ({"stiffness": None, "stiffness_table": {"torque": [1.0]}}, "expected either 'stiffness'"),
        (table({"torque": [1.0, 2.0], "stiffness": [1.0, 2.0]}), "expected 3 numbers, got 2"),
        (table({"torque": [2.0, 1.0], "torsion": [1.0, 2.0]}), "rise from point to point"),
        (table({"torque": [-1.0, 1.0], "torsion": [-1.0, 2.0]}), "torque 0 at torsion 0"),
        ({"stiffness_table": RATES}, "expected no stiffness beside a table"),
        (table(RATES) | {"cubic_stiffness": 1.0}, "neither cubic_stiffness nor soft_windup"),
        ({"backlash": {"half_gap": 1e-3, "slope": 1.0}}, "slope"),
        ({"backlash": {"half_gap": -1e-3}}, "half_gap"),
    ],
)
def test_springs_that_are_none_are_refused_with_their_key(drive, expected):
    with pytest.raises(ConfigError, match=expected):
        arm(**drive)


def test_a_robot_with_a_table_is_written_and_read_back():
    robot = arm(**table(RATES))
    again = Robot.from_urdf(ARM, **robot.config.model_dump(exclude={"urdf"}))
    assert again.drives == robot.drives
    assert robot.drives[0].stiffness == pytest.approx(20.0 / (10 / 8e3 + 10 / 1.2e4))


def test_check_says_that_a_joint_has_play():
    words = list(check_words(check(arm(backlash=PLAY))))
    assert sum("has play: within 1.8 mrad to either side" in word for word in words) == 2
    assert not any("play" in word for word in check_words(check(arm())))
