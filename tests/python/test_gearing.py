"""Gears that several motors share, and joints that linkages move: against printed equations and another simulator."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from pyarrow.csv import read_csv
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
    simulate,
)
from linkside.observability.elements import element_words
from linkside.observability.sensors import acceleration_map

from .robots import ARM, spring
from .transmissions import Gear, move, tool_error

TIP = {"name": "tip", "link": "hand", "xyz": [0.1, 0, 0.3], "noise_std": 0.02}
SHARED = {"elbow": {"shoulder": -0.35}}
DIFFERENTIAL = {"shoulder": {"shoulder": 0.5, "elbow": 0.5}, "elbow": {"shoulder": 0.5, "elbow": -0.5}}
MATRICES = {"shared": np.array([[1, 0], [-0.35, 1]]), "differential": np.array([[0.5, 0.5], [0.5, -0.5]])}


def arm(gearing=None, **drive):
    inertias = {"shoulder": 1.5, "elbow": 0.6}
    drives = [spring(name, **drive) | {"motor_inertia": inertia} for name, inertia in inertias.items()]
    return Robot.from_urdf(
        ARM,
        drives,
        accelerometers=[TIP],
        encoder={"resolution": 1e-6},
        torque={"noise_std": 1e-3},
        tool={"link": "hand", "xyz": [0, 0, 0.2]},
        gearing=gearing or {},
    )


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.floats(-2, 2), min_size=4, max_size=4),
    st.lists(st.floats(-1, 1), min_size=10, max_size=10),
)
def test_accelerations_are_those_of_motors_with_inertia_and_friction_of_their_own(entries, state):
    """Lagrange's equations in the motors' coordinates, B diagonal there."""
    shares = np.reshape(entries, (2, 2))
    if np.linalg.cond(shares) > 20:
        return
    names = ("shoulder", "elbow")
    gearing = {row: dict(zip(names, map(float, shares[i]), strict=True)) for i, row in enumerate(names)}
    robot = arm(gearing, motor_friction={"viscous": 3.0, "coulomb": 2.0, "asymmetry": 0.5})
    plain = arm(motor_friction={"viscous": 3.0, "coulomb": 2.0, "asymmetry": 0.5})
    q, dq, motors, speeds, torques = np.reshape(state, (5, 2)) * [[1], [1], [1e-3], [1], [10]]
    motors = np.linalg.solve(shares, q) + motors
    load = 1e4 * (shares @ motors - q) + 5.0 * (shares @ speeds - dq)
    ddq = np.linalg.solve(
        robot.mass_matrix(q), load - robot.inverse_dynamics(q, dq, np.zeros(2)) - robot.link_friction(dq)
    )
    ddmotors = (torques - plain.motor_friction(speeds) - shares.T @ load) / [1.5, 0.6]
    tau = np.linalg.solve(shares.T, torques)
    found = robot.forward_dynamics(q, dq, shares @ motors, shares @ speeds, tau)
    assert_allclose(found[0], ddq, rtol=1e-9, atol=1e-9)
    assert_allclose(found[1], shares @ ddmotors, rtol=1e-9, atol=1e-9 * np.abs(ddmotors).max())


@pytest.mark.parametrize("name", MATRICES)
def test_logs_of_motors_are_read_as_joints_and_written_as_motors(name):
    robot, shares = arm({"shared": SHARED, "differential": DIFFERENTIAL}[name]), MATRICES[name]
    assert_allclose(robot.gearing, shares)
    rng = np.random.default_rng(3)
    motors, speeds, torques = rng.standard_normal((3, 8, 2))
    motors[5, 0] = np.nan
    columns = {"t": np.arange(8) * 1e-3}
    for signal, values in (("theta", motors), ("dtheta", speeds), ("tau", torques)):
        columns |= {f"{signal}_{joint}": values[:, j] for j, joint in enumerate(robot.names)}
    log = Log.from_table(columns, robot, check=False)
    assert_allclose(log.theta[:5], motors[:5] @ shares.T, atol=1e-14)
    assert_allclose((log.tau * log.dtheta).sum(axis=1), (torques * speeds).sum(axis=1), atol=1e-12)
    depends = shares[:, 0] != 0
    assert_allclose(np.isnan(log.theta[5]), depends)


def test_a_simulated_log_is_of_the_motors(tmp_path):
    robot = arm(DIFFERENTIAL)
    run = simulate(robot, lambda t, state: np.array([3.0, -2.0]), 0.05, 1000.0, substeps=4)
    run.write(tmp_path, suffix=".csv")
    table = read_csv(tmp_path / "log.csv").to_pydict()
    shoulder, elbow = run.truth["theta"].T
    assert_allclose(table["theta_shoulder"], shoulder + elbow, atol=3e-6)
    assert_allclose(table["theta_elbow"], shoulder - elbow, atol=3e-6)
    assert_allclose(Log.read(tmp_path / "log.csv", robot).theta, run.log.theta, atol=1e-12)


def reference(t):
    phase = np.array([3.0, 3.7]) * t
    return [0.6, -0.4] * np.sin(phase) ** 2, [0.6, -0.4] * np.sin(2 * phase) * [3.0, 3.7]


@pytest.fixture(scope="module")
def motions():
    """Of a simulator that shares no code with ours, behind plain gears and behind shared ones."""
    gears = [Gear(1e4, 5.0, 1.5), Gear(1e4, 5.0, 0.6)]
    return {name: move(arm(), gears, reference, 0.9, shares=MATRICES.get(name)) for name in ("plain", "shared")}


METHODS = {
    "EKF": ExtendedKalmanFilter,
    "smoother": RauchTungStriebelSmoother,
    "elastic filter": ElasticJointFilter,
    "elastic smoother": ElasticJointSmoother,
    "motor filter": MotorJerkFilter,
    "motor filter with torques": lambda robot: MotorJerkFilter(robot, tau=True),
    "motor smoother": MotorJerkSmoother,
    "particles": lambda robot: ParticleFilter(robot, particles=100),
}


@pytest.mark.parametrize("method", METHODS)
def test_estimates_know_the_gears_that_motors_share(motions, method):
    def error(motion, robot):
        estimate = METHODS[method](robot).run(motions[motion].log(robot, 1e-6, 0.02))
        return tool_error(estimate, motions[motion])

    clean, known = error("plain", arm()), error("shared", arm(SHARED))
    assert known < 2 * clean, (known, clean)
    assert error("shared", arm()) > 100 * known


@pytest.mark.parametrize("integrator", ["fixed", "adaptive"])
def test_an_arm_moves_as_scipy_says(integrator):
    """Torques held between samples, on motors with friction of their own, under Lagrange's equations."""
    robot, friction = arm(DIFFERENTIAL, motor_friction={"viscous": 3.0}), np.array([3.0, 3.0])
    shares, rest, period, count = MATRICES["differential"], robot.gravity_torque(np.zeros(2)), 1e-3, 80
    torques = shares.T @ rest + 8 * np.sin(np.arange(count)[:, None] * [0.05, 0.08])

    def rate(t, x, torque):
        q, dq, motors, speeds = x.reshape(4, 2)
        load = 1e4 * (shares @ motors - q) + 5.0 * (shares @ speeds - dq)
        ddq = np.linalg.solve(robot.mass_matrix(q), load - robot.inverse_dynamics(q, dq, np.zeros(2)))
        return np.concatenate([dq, ddq, speeds, (torque - friction * speeds - shares.T @ load) / [1.5, 0.6]])

    steps = {"substeps": 10} if integrator == "fixed" else {"integrator": "adaptive", "rtol": 1e-9, "atol": 1e-12}
    held = np.linalg.solve(shares.T, torques.T).T
    start = {"q": [0, 0], "theta": rest / 1e4, "tau": held[0]}
    run = simulate(
        robot, lambda t, state: held[min(round(t / period), count - 1)], count * period, 1 / period, **start, **steps
    )
    x, reference = np.concatenate([np.zeros(4), np.linalg.solve(shares, rest / 1e4), np.zeros(2)]), []
    for torque in torques:
        x = solve_ivp(rate, (0, period), x, "DOP853", rtol=1e-9, atol=1e-12, args=(torque,)).y[:, -1]
        reference.append(x)
    expected = np.array(reference).reshape(count, 4, 2)
    assert_allclose(run.truth["q"][1:], expected[:, 0], atol=1e-9)
    assert_allclose(run.truth["theta"][1:], expected[:, 2] @ shares.T, atol=1e-9)


@pytest.mark.parametrize(
    ("gearing", "expected"),
    [
        ({"elbow": {"wrist": 0.1}}, "gearing.elbow.wrist: expected a joint"),
        ({"elbow": {"shoulder": 1.0}, "shoulder": {"elbow": 1.0}}, "the matrix has no inverse"),
    ],
)
def test_gearings_that_are_none_are_refused_with_their_key(gearing, expected):
    with pytest.raises(ConfigError, match=expected):
        arm(gearing)


@pytest.mark.parametrize(
    ("drive", "expected"),
    [
        ({"elastic": False}, "expected a joint with a motor and a spring"),
        ({"motor_friction": {"load": 0.1}}, "expected neither load nor efficiency"),
        ({"gear_ratio": 100, "ripple": [{"order": 2, "amplitude": 1e-5}]}, "expected no harmonics"),
    ],
)
def test_gears_that_cannot_be_shared_are_refused(drive, expected):
    with pytest.raises(ConfigError, match=expected):
        arm(SHARED, **drive)


def test_observers_refuse_shared_gears():
    with pytest.raises(EstimatorError, match="'elbow' gearing, which the acceleration-driven observer"):
        AccelerationObserver(arm(SHARED)).run(None)


PARALLEL = """<robot name="parallel">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0.1 0 0.4"/><mass value="3"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.01"/></inertial></link>
  <link name="carrier"><inertial><origin xyz="0.05 0.02 0.03"/><mass value="0.7"/>
    <inertia ixx="0.012" ixy="0.001" ixz="0" iyy="0.02" iyz="0" izz="0.012"/></inertial></link>
  <link name="fore"><inertial><origin xyz="0.3 0.1 0"/><mass value="2"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.01"/></inertial></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <joint name="rod" type="revolute"><parent link="upper"/><child link="carrier"/><origin xyz="0 0 0.8"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="1" velocity="1"/>MIMIC</joint>
  <joint name="lift" type="revolute"><parent link="carrier"/><child link="fore"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
</robot>"""


def parallel(ratio=-1.0, offset=0.0, mimic="", **settings):
    return Robot.from_urdf(
        PARALLEL.replace("MIMIC", mimic),
        [spring("turn"), spring("lift")],
        accelerometers=[{"name": "tip", "link": "fore", "xyz": [0.5, 0.1, 0.2], "noise_std": 0.02}],
        gyroscopes=[{"name": "gyro", "link": "fore"}],
        tool={"link": "fore", "xyz": [0.6, 0, 0]},
        linkages={"rod": {"follows": "turn", "ratio": ratio, "offset": offset}},
        **settings,
    )


@settings(max_examples=30, deadline=None)
@given(st.floats(-2, 2), st.floats(-1, 1), st.lists(st.floats(-1, 1), min_size=6, max_size=6))
def test_a_linkage_moves_as_a_tree_under_a_constraint(ratio, offset, state):
    """Pinocchio's tree of three joints, q = V p + c: loads Vᵀ τ, derivatives by the chain rule, sensors as they are."""
    import pinocchio as pin

    if abs(ratio) < 0.05:
        return
    robot = parallel(ratio, offset)
    q, dq, ddq = np.reshape(state, (3, 2))
    model, data, to = robot.model, robot.model.createData(), robot.velocity_map
    assert to.shape == (3, 2)
    whole = (robot.to_pinocchio(q), to @ dq, to @ ddq)
    assert_allclose(whole[0], to @ q + [0, offset, 0], atol=1e-14)
    assert_allclose(robot.inverse_dynamics(q, dq, ddq), to.T @ pin.rnea(model, data, *whole), atol=1e-11)
    pin.computeRNEADerivatives(model, data, *whole)
    mass = np.triu(data.M) + np.triu(data.M, 1).T
    expected = (to.T @ data.dtau_dq @ to, to.T @ data.dtau_dv @ to, to.T @ mass @ to)
    for ours, theirs in zip(robot.inverse_dynamics_derivatives(q, dq, ddq), expected, strict=True):
        assert_allclose(ours, theirs, atol=1e-10)
    assert_allclose(robot.mass_matrix(q), expected[2], atol=1e-12)
    coriolis = pin.computeCoriolisMatrix(model, data, *whole[:2])
    assert_allclose(robot.coriolis_matrix(q, dq) @ dq, to.T @ (coriolis @ (to @ dq)), atol=1e-11)
    by_ddq, rest = robot.acceleration_map(q, dq)
    assert_allclose(robot.specific_force(q, dq, ddq), by_ddq @ ddq + rest, atol=1e-11)
    frame = model.getFrameId("fore")
    pin.forwardKinematics(model, data, *whole)
    pin.updateFramePlacements(model, data)
    point = data.oMf[frame].act(np.array([0.6, 0, 0]))
    assert_allclose(robot.tool_position(q), point, atol=1e-12)
    assert_allclose(robot.angular_rate(q, dq), pin.getFrameVelocity(model, data, frame).angular, atol=1e-12)


def test_rods_hold_a_carrier_upright():
    """Of a parallelogram the fore arm's angle is that of its own motor, and the upper arm carries it as a point."""
    robot = parallel()
    q = np.array([0.7, -0.3])
    elbow = 0.8 * np.array([np.sin(0.7), 0, np.cos(0.7)])
    tool = elbow + 0.6 * np.array([np.cos(-0.3), 0, -np.sin(-0.3)])
    assert_allclose(robot.tool_position(q), tool, atol=1e-14)
    torque = robot.gravity_torque(q)
    assert_allclose(torque[1], -9.81 * 2 * 0.3 * np.cos(-0.3), atol=1e-12)


def test_estimates_know_what_linkages_move():
    robot = parallel(encoder={"resolution": 1e-6}, torque={"noise_std": 1e-3})
    goal = lambda t: np.array([0.5, -0.4]) * np.sin(3 * t) ** 2  # noqa: E731 - a law in a word
    hold = robot.gravity_torque(np.zeros(2))

    def servo(t, state):
        return hold + 3e3 * (goal(t) - state.theta) - 150 * state.dtheta

    run = simulate(robot, servo, 1.0, 1000.0, substeps=4, seed=1)
    for method in (ExtendedKalmanFilter, RauchTungStriebelSmoother, ElasticJointFilter, ElasticJointSmoother):
        estimate = method(robot).run(run.log)
        error = np.sqrt(np.mean((estimate.q - run.truth["q"]) ** 2))
        assert error < 2e-5, (method.__name__, error)


def test_a_mimic_is_what_its_linkage_says_or_refused():
    mimic = '<mimic joint="turn" multiplier="-1"/>'
    assert parallel(mimic=mimic).n == 2
    with pytest.raises(ConfigError, match="'rod' is a mimic of 'turn'; list neither, fix it"):
        parallel(ratio=-0.9, mimic=mimic)


@pytest.mark.parametrize(
    ("linkages", "expected"),
    [
        ({"lift": {"follows": "turn"}}, "linkages.lift: expected a joint that is not listed"),
        ({"rod": {"follows": "lifts"}}, "linkages.rod.follows: expected a joint"),
        ({"rods": {"follows": "lift"}}, "no moving joint 'rods'; did you mean 'rod'"),
    ],
)
def test_linkages_that_are_none_are_refused_with_their_key(linkages, expected):
    drives = [spring("turn"), spring("lift")]
    with pytest.raises(ConfigError, match=expected):
        Robot.from_urdf(PARALLEL.replace("MIMIC", ""), drives, linkages=linkages)


def test_check_sees_through_linkages():
    robot, q, dq = parallel(), np.array([0.3, -0.2]), np.array([0.4, 0.9])
    ours, kernel = acceleration_map(robot, q, dq), robot.acceleration_map(q, dq)
    assert_allclose(ours.matrix, kernel[0], atol=1e-12)
    assert_allclose(ours.bias, kernel[1], atol=1e-12)


LINES = {"harmonics": [{"order": 900, "amplitude": 2e-5, "of": "output"}]}
HYSTERESIS = [{"stiffness": 5e3, "limit": 3.0}]


@pytest.mark.parametrize(
    ("declared", "expected"),
    [
        ({"gearing": SHARED}, "elbow is turned by the motors of elbow, shoulder: a reading that one of them lacks"),
        ({"hysteresis": HYSTERESIS}, "until its torsion has changed by some 1.2 mrad, no sensor but a link's encoder"),
        ({"hysteresis": HYSTERESIS}, "up to 300 µrad of the link"),
        (
            {"gear_ratio": 100, "ripple": [{"order": 2, "amplitude": 1e-5}]},
            "shoulder has ripple: nothing is lost by it",
        ),
        ({"encoder_error": LINES}, "shoulder: its motor's encoder has lines of 14.1 µrad RMS whose phase no recording"),
        ({"link_encoder_error": LINES}, "shoulder: its link's encoder has lines of 14.1 µrad RMS"),
        ({"bearing_friction": {"coulomb": 1.0}}, "shoulder has dry friction in its bearing"),
    ],
)
def test_check_says_what_elements_do(declared, expected):
    assert expected in "\n".join(element_words(arm(**declared)))
    assert not list(element_words(arm()))


def test_check_says_what_linkages_do():
    said = "\n".join(element_words(parallel()))
    assert "rod moves with turn: accelerometers behind it see turn through both." in said
