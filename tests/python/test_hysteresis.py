"""Friction inside transmissions: loops as the laws have them, motion by them, and estimates that know of them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from linkside import (
    AccelerationObserver,
    ConfigError,
    ElasticJointFilter,
    ElasticJointSmoother,
    EstimatorError,
    ExtendedKalmanFilter,
    Log,
    MotorJerkFilter,
    MotorJerkSmoother,
    ParticleFilter,
    RauchTungStriebelSmoother,
    Robot,
    Sensor,
    simulate,
)
from linkside.control import inverse_dynamics
from linkside.control.trajectories import rest_to_rest

from .robots import ARM, spring
from .test_elastic_filter import SLIDE
from .transmissions import Gear, force_rate, move, tool_error

TIP = {"name": "tip", "link": "hand", "xyz": [0.1, 0, 0.3], "noise_std": 0.02}
LAWS = {
    "dahl": [{"stiffness": 5e3, "limit": 3.0}],
    "bouc-wen": [{"stiffness": 5e3, "limit": 3.0, "law": "bouc-wen"}],
    "slip": [
        {"stiffness": 4e3, "limit": 1.0, "law": "slip", "rounding": 0.02},
        {"stiffness": 3e3, "limit": 2.0, "law": "slip", "rounding": 0.02},
    ],
}


def arm(**drive):
    drives = [spring(name, **drive) for name in ("shoulder", "elbow")]
    return Robot.from_urdf(
        ARM, drives, accelerometers=[TIP], encoder={"resolution": 1e-6}, tool={"link": "hand", "xyz": [0, 0, 0.2]}
    )


def printed(robot):
    """The laws as printed of what a robot declares."""
    return [[(e.law, e.stiffness, e.limit) for e in drive.hysteresis] for drive in robot.drives]


def loop(law, speed, amplitude=2e-3):
    """Two turns of torsion and friction of a joint whose link hardly moves, its motor led along a sine."""
    heavy = SLIDE.replace('value="30"', 'value="3e9"')
    assert heavy != SLIDE
    robot = Robot.from_urdf(heavy, [spring("x", hysteresis=LAWS[law])], gravity=[0, 0, 0])

    def servo(t, state):
        return 1e5 * (amplitude * np.sin(2 * np.pi * speed * t) - state.theta) - 600 * state.dtheta

    run = simulate(robot, servo, 3 / speed, 1000.0, sensors={"torque": Sensor()}, q=[0], theta=[0], substeps=4)
    torsion, slip = run.truth["theta"] - run.truth["q"], run.truth["dtheta"] - run.truth["dq"]
    return torsion[:, 0], (run.log.torque - 1e4 * torsion - 5.0 * slip)[:, 0]


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("speed", [1.0, 10.0])
def test_loops_depend_on_the_way_and_not_on_its_speed(law, speed):
    """Against the printed laws along the same way, without any time; the area is the energy that a turn takes."""
    torsion, friction = loop(law, speed)
    force, reference = np.zeros(len(LAWS[law])), [0.0]
    for step in np.diff(torsion):
        for _ in range(8):
            rates = [
                force_rate(law, e["stiffness"], e["limit"], f, step / 8) for e, f in zip(LAWS[law], force, strict=True)
            ]
            force = force + rates
        reference.append(force.sum())
    assert_allclose(friction, reference, atol=0.02 * np.ptp(friction))
    turn = slice(-round(1000 / speed) - 1, None)
    width, middle = np.diff(torsion[turn]), friction[turn]
    area = 0.5 * (middle[1:] + middle[:-1]) @ width
    assert area > 0.3 * np.ptp(torsion[turn]) * np.ptp(middle)
    if law == "slip":  # Masing
        reach = np.ptp(torsion[turn]) / 2
        assert area == pytest.approx(
            sum(4 * e["limit"] * (reach - e["limit"] / e["stiffness"]) for e in LAWS[law]), rel=0.02
        )


@pytest.mark.parametrize("law", ["dahl", "bouc-wen"])
@pytest.mark.parametrize("integrator", ["fixed", "adaptive"])
def test_a_cart_moves_as_scipy_says(law, integrator):
    """A cart of 30 kg and its motor, pushed back and forth: a stiff method on the printed law."""
    robot = Robot.from_urdf(SLIDE, [spring("x", hysteresis=LAWS[law])], gravity=[0, 0, 0])
    times, period = np.arange(201) * 1e-3, 1e-3
    push = 30.0 * np.sin(60 * times)

    def rate(t, x, torque):
        q, dq, theta, dtheta, force = x
        load = 1e4 * (theta - q) + 5.0 * (dtheta - dq) + force
        return [dq, load / 30.0, dtheta, (torque - load) / 1.5, force_rate(law, 5e3, 3.0, force, dtheta - dq)]

    steps = {"substeps": 20} if integrator == "fixed" else {"integrator": "adaptive", "rtol": 1e-9, "atol": 1e-12}
    start = {"q": [0], "theta": [0], "tau": [0]}
    truth = simulate(robot, lambda t, state: push[[round(t / period)]], 0.2, 1000.0, **start, **steps).truth
    x, reference = np.zeros(5), [np.zeros(5)]
    for torque in push[:200]:
        x = solve_ivp(rate, (0, period), x, "LSODA", rtol=1e-9, atol=1e-12, args=(torque,)).y[:, -1]
        reference.append(x)
    ours = np.column_stack([truth[k][:, 0] for k in ("q", "dq", "theta", "dtheta")])
    assert_allclose(ours, np.array(reference)[:, :4], atol=2e-5 * np.abs(ours).max())


@settings(max_examples=15, deadline=None)
@given(
    st.sampled_from(["dahl", "bouc-wen", "slip"]),
    st.floats(1e3, 1e4),
    st.floats(0.5, 5.0),
    st.lists(st.floats(-0.3, 0.3), min_size=2, max_size=2),
)
def test_friction_takes_energy_and_never_gives_it(law, stiffness, limit, speed):
    """Of a free arm without damping: kinetic, potential, the spring's, and what elements hold at most."""
    element = {"stiffness": stiffness, "limit": limit, "law": law}
    robot = arm(damping=0.0, hysteresis=[element])
    start = {"q": [0.3, -0.4], "dq": speed, "tau": [0, 0], "substeps": 20}
    truth = simulate(robot, lambda t, state: np.zeros(2), 0.2, 1000.0, **start).truth
    total = []
    for q, dq, theta, dtheta in zip(*(truth[k] for k in ("q", "dq", "theta", "dtheta")), strict=True):
        height = 9.81 * (3 * 0.2 * np.cos(q[0]) + 2 * (0.5 * np.cos(q[0]) + 0.2 * np.cos(q.sum())))
        kinetic = 0.5 * dq @ robot.mass_matrix(q) @ dq + 0.75 * dtheta @ dtheta
        total.append(kinetic + 0.5e4 * (theta - q) @ (theta - q) + height)
    held = 2 * 0.5 * limit**2 / stiffness
    assert np.max(total) <= total[0] + held + 1e-6
    assert np.min(total[100:]) < total[0] + held


KALMAN = {
    "EKF": lambda robot: ExtendedKalmanFilter(robot),
    "smoother": lambda robot: RauchTungStriebelSmoother(robot),
    "elastic filter": lambda robot: ElasticJointFilter(robot),
    "elastic smoother": lambda robot: ElasticJointSmoother(robot),
    "motor filter": lambda robot: MotorJerkFilter(robot),
    "motor smoother": lambda robot: MotorJerkSmoother(robot),
}


def reference(t):
    phase = np.array([3.0, 3.7]) * t
    return [0.6, -0.4] * np.sin(phase) ** 2, [0.6, -0.4] * np.sin(2 * phase) * [3.0, 3.7]


@pytest.fixture(scope="module")
def recordings():
    """Of a simulator that shares no code with ours, without friction in the gears and with it."""
    robots = [arm(), arm(hysteresis=LAWS["dahl"])]
    gears = [[Gear(1e4, 5.0, 1.5, [], elements) for elements in printed(robot)] for robot in robots]
    return {robot: move(robot, own, reference, 1.2) for robot, own in zip(robots, gears, strict=True)}


def test_estimates_know_the_friction_that_robot_yaml_declares(recordings):
    (plain, clean), (sticky, motion) = recordings.items()

    def errors(told, motion):
        log = motion.log(told, 1e-6, 0.02)
        return {name: tool_error(method(told).run(log), motion, 200) for name, method in KALMAN.items()}

    right, wrong, exact = errors(sticky, motion), errors(plain, motion), errors(plain, clean)
    assert all(wrong[method] > 30 * right[method] for method in KALMAN)
    # Where motor torques are not read, nothing shows how far friction elements are.
    told = [method for method in KALMAN if method not in ("smoother", "motor filter", "motor smoother")]
    assert all(right[method] < 2 * exact[method] for method in told), (right, exact)


@pytest.mark.parametrize("method", ["elastic filter", "elastic smoother", "motor filter", "motor smoother"])
def test_elements_that_were_wound_at_the_start_are_within_what_is_said(recordings, method):
    """From the middle of a motion on: taken as relaxed they are uncertain; link encoders tell where they are."""
    sticky, motion = list(recordings.items())[1]
    log = motion.log(sticky, 1e-6, 0.02)[350:750]
    found = KALMAN[method](sticky).run(log)
    assert (np.abs(found.q - motion.q[350:750]) < 3 * found.q_std).all()
    assert (np.abs(found.q - motion.q[350:750])[:20] > 2e-5).any()
    table = log.to_arrow()
    columns = {name: table[name].to_numpy() for name in table.column_names}
    columns |= {f"q_{name}": motion.q[350:750, j] for j, name in enumerate(sticky.names)}
    told = KALMAN[method](sticky).run(Log.from_table(columns, sticky), covariance=True)
    elements = slice(4 * sticky.n, 5 * sticky.n)
    deflection = np.array([row[elements] for row in told.state])
    std = np.sqrt(np.array([np.diag(row)[elements] for row in told.covariance]))
    reach = np.array([drive.hysteresis[0].reach for drive in sticky.drives])
    assert (std[-1] < 0.3 * reach).all()
    assert (np.abs(deflection[0]) > 3 * 0.05 * reach / np.sqrt(3)).any()


def test_estimates_are_as_uncertain_as_they_say(recordings):
    sticky, motion = list(recordings.items())[1]
    for method in KALMAN.values():
        estimate = method(sticky).run(motion.log(sticky, 1e-6, 0.02))
        assert (np.abs(estimate.q - motion.q) < 3 * estimate.q_std).mean() > 0.99
        assert (estimate.status == 0).mean() > 0.99


def test_links_are_no_more_certain_than_the_friction_that_holds_them():
    """At rest nobody sees where elements are: a link may be off by their limits over the stiffness."""
    robot = arm(hysteresis=LAWS["dahl"])
    run = simulate(robot, lambda t, state: robot.gravity_torque(np.array([0.4, 0.3])), 0.2, 1000.0, q=[0.4, 0.3])
    for method in KALMAN.values():
        for start in ("auto", "rest"):
            estimator = type(method(robot))(robot, start=start)
            assert (estimator.run(run.log).q_std[20:, 1] > 0.3 * 3.0 / 1e4 / np.sqrt(3)).all()


def test_a_recording_in_pieces_and_samples_is_as_the_whole(recordings):
    sticky, motion = list(recordings.items())[1]
    log = motion.log(sticky, 1e-6, 0.02)[:300]
    ekf = ExtendedKalmanFilter(sticky, ExtendedKalmanFilter(sticky).noise.updated(jerk=50.0))
    whole, pieces = ekf.run(log), list(ekf.run_pieces([log[:130], log[130:]]))
    assert np.array_equal(whole.q, np.concatenate([piece.q for piece in pieces]))


@pytest.mark.parametrize(
    ("drive", "expected"),
    [
        ({"hysteresis": [{"stiffness": 0, "limit": 1}]}, "stiffness"),
        ({"hysteresis": [{"stiffness": 1.0}]}, "missing key 'limit'"),
        ({"hysteresis": [{"stiffness": 1.0, "limit": 1.0, "law": "coulomb"}]}, "law"),
        ({"hysteresis": [{"stiffness": 1.0, "limit": 1.0, "rounding": 0.5}]}, "the law is dahl, not slip"),
        ({"hysteresis": [{"stiffness": 1.0, "limit": 1.0, "law": "bouc-wen", "beta": 0.4}]}, "beta"),
        ({"hysteresis": LAWS["dahl"], "elastic": False}, "the joint is rigid"),
    ],
)
def test_elements_that_are_none_are_refused_with_their_key(drive, expected):
    with pytest.raises(ConfigError, match=expected):
        arm(**drive)


def test_what_has_no_memory_refuses_friction_elements():
    robot = arm(hysteresis=LAWS["dahl"])
    path = rest_to_rest([[0.0, 0.0], [0.5, 0.4]], 0.2, 1e-3, degree=13)
    for method in (AccelerationObserver, ParticleFilter, lambda robot: inverse_dynamics(robot, path)):
        with pytest.raises(EstimatorError, match="'shoulder', 'elbow' hysteresis, which"):
            method(robot)
