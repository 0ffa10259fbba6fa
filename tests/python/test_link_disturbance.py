"""Disturbance torques of links: pushes, payloads and counterbalances that the model lacks."""

from functools import cache

import numpy as np
import pytest
from scipy import stats
from scipy.linalg import expm

from linkside import (
    ElasticJointFilter,
    ElasticJointSmoother,
    ElasticNoise,
    Estimate,
    EstimatorError,
    ExtendedKalmanFilter,
    FixedLagSmoother,
    Log,
    Noise,
    RauchTungStriebelSmoother,
    Robot,
)
from linkside.control.controllers import JointPD
from linkside.robot.considered import considered
from linkside.simulation.simulator import Sensor, simulate

from .robots import spring

LEG = """<robot name="leg">
  <link name="base"/>
  <link name="thigh"><inertial><origin xyz="0 0 -0.15"/><mass value="3"/>
    <inertia ixx="0.03" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.004"/></inertial></link>
  <link name="shank"><inertial><origin xyz="0 0 -0.12"/><mass value="1"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.002"/></inertial></link>
  <joint name="hip" type="revolute"><parent link="base"/><child link="thigh"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <joint name="knee" type="revolute"><parent link="thigh"/><child link="shank"/><origin xyz="0 0 -0.35"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
</robot>"""
STIFFNESS = np.array([300.0, 400.0])
IMU = [{"name": "imu", "link": "shank", "xyz": [0, 0, -0.25], "noise_std": 0.1, "axes": "xz"}]
TORQUE = {"torque": Sensor(noise=0.3), "dtheta": Sensor(noise=1e-3)}
LINK = {"q": Sensor(noise=1e-5)}
DRIVE = {"damping": 0.5, "motor_inertia": 0.1, "motor_friction": {"viscous": 0.5}}
RATE = 1000.0
METHODS = (ExtendedKalmanFilter, RauchTungStriebelSmoother, ElasticJointFilter, ElasticJointSmoother)


def leg(sensors=()):
    joints = [{"name": name, "stiffness": k, **DRIVE} for name, k in zip(("hip", "knee"), STIFFNESS, strict=True)]
    return Robot.from_urdf(LEG, joints, accelerometers=list(sensors))


def smooth(rng, count, size, fastest=2.0):
    """Torques of these standard deviations, sums of a few sines below ``fastest`` [Hz]."""
    t = np.arange(count) / RATE
    waves = 2 * np.pi * rng.uniform(0.1, fastest, (6, len(size), 1)) * t + rng.uniform(0, 7, (6, len(size), 1))
    torque = np.einsum("kj,kjt->tj", rng.standard_normal((6, len(size))), np.sin(waves))
    return torque * (np.array(size) / torque.std(axis=0))


def moved(robot, push, sensors, seconds=2.0, seed=0, truth=None):
    """A robot whose motors swing while its links are pushed."""
    t = np.arange(round(seconds * RATE) + 1) / RATE
    phase, begun = np.arange(robot.n), np.minimum(t / 0.8, 1)[:, None]
    begun = begun**4 * (35 - 84 * begun + 70 * begun**2 - 20 * begun**3)
    start = 0.3 * (-1.0) ** phase
    path = start + 0.4 * begun * (np.sin(2 * np.pi * 0.7 * t[:, None] + phase) - np.sin(phase))
    law = JointPD(kp=2000.0, kd=60.0, times=t, theta=path)
    more = {"q": start, "push": push, "sensors": sensors, "seed": seed, "substeps": 4}
    return simulate(truth or robot, law, seconds, RATE, **more)


@cache
def pushed_leg(case):
    sensors = {"torque": TORQUE, "link": LINK, "both": TORQUE | LINK, "imu": TORQUE}[case]
    robot = leg(IMU if case == "imu" else ())
    return robot, moved(robot, smooth(np.random.default_rng(1), 2001, [6.0, 2.0]), sensors)


def off(estimate, simulation):
    """Root mean square errors of link positions, and the same in standard deviations (n,)."""
    error = estimate.q - simulation.truth["q"]
    return np.sqrt((error**2).mean(axis=0)), np.sqrt(((error / estimate.q_std) ** 2).mean(axis=0))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("case", ["torque", "link", "both", "imu"])
def test_links_that_are_pushed_are_found(method, case):
    robot, simulation = pushed_leg(case)
    plain = method(robot, link_disturbance=False).run(simulation.log)
    found = method(robot).run(simulation.log)
    (before, _), (after, deviations) = off(plain, simulation), off(found, simulation)
    assert plain.disturbance is None
    assert (after < before / 3).all()
    assert (deviations < 1.3).all()
    assert found.nis.sum() < 1.5 * found.used.sum() < plain.nis.sum()
    torque = found.disturbance - simulation.truth["push"]
    assert (np.sqrt((torque**2).mean(axis=0)) < [1.5, 0.4]).all()
    assert (np.sqrt(((torque / found.disturbance_std) ** 2).mean(axis=0)) < 1.5).all()


def test_torque_readings_pull():
    """Where sensors read the torque, links are at θ − τ/K, and no motion of the links is between them and that."""
    robot, simulation = pushed_leg("torque")
    static = simulation.log.theta - simulation.log.torque / STIFFNESS - simulation.truth["q"]
    static = np.sqrt((static**2).mean(axis=0))
    motors = np.sqrt(((simulation.log.theta - simulation.truth["q"]) ** 2).mean(axis=0))
    filtered, _ = off(ExtendedKalmanFilter(robot).run(simulation.log), simulation)
    smoothed, _ = off(RauchTungStriebelSmoother(robot).run(simulation.log), simulation)
    assert (static < motors / 3).all()
    assert (filtered < 0.7 * static).all()
    assert (smoothed < 0.3 * static).all()


@pytest.mark.parametrize("sensors", [TORQUE, LINK, TORQUE | LINK], ids=["torque", "link", "both"])
@pytest.mark.parametrize("method", [ExtendedKalmanFilter, ElasticJointFilter])
def test_a_model_that_is_right_is_left_alone(method, sensors):
    robot = leg(IMU)
    log = moved(robot, None, sensors).log
    plain, automatic = method(robot, link_disturbance=False).run(log), method(robot).run(log)
    assert automatic.disturbance is None
    np.testing.assert_array_equal(automatic.q, plain.q)


def biased(column):
    return np.where(np.arange(len(column)) < 700, column, column + 5.0)


def turned(column):
    return -column


def dead(column):
    return np.where(np.arange(len(column)) < 700, column, 0.0)


def scaled(column):
    return 1.2 * column


@pytest.mark.parametrize("method", [ExtendedKalmanFilter, ElasticJointFilter])
@pytest.mark.parametrize(
    ("column", "fault"),
    [("torque_hip", biased), ("torque_hip", turned), ("torque_hip", dead), ("q_hip", scaled), ("q_hip", dead)],
)
def test_a_broken_sensor_is_no_push(method, column, fault):
    """A torque that nobody applies would explain it as well, and carry the link away without a word."""
    robot = leg()
    sensors = LINK if column == "q_hip" else TORQUE
    table = dict(moved(robot, None, sensors)._table)
    table[column] = fault(table[column])
    found = method(robot).run(Log.from_table(table, robot, check=False))
    assert found.disturbance is None
    assert found.findings


def test_without_a_sensor_that_tells_it_nothing_is_assumed():
    robot = leg(IMU)
    log = moved(robot, smooth(np.random.default_rng(2), 2001, [6.0, 2.0]), {}).log
    for method in (ExtendedKalmanFilter, ElasticJointFilter):
        found = method(robot).run(log)
        assert found.disturbance is None
        assert found.findings


def test_motor_torques_tell_a_push_where_friction_is_known():
    robot = leg()
    simulation = moved(robot, smooth(np.random.default_rng(3), 2001, [6.0, 2.0]), {})
    before, _ = off(ElasticJointSmoother(robot).run(simulation.log), simulation)
    found = ElasticJointSmoother(robot, link_disturbance=True).run(simulation.log)
    after, deviations = off(found, simulation)
    assert (after < before / 5).all()
    assert (deviations < 1.3).all()


def test_a_counterbalance_that_the_model_lacks():
    """A gas spring between two points beside joint 2, at its own place in each posture; link encoders see it."""
    robot = leg()
    angle = moved(robot, None, LINK).truth["q"][:, 1]
    for _ in range(2):  # the posture depends on the spring, by little
        reach = np.sqrt(0.05**2 + 0.2**2 - 2 * 0.05 * 0.2 * np.cos(angle + 1.0))
        force = 60.0 * (0.2 / (0.2 - (0.25 - reach))) ** 1.2
        push = np.stack([np.zeros_like(force), force * 0.05 * 0.2 * np.sin(angle + 1.0) / reach], axis=1)
        simulation = moved(robot, push, LINK)
        angle = simulation.truth["q"][:, 1]
    assert np.ptp(push[:, 1]) > 2.0
    for method in (ExtendedKalmanFilter, RauchTungStriebelSmoother):
        found = method(robot).run(simulation.log)
        error, deviations = off(found, simulation)
        assert (error < 2e-5).all()
        assert (deviations < 1.3).all()
        torque = found.disturbance - push
        assert (np.sqrt((torque[200:] ** 2).mean(axis=0)) < [0.5, 0.15]).all()


def test_a_payload_that_the_model_lacks():
    robot, loaded = leg(), leg()
    heavier = LEG.replace('mass value="1"', 'mass value="1.6"')
    joints = [{"name": name, "stiffness": k, **DRIVE} for name, k in zip(("hip", "knee"), STIFFNESS, strict=True)]
    loaded = Robot.from_urdf(heavier, joints)
    simulation = moved(robot, None, TORQUE | LINK, truth=loaded)
    before, _ = off(ExtendedKalmanFilter(robot, link_disturbance=False).run(simulation.log), simulation)
    found = ExtendedKalmanFilter(robot).run(simulation.log)
    after, deviations = off(found, simulation)
    truth = simulation.truth
    missing = (robot.inverse_dynamics(*(truth[s] for s in ("q", "dq", "ddq")))) - loaded.inverse_dynamics(
        *(truth[s] for s in ("q", "dq", "ddq"))
    )
    assert found.disturbance is not None
    assert (after <= before).all()
    assert (deviations < 1.3).all()
    assert (np.sqrt(((found.disturbance - missing)[200:] ** 2).mean(axis=0)) < 0.5).all()


def chain(seed, joints):
    """A chain of links of random sizes and masses with soft joints, and an IMU at its end."""
    rng = np.random.default_rng(seed)
    parts, above = ['<robot name="chain"><link name="base"/>'], "base"
    for j in range(joints):
        mass, length, axis = rng.uniform(0.5, 4), rng.uniform(0.2, 0.5), rng.choice(["0 1 0", "1 0 0"])
        inertia = mass * length**2 / 12
        parts.append(
            f'<link name="l{j}"><inertial><origin xyz="0 0 {-length / 2}"/><mass value="{mass}"/><inertia '
            f'ixx="{inertia}" ixy="0" ixz="0" iyy="{inertia}" iyz="0" izz="{0.1 * inertia}"/></inertial></link>'
            f'<joint name="j{j}" type="revolute"><parent link="{above}"/><child link="l{j}"/><axis xyz="{axis}"/>'
            f'<origin xyz="0 0 {-0.3 if j else 0}"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
        )
        above = f"l{j}"
    drives = [{"name": f"j{j}", "stiffness": rng.uniform(300, 2000), **DRIVE} for j in range(joints)]
    return Robot.from_urdf("".join([*parts, "</robot>"]), drives, accelerometers=[IMU[0] | {"link": above}])


@pytest.mark.parametrize(("seed", "joints", "link"), [(40, 2, False), (43, 3, False), (48, 2, True), (51, 3, True)])
def test_random_robots_that_are_pushed(seed, joints, link):
    robot, rng = chain(seed, joints), np.random.default_rng(seed)
    weight = np.abs(robot.gravity_torque(np.full(joints, 0.7))) + 1.0
    push = smooth(rng, 1501, 2 * weight)
    simulation = moved(robot, push, LINK | TORQUE if link else TORQUE, seconds=1.5, seed=seed)
    for method in (ExtendedKalmanFilter, ElasticJointFilter):
        plain = method(robot, link_disturbance=False).run(simulation.log)
        found = method(robot, link_disturbance=True).run(simulation.log)
        (before, _), (after, deviations) = off(plain, simulation), off(found, simulation)
        assert (deviations < 2.0).all()
        assert after.max() < before.max()
        assert found.nis.sum() < 2 * found.used.sum()


WHEEL = """<robot name="wheel"><link name="base"/>
  <link name="disc"><inertial><mass value="2"/>
    <inertia ixx="0.4" ixy="0" ixz="0" iyy="0.4" iyz="0" izz="0.5"/></inertial></link>
  <joint name="axle" type="continuous"><parent link="base"/><child link="disc"/><axis xyz="0 0 1"/></joint>
</robot>"""


def wheel():
    """One joint without gravity: all is linear."""
    return Robot.from_urdf(WHEEL, [spring("axle", stiffness=200.0, damping=0.5, motor_inertia=0.1)])


def recorded(robot, rows=60, seed=5):
    rng = np.random.default_rng(seed)
    t = 2e-3 * np.arange(rows)
    columns = {"theta": 0.1 * np.sin(9 * t), "torque": np.cos(7 * t), "q": 0.1 * np.sin(9 * t - 0.1)}
    table = {"t": t} | {f"{name}_axle": x + 1e-3 * rng.standard_normal(rows) for name, x in columns.items()}
    table["torque_axle"][::3] = np.nan
    return Log.from_table(table | {"tau_axle": 2 * np.sin(5 * t)}, robot, check=False)


def test_filter_and_smoother_are_those_of_linear_algebra():
    """The whole recording as one normal vector: its mean and covariance given all readings, and given those before."""
    robot, std, time, inertia, stiffness = wheel(), 3.0, 0.4, 0.5, 200.0
    log = recorded(robot)
    noise = Noise(
        jerk=50.0,
        torsion=0.0,
        link_disturbance=std,
        link_disturbance_time=time,
        joint_torque=0.2,
        link=1e-3,
        motor_velocity=0.0,
    )
    arguments = {"biases": (), "damping": False, "tolerances": False, "link_disturbance": True}
    h, rows = 2e-3, len(log)
    step = np.array([[1, h, h * h / 2, 0], [0, 1, h, 0], [0, 0, 1, 0], [0, 0, 0, np.exp(-h / time)]])
    jerk = 50.0**2 * np.array(
        [[h**5 / 20, h**4 / 8, h**3 / 6], [h**4 / 8, h**3 / 3, h**2 / 2], [h**3 / 6, h**2 / 2, h]]
    )
    driven = np.zeros((4, 4))
    driven[:3, :3], driven[3, 3] = jerk, -np.expm1(-2 * h / time) * std**2
    start = np.diag([1e-4**2 + (std / stiffness) ** 2, 1e-3**2, 0.1**2, std**2])
    start[0, 3] = start[3, 0] = std**2 / stiffness
    read = np.array([[1, 0, inertia / stiffness, -1 / stiffness], [1, 0, 0, 0], [0, 0, inertia, -1]])
    spread = np.array([np.hypot(1e-5, robot.config.encoder.resolution / np.sqrt(12)), 1e-3, 0.2]) ** 2
    prior, whole = np.zeros((4 * rows, 4 * rows)), start
    for k in range(rows):
        own = slice(4 * k, 4 * k + 4)
        prior[own, own] = whole
        for later in range(k + 1, rows):
            at = slice(4 * later, 4 * later + 4)
            prior[at, own] = step @ prior[4 * later - 4 : 4 * later, own]
            prior[own, at] = prior[at, own].T
        whole = step @ whole @ step.T + driven
    mean = np.zeros(4 * rows)
    mean[0::4] = log.theta[0, 0]
    readings = np.stack([log.theta[:, 0], log.q[:, 0], log.torque[:, 0]], axis=1)

    def given_rows(count):
        h_all = np.kron(np.eye(rows)[:count], read)
        y, r = readings[:count].ravel(), np.tile(spread, count)
        there = np.isfinite(y)
        h_all, y, r = h_all[there], y[there], r[there]
        gain = np.linalg.solve(h_all @ prior @ h_all.T + np.diag(r), h_all @ prior).T
        return mean + gain @ (y - h_all @ mean), prior - gain @ h_all @ prior

    smoothed = RauchTungStriebelSmoother(robot, noise, start="rest", **arguments).run(log, covariance=True)
    filtered = ExtendedKalmanFilter(robot, noise, start="rest", **arguments).run(log, covariance=True)
    x, p = given_rows(rows)
    for k in (0, 20, rows - 1):
        own = slice(4 * k, 4 * k + 4)
        for estimate, (xk, pk) in ((smoothed, (x, p)), (filtered, given_rows(k + 1))):
            scale = np.sqrt(np.diag(pk[own, own]))
            assert (np.abs(estimate.state[k] - xk[own]) < 1e-5 * scale).all()
            assert (np.abs(estimate.covariance[k] - pk[own, own]) < 1e-5 * np.outer(scale, scale)).all()
            np.testing.assert_allclose(estimate.disturbance[k, 0], estimate.state[k, 3])
            np.testing.assert_allclose(estimate.disturbance_std[k, 0], np.sqrt(estimate.covariance[k, 3, 3]))


def test_the_elastic_filter_is_that_of_linear_algebra():
    robot, std, time = wheel(), 3.0, 0.4
    log = recorded(robot)
    noise = ElasticNoise(link_disturbance=std, link_disturbance_time=time, joint_torque=0.2, link=1e-3, torque=0.0)
    settings = {"disturbances": False, "tolerances": False, "link_disturbance": True, "start": "rest"}
    found = ElasticJointFilter(robot, noise, biases=(), **settings).run(log, covariance=True)
    m, b, k, d, h = 0.5, 0.1, 200.0, 0.5, 2e-3
    # q, q̇, θ, θ̇, the link's torque; the motor's torque behind them, straight over a step.
    a = np.zeros((7, 7))
    a[0, 1] = a[2, 3] = 1
    a[1, :5] = np.array([-k, -d, k, d, 1]) / m
    a[3, :4] = np.array([k, d, -k, -d]) / b
    a[4, 4], a[3, 5], a[5, 6] = -1 / time, 1 / b, 1
    step = expm(a * h)
    driven, size = np.zeros((5, 5)), np.diag([0, 3e-3**2, 0, 1e-2**2, 2 * std**2 / time])
    nodes, weights = np.polynomial.legendre.leggauss(12)
    for node, weight in zip(0.5 * h * (nodes + 1), 0.5 * h * weights, strict=True):
        moved_on = expm(a[:5, :5] * node)
        driven += weight * moved_on @ size @ moved_on.T
    read = np.array([[0, 0, 1, 0, 0], [1, 0, 0, 0, 0], [-k, -d, k, d, 0]])
    spread = np.array([np.hypot(1e-5, robot.config.encoder.resolution / np.sqrt(12)), 1e-3, 0.2]) ** 2
    p = np.diag([1e-4, 1e-3, 1e-4, 1e-3, std]) ** 2
    p[0, 0], p[0, 4], p[4, 0] = p[0, 0] + (std / k) ** 2, std**2 / k, std**2 / k
    x = np.array([log.theta[0, 0], 0, log.theta[0, 0], 0, 0])
    for row in range(len(log)):
        if row:
            torque = log.tau[row - 1, 0]
            change = log.tau[row, 0] - torque
            x = (step @ np.concatenate([x, [torque, change / h]]))[:5]
            p = step[:5, :5] @ p @ step[:5, :5].T + driven + change**2 / 12 * np.outer(step[:5, 5], step[:5, 5])
        y = np.array([log.theta[row, 0], log.q[row, 0], log.torque[row, 0]])
        there = np.isfinite(y)
        rows = read[there]
        gain = np.linalg.solve(rows @ p @ rows.T + np.diag(spread[there]), rows @ p).T
        x, p = x + gain @ (y[there] - rows @ x), p - gain @ rows @ p
        scale = np.sqrt(np.diag(p))
        assert (np.abs(found.state[row] - x) < 5e-3 * scale).all()  # Runge and Kutta's rule moves the mean
        assert (np.abs(found.covariance[row] - p) < 1e-4 * np.outer(scale, scale)).all()


def test_tolerances_count_in_what_is_left_of_them():
    """A stiffness that is not known leaves q off by the torsion's part whatever the disturbance takes over."""
    robot, simulation = pushed_leg("torque")
    assert considered(robot)
    noise = Noise(jerk=30.0, link_disturbance=(6.0, 2.0))
    exact = ExtendedKalmanFilter(robot, noise, link_disturbance=True, tolerances=False).run(simulation.log)
    honest = ExtendedKalmanFilter(robot, noise, link_disturbance=True).run(simulation.log)
    np.testing.assert_array_equal(honest.q, exact.q)
    assert (np.median(honest.q_std, axis=0) > 1.2 * np.median(exact.q_std, axis=0)).all()
    assert (np.median(honest.disturbance_std, axis=0) > np.median(exact.disturbance_std, axis=0)).all()


def test_pieces_steps_and_files_tell_the_same(tmp_path):
    robot, simulation = pushed_leg("torque")
    log = simulation.log
    noise = Noise(jerk=30.0, link_disturbance=(6.0, 2.0))
    ekf = ExtendedKalmanFilter(robot, noise, link_disturbance=True, torque=True)
    whole = ekf.run(log)
    pieces = Estimate.concatenate(ekf.run_pieces(log[i : i + 500] for i in range(0, len(log), 500)))
    np.testing.assert_array_equal(pieces.q, whole.q)
    np.testing.assert_array_equal(pieces.disturbance, whole.disturbance)
    for row in range(60):
        state = ekf.step(
            dt=1e-3,
            theta=log.theta[row],
            dtheta=log.dtheta[row],
            acceleration=None,
            further=log.torque[row],
        )
    np.testing.assert_allclose(state.disturbance, whole.disturbance[59], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(state.disturbance_std, whole.disturbance_std[59], rtol=1e-6)
    whole.write(tmp_path / "estimate.parquet")
    read = Estimate.read(tmp_path / "estimate.parquet")
    np.testing.assert_array_equal(read.disturbance, whole.disturbance)
    assert {"d_hip", "d_knee", "d_std_hip", "d_std_knee"} < set(read.columns())


def test_a_fixed_lag_smoother_has_them():
    robot, simulation = pushed_leg("torque")
    log, settings = simulation.log, {"torque": True, "link_disturbance": True}
    lagging = FixedLagSmoother(robot, Noise(jerk=30.0), lag=20, **settings)
    states = [
        lagging.step(dt=1e-3, theta=log.theta[row], dtheta=log.dtheta[row], further=log.torque[row])
        for row in range(300)
    ]
    assert np.abs(states[-1].disturbance - simulation.truth["push"][279]).max() < 2.0


def test_a_start_that_is_given_leaves_disturbances_open():
    robot, simulation = pushed_leg("both")
    start = simulation.truth["q"][0], np.zeros(2), np.zeros(2)
    given_start = np.concatenate(start), np.diag(np.repeat([1e-4, 1e-2, 10.0], 2) ** 2)
    found = ExtendedKalmanFilter(robot, start=given_start, link_disturbance=True).run(simulation.log)
    error, _ = off(found, simulation)
    assert (error < 1e-4).all()


def test_a_push_that_carries_the_weight_is_weightlessness():
    robot = leg()
    weightless = Robot.from_urdf(
        LEG,
        [{"name": n, "stiffness": k, **DRIVE} for n, k in zip(("hip", "knee"), STIFFNESS, strict=True)],
        gravity=[0, 0, 0],
    )
    q = np.array([0.4, -0.9])
    hold = JointPD(kp=0.0, kd=0.0, times=[0.0], theta=[[0.0, 0.0]])
    for more in ({}, {"integrator": "adaptive", "rtol": 1e-10, "atol": 1e-12}):
        still = simulate(robot, hold, 0.2, RATE, q=q, push=robot.gravity_torque(q), **more)
        np.testing.assert_allclose(still.truth["q"], np.broadcast_to(q, (201, 2)), atol=1e-12)
        np.testing.assert_allclose(still.truth["theta"], still.truth["q"], atol=1e-12)
        pushed, free = (
            simulate(r, hold, 0.05, RATE, q=q, dq=[1.0, 0.5], push=p, **more)
            for r, p in ((robot, None), (weightless, -robot.gravity_torque(q)))
        )
        # The weight is a push that stays while the links hardly move.
        np.testing.assert_allclose(pushed.truth["dq"][5], free.truth["dq"][5], atol=2e-3)


def test_a_push_is_read_by_the_transmission_alone():
    """At rest the springs hold weight less push: torque sensors and motors' positions show the difference."""
    robot, q, push = leg(), np.array([0.4, -0.9]), np.array([3.0, -1.0])
    torque = robot.gravity_torque(q) - push
    law = JointPD(kp=0.0, kd=0.0, times=[0.0], theta=[[0.0, 0.0]], tau=torque)
    still = simulate(robot, law, 0.1, RATE, q=q, push=push, sensors={"torque": Sensor()})
    np.testing.assert_allclose(still.log.torque, np.broadcast_to(torque, (101, 2)), atol=1e-9)
    np.testing.assert_allclose(still.truth["theta"] - still.truth["q"], np.broadcast_to(torque / STIFFNESS, (101, 2)))
    np.testing.assert_array_equal(still.truth["push"], np.broadcast_to(push, (101, 2)))


def test_a_push_in_time_is_that_of_an_ode_solver():
    from scipy.integrate import solve_ivp

    robot, rows = wheel(), 401
    t = np.arange(rows) / RATE
    push = 2 * np.sin(40 * t)
    law = JointPD(kp=0.0, kd=0.0, times=[0.0], theta=[[0.0]])
    ours = simulate(robot, law, 0.4, RATE, push=push[:, None]).truth["q"][:, 0]

    def rate(time, x):
        q, dq, theta, dtheta = x
        twist = 200.0 * (theta - q) + 0.5 * (dtheta - dq)
        return [dq, (twist + 2 * np.sin(40 * time)) / 0.5, dtheta, -twist / 0.1]

    theirs = solve_ivp(rate, (0, 0.4), np.zeros(4), t_eval=t, rtol=1e-10, atol=1e-12).y[0]
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=2e-4 * np.abs(theirs).max())


def test_settings_that_cannot_be():
    with pytest.raises(EstimatorError, match="link_disturbance is 'yes', expected True, False or 'auto'"):
        ExtendedKalmanFilter(leg(), link_disturbance="yes")
    law = JointPD(kp=0.0, kd=0.0, times=[0.0], theta=[[0.0, 0.0]])
    with pytest.raises(EstimatorError, match=r"push has shape \(3,\), expected \(2,\) or \(101, 2\)"):
        simulate(leg(), law, 0.1, RATE, push=np.zeros(3))


@pytest.mark.slow
def test_deviations_are_those_of_many_pushes():
    """NEES of link positions over many pushes of the very kind that the filter assumes: in its bounds."""
    robot, runs, std, time = leg(), 60, np.array([6.0, 2.0]), 0.5
    noise = Noise(link_disturbance=tuple(std), link_disturbance_time=time, joint_torque=0.3)
    decay, total = np.exp(-1 / (RATE * time)), 0.0
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        push = np.zeros((801, 2))
        push[0] = std * rng.standard_normal(2)
        for row in range(1, 801):
            push[row] = decay * push[row - 1] + np.sqrt(1 - decay**2) * std * rng.standard_normal(2)
        simulation = moved(robot, push, TORQUE | LINK, seconds=0.8, seed=seed)
        found = ExtendedKalmanFilter(robot, noise, tolerances=False, link_disturbance=True).run(simulation.log)
        total += (((found.q[-1] - simulation.truth["q"][-1]) / found.q_std[-1]) ** 2).sum()
    assert total < stats.chi2.ppf(1 - 1e-4, 2 * runs)
