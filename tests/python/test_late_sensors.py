"""Late sensors of any kind: against the joint density of a whole path, and what it is worth to declare them."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkside import (
    ElasticJointFilter,
    ElasticJointSmoother,
    EstimatorError,
    ExtendedKalmanFilter,
    Log,
    MarginalizedParticleFilter,
    MotorJerkFilter,
    MotorJerkSmoother,
    Noise,
    ParticleFilter,
    RauchTungStriebelSmoother,
    Robot,
    simulate,
)
from linkside.control.controllers import JointPD
from linkside.control.trajectories import rest_to_rest

from .drawn import jerk_noise
from .robots import ARM, spring

SLIDE = """<robot name="slide"><link name="base"/>
  <link name="cart"><inertial><mass value="3"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
  <joint name="x" type="prismatic"><parent link="base"/><child link="cart"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
MASS, STIFFNESS, ROWS = 3.0, 3e3, 30
NOISE = Noise(
    jerk=300.0,
    torsion=0.0,
    transmission=1e-3,
    link=2e-4,
    joint_torque=1.5,
    position=1e-3,
    velocity=0.02,
    initial_acceleration=0.5,
    acceleration_bias=0.3,
    motor_bias=1e-3,
)
KINDS = {"acceleration": [0.0, 0.0, 1.0], "q": [1.0, 0.0, 0.0], "torque": [0.0, 0.0, MASS]}
"""How what each sensor sees depends on (q, q̇, q̈) of the cart."""


def slide(inside):
    """A mass on a spring along a line, linear in everything; ``inside`` says what is in the sensor of each kind."""
    drive = {"name": "x", "stiffness": STIFFNESS, "motor_inertia": 1.0}
    sensor = {"name": "a", "link": "cart", "noise_std": 0.3, "axes": "x"} | inside.get("acceleration", {})
    carriers = {"q": "link_encoder", "torque": "joint_torque"}
    declared = {carriers[kind]: inside[kind] for kind in carriers if kind in inside}
    return Robot.from_urdf(SLIDE, [drive], accelerometers=[sensor], encoder={"resolution": 1e-6}, **declared)


def recorded(robot, t, seed=0):
    rng = np.random.default_rng(seed)
    columns = {"theta_x": 1e-3, "q_x": 2e-4, "torque_x": 1.5, "a_x": 0.3}
    values = {name: size * rng.standard_normal(len(t)) for name, size in columns.items()}
    values["q_x"][rng.random(len(t)) < 0.3] = np.nan
    return Log.from_table({"t": t, **values}, robot, check=False)


def held(seen, t, corner_frequency=None, delay=0.0):
    """What a sensor gives of what it has ``seen`` at times ``t``, rows over anything: settled at first."""
    out = seen.copy()
    if corner_frequency:
        constant = 1 / (2 * np.pi * corner_frequency)
        for k in range(1, len(t)):
            h = t[k] - t[k - 1]
            left, mean = np.exp(-h / constant), constant / h * (1 - np.exp(-h / constant))
            out[k] = left * out[k - 1] + (mean - left) * seen[k - 1] + (1 - mean) * seen[k]
    late = np.empty_like(out)
    for k in range(len(t)):
        then = max(t[k] - delay, t[0])
        i = min(max(np.searchsorted(t, then, "right"), 1), len(t) - 1)
        part = (then - t[i - 1]) / (t[i] - t[i - 1])
        late[k] = (1 - part) * out[i - 1] + part * out[i]
    return late


def joint_density(robot, log, noise, inside):
    """Mean and covariance of (q, q̇, q̈) at each row by the readings up to it, and at each by all readings.

    By nothing but the joint normal density of the whole path, without biases.
    """
    rows = len(log)
    arrays = noise.arrays(robot, ("motor", "acceleration", "q", "torque"))
    start = np.array([log.theta[0, 0], 0.0, 0.0])
    mean, prior = np.zeros((rows, 3)), np.zeros((3 * rows, 3 * rows))
    p = np.diag(np.square(arrays["initial"]))
    for k in range(rows):
        f = np.eye(3)
        if k:
            h = log.t[k] - log.t[k - 1]
            f = np.array([[1, h, h * h / 2], [0, 1, h], [0, 0, 1]])
            p = f @ p @ f.T + noise.jerk**2 * jerk_noise(h)
            prior[3 * k : 3 * k + 3, : 3 * k] = f @ prior[3 * k - 3 : 3 * k, : 3 * k]
            prior[: 3 * k, 3 * k : 3 * k + 3] = prior[3 * k : 3 * k + 3, : 3 * k].T
        start = f @ start
        mean[k], prior[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = start, p
    maps, values, std = [], [], []
    sees = {"motor": [1.0, 0.0, MASS / STIFFNESS], **KINDS}
    signals = {"motor": log.theta, "acceleration": log.acceleration, "q": log.q, "torque": log.torque}
    for deviation, (kind, sees_by) in zip(arrays["reading"], sees.items(), strict=True):
        seen = np.kron(np.eye(rows), sees_by)
        maps.append(held(seen, log.t, **inside.get(kind, {})))
        values.append(signals[kind][:, 0])
        std.append(np.full(rows, deviation))
    h, y, r = np.stack(maps, 1), np.stack(values, 1), np.stack(std, 1) ** 2

    def given_readings(k):
        use = ~np.isnan(y[: k + 1])
        a = h[: k + 1][use]
        gain = np.linalg.solve(a @ prior @ a.T + np.diag(r[: k + 1][use]), a @ prior).T
        return mean.ravel() + gain @ (y[: k + 1][use] - a @ mean.ravel()), prior - gain @ a @ prior

    found = [given_readings(k) for k in range(rows)]
    last = found[-1]
    at = [slice(3 * k, 3 * k + 3) for k in range(rows)]
    filtered = (
        np.array([m[s] for (m, _), s in zip(found, at, strict=True)]),
        [c[s, s] for (_, c), s in zip(found, at, strict=True)],
    )
    return filtered, (np.array([last[0][s] for s in at]), [last[1][s, s] for s in at])


SENSOR = st.fixed_dictionaries(
    {"corner_frequency": st.none() | st.floats(10.0, 2000.0), "delay": st.just(0.0) | st.floats(1e-5, 6e-3)}
)


@settings(max_examples=12, deadline=None)
@given(inside=st.fixed_dictionaries(dict.fromkeys(KINDS, SENSOR)), uneven=st.booleans(), seed=st.integers(0, 99))
def test_filter_and_smoother_are_the_joint_density_of_the_path(inside, uneven, seed):
    robot = slide(inside)
    steps = np.random.default_rng(seed).uniform(0.9e-3, 1.1e-3, ROWS) if uneven else np.full(ROWS, 1e-3)
    log = recorded(robot, np.cumsum(steps), seed)
    filtered, smoothed = joint_density(robot, log, NOISE, inside)
    # What sensors hold at first is a function of the state: a covariance without an inverse, whose factor the smoother
    # knows to the root of a rounding error.
    cases = ((ExtendedKalmanFilter, filtered, 1e-6), (RauchTungStriebelSmoother, smoothed, 1e-4))
    for method, (mean, covariance), close in cases:
        estimate = method(robot, NOISE, biases=(), tolerances=False, start="rest").run(log, covariance=True)
        own = estimate.covariance[:, :3, :3]
        std = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        assert (np.abs(estimate.state[:, :3] - mean) < 1e-6 * std).all()
        assert (np.abs(own - covariance) < close * std[:, :, None] * std[:, None, :]).all()


INSIDE = {
    "acceleration": {"corner_frequency": 60.0, "delay": 2.6e-3},
    "q": {"corner_frequency": 54.0},
    "torque": {"delay": 4.3e-3},
}
WANDERING = NOISE.updated(position_walk=1e-2, velocity_walk=3.0)


def errors(method, count, seeds, noise, biases, **settings):
    """Deviations from the Kalman filter, in its standard deviations: of the mean, the deviation, the likelihood."""
    robot = slide(INSIDE)
    log = recorded(robot, 1e-3 * np.arange(ROWS))
    settings = {"collapse": "flag", "start": "rest", "biases": biases, "tolerances": False} | settings
    exact = ExtendedKalmanFilter(robot, noise, tolerances=False, start="rest", biases=biases).run(log, covariance=True)
    own = 3 + (2 if biases else 0)
    std = np.sqrt(np.diagonal(exact.covariance, axis1=1, axis2=2))[:, :own]
    out = []
    for seed in range(seeds):
        ours = method(robot, noise, particles=count, seed=seed, **settings).run(log, covariance=True)
        ours_std = np.sqrt(np.diagonal(ours.covariance, axis1=1, axis2=2))
        mean = np.sqrt(np.mean(((ours.state - exact.state[:, :own]) / std) ** 2))
        spread = np.sqrt(np.mean((ours_std / std - 1) ** 2))
        out.append((mean, spread, ours.log_likelihood.sum() - exact.log_likelihood.sum()))
        assert (ours.used == exact.used).all()
    return np.sqrt(np.mean(np.square(out), axis=0))


@pytest.mark.parametrize("biases", [(), ("motor", "acceleration")])
@pytest.mark.parametrize(
    ("method", "noise", "more"),
    [
        (ParticleFilter, NOISE, {}),
        (ParticleFilter, NOISE, {"proposal": "bootstrap", "kernel": None}),
        (ParticleFilter, NOISE, {"iterations": 2, "proposal_tail": 4}),
        (MarginalizedParticleFilter, NOISE, {}),
        (MarginalizedParticleFilter, WANDERING, {"accelerations": True}),
    ],
)
def test_on_a_linear_model_particles_tend_to_the_kalman_filter(method, noise, more, biases):
    few, many = (errors(method, count, 8, noise, biases, **more) for count in (200, 200 * 36))
    # A factor of 36 in N is one of 6; 8 seeds know a root mean square to within some 25 %.
    assert ((few / many)[:2] > 2.8).all(), (few, many)
    assert (many < (0.3, 0.2, 1.0)).all(), (few, many)


def arm(late):
    """An arm with every sensor that may be late, and late ones or prompt ones."""
    inside = {"corner_frequency": 54.0, "delay": 2.5e-3} if late else {}
    return Robot.from_urdf(
        ARM,
        [spring("shoulder"), spring("elbow")],
        accelerometers=[{"name": "tip", "link": "hand", "xyz": [0.1, 0, 0.3], "axes": "xz", **inside}],
        gyroscopes=[{"name": "gyro", "link": "hand", "axes": "y", **inside}],
        link_encoder={"resolution": 2e-6, **inside},
        joint_torque={"noise_std": 0.5, **inside},
    )


@cache
def swing(late):
    """The arm's recording, and the truth."""
    robot = arm(late)
    path = rest_to_rest([[0.2, 0.4], [1.0, -0.3]], 0.35, 1e-3, degree=13)
    controller = JointPD(kp=3e3, kd=1e2, times=path.t, theta=path.q, tau=robot.gravity_torque([0.6, 0.05]))
    return simulate(robot, controller, 0.35, 1000.0, q=[0.2, 0.4], substeps=4)


METHODS = {
    "ekf": lambda robot: ExtendedKalmanFilter(robot),
    "smoother": lambda robot: RauchTungStriebelSmoother(robot),
    "elastic-ekf": lambda robot: ElasticJointFilter(robot, motor_torque="held"),
    "elastic-smoother": lambda robot: ElasticJointSmoother(robot, motor_torque="held"),
    "motor-ekf": lambda robot: MotorJerkFilter(robot),
    "motor-smoother": lambda robot: MotorJerkSmoother(robot),
    "particle": lambda robot: ParticleFilter(robot, particles=300),
    "marginalized": lambda robot: MarginalizedParticleFilter(robot, particles=300),
}


def rms(method, believed, late):
    run = swing(late)
    log = Log.from_table(run._table, arm(believed), check=False)
    return float(np.sqrt(np.mean((METHODS[method](arm(believed)).run(log).q - run.truth["q"])[50:] ** 2)))


@pytest.mark.parametrize("method", METHODS)
def test_declared_late_sensors_cost_little_and_undeclared_ones_a_great_deal(method):
    prompt, declared, undeclared = rms(method, False, False), rms(method, True, True), rms(method, False, True)
    assert declared < 4 * prompt, (prompt, declared, undeclared)
    assert undeclared > 100 * declared, (prompt, declared, undeclared)


@pytest.mark.parametrize("settings", [{}, {"accelerations": True}])
def test_particles_take_late_sensors_live_and_in_pieces(settings):
    robot, log = arm(True), swing(True).log[:60]
    noise = Noise(jerk=100.0, position_walk=1e-6, velocity_walk=1e-4)
    everything = {"rate": True, "q": True, "torque": True, "start": "rest"}
    cloud = MarginalizedParticleFilter(robot, noise, particles=40, **everything, **settings)
    whole = cloud.run(log)
    assert np.array_equal(np.vstack([piece.q for piece in cloud.run_pieces([log[:13], log[13:]])]), whole.q)
    for k in range(len(log)):
        sample = {"theta": log.theta[k], "acceleration": log.acceleration[k], "dtheta": log.dtheta[k]}
        further = np.concatenate([log.rate[k], log.q[k], log.torque[k]])
        dt = log.t[k] - log.t[k - 1] if k else log.period
        assert np.array_equal(cloud.step(dt=dt, **sample, further=further).q, whole.q[k])


def test_a_cloud_is_not_smoothed_where_sensors_are_late():
    with pytest.raises(EstimatorError, match="late is 7, expected 0 sensors with a filter or a delay"):
        ParticleFilter(arm(True), particles=10).smooth(swing(True).log)
