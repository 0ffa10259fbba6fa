"""The acceleration-driven observer: gains, decay of its error, accuracy in discrete time and on recordings."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import scipy.optimize
import scipy.signal
from hypothesis import given, settings
from hypothesis import strategies as st

import linkside
from linkside import AccelerationObserver, EstimatorError, Log, LogError, Robot, demo, poles

DATA = Path(__file__).parents[1] / "data"
RECORDINGS = {name: DATA / name for name in ("kr15_long", "kr15_six_axes", "arm2_square", "arm2_square_mismatch")}
RECORDINGS["kr15_short"] = demo.FOLDER

ONE_LINK = """<robot name="one"><link name="base"/><link name="arm"><inertial><origin xyz="0.5 0 0"/><mass value="10"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link><joint name="a" type="continuous">
<parent link="base"/><child link="arm"/><axis xyz="0 0 1"/></joint></robot>"""
TWO_LINKS = ONE_LINK.replace(
    "</robot>",
    """<link name="fore"><inertial><origin xyz="0.3 0 0"/><mass value="5"/><inertia ixx="1" ixy="0" ixz="0" iyy="1"
iyz="0" izz="1"/></inertial></link><joint name="b" type="continuous"><parent link="arm"/><child link="fore"/>
<origin xyz="1 0 0"/><axis xyz="0 1 0"/></joint></robot>""",
)


def one_joint(**drive):
    joint = {"name": "a", "stiffness": 1.2e5, "damping": 60.0, "motor_inertia": 30.0, **drive}
    return Robot.from_urdf(ONE_LINK, joints=[joint])


def two_joints(**settings):
    joints = [
        {"name": "a", "stiffness": 1.2e5, "damping": 60.0, "motor_inertia": 30.0},
        {"name": "b", "stiffness": 5e4, "damping": 20.0, "motor_inertia": 8.0},
    ]
    return Robot.from_urdf(TWO_LINKS, joints=joints, **settings)


def load(name):
    folder = RECORDINGS[name]
    robot = Robot.load(folder / "robot.yaml")
    return robot, Log.read(folder / "log.parquet", robot), folder / "truth.parquet"


# Gains


def test_published_pole_pattern_has_the_known_gains():
    slow = AccelerationObserver(one_joint(), poles.damped(250, (0.9, 0.75)), accelerations="joints").gains()["a"]
    assert slow == pytest.approx([823, 12402.34375, 288104, 976562.5], rel=1e-12)
    fast = AccelerationObserver(one_joint(), poles.damped(1000, (0.9, 0.75)), accelerations="joints").gains()["a"]
    assert fast == pytest.approx([3298, 7.0e5, 4.6894e6, 2.5e8], rel=1e-4)


drives = st.fixed_dictionaries(
    {
        "stiffness": st.floats(1e2, 1e6),
        "damping": st.floats(0, 500),
        "motor_inertia": st.floats(0.1, 100),
        "viscous": st.floats(0, 200),
    }
)


@settings(max_examples=60, deadline=None)
@given(drive=drives, frequency=st.floats(50, 1000), bias=st.booleans())
def test_gains_place_the_poles_and_equal_scipy(drive, frequency, bias):
    stiffness, damping, inertia, viscous = (drive[k] for k in ("stiffness", "damping", "motor_inertia", "viscous"))
    robot = one_joint(stiffness=stiffness, damping=damping, motor_inertia=inertia, motor_friction={"viscous": viscous})
    wanted = poles.bessel(frequency)
    gains = AccelerationObserver(robot, wanted, bias=bias, accelerations="joints").gains()["a"]
    a = np.zeros((5, 5))
    a[0, 2] = a[1, 3] = 1
    a[2, :4] = np.array([-stiffness, stiffness, -damping - viscous, damping]) / inertia
    a[3, 4] = -1
    order = 4 + bias
    a = a[:order, :order]
    # States in units of their own, or eigenvalues and SciPy's placement drown in rounding.
    reach = stiffness / inertia / frequency**2
    scale = np.array([1, reach, 1 / frequency, reach / frequency, reach / frequency**2])[:order]
    a, gains = a * scale[:, None] / scale / frequency, gains * scale / frequency
    c = np.eye(1, order)
    placed = scipy.signal.place_poles(a.T, c.T, wanted.poles(order) / frequency).gain_matrix[0]
    np.testing.assert_allclose(gains, placed, rtol=1e-6, atol=1e-6 * abs(placed).max())
    found = np.sort_complex(np.linalg.eigvals(a - gains[:, None] * c))
    np.testing.assert_allclose(found, np.sort_complex(wanted.poles(order) / frequency), atol=1e-6)


# Discrete time


def smooth_motion(duration, angle):
    """A rest-to-rest polynomial of ninth degree: q, q̇, q̈, q⃛ at any time."""
    p = np.polynomial.Polynomial([0, 0, 0, 0, 0, 126, -420, 540, -315, 70])

    def at(t):
        s, inside = np.clip(t / duration, 0, 1), (t > 0) & (t < duration)
        return [angle * p(s)] + [angle * p.deriv(k)(s) / duration**k * inside for k in (1, 2, 3)]

    return at


def exact_log(frequency_hz, link_inertia=80.0, fine=20):
    """One elastic joint moved through 30° in 0.6 s with perfect readings, its torque as an amplifier holds it."""
    stiffness, damping, inertia = 1.2e5, 60.0, 30.0
    h = 1 / frequency_hz
    t = np.arange(round(frequency_hz * fine) + 1) * h / fine
    q, dq, ddq, dddq = smooth_motion(0.6, np.radians(30))(t)
    # The torsion follows K δ + D δ̇ = m q̈; the filter is driven on a straight line between fine samples.
    drive, rate = link_inertia * ddq / stiffness, stiffness / damping
    decay = np.exp(-rate * h / fine)
    middle = (1 - decay) / (rate * h / fine)
    fed = np.concatenate([[0.0], (middle - decay) * drive[:-1] + (1 - middle) * drive[1:]])
    torsion = scipy.signal.lfilter([1.0], [1.0, -decay], fed)
    d_torsion = rate * (drive - torsion)
    dd_torsion = rate * (link_inertia * dddq / stiffness - d_torsion)
    tau = inertia * (ddq + dd_torsion) + link_inertia * ddq
    held = np.append(tau[:-1].reshape(-1, fine).mean(axis=1), tau[-1])
    pick = slice(None, None, fine)
    log = {"t": t[pick], "theta_a": (q + torsion)[pick], "tau_a": held, "ddq_a": ddq[pick]}
    return log, q[pick], dq[pick]


# Worst error of (q, q̇) of the sampled observer with interpolated acceleration, by an independent computation.
TABLE = {
    (250, 1000): (4.3e-6, 5.8e-5),
    (250, 4000): (1.1e-6, 1.4e-5),
    (1000, 1000): (4.3e-6, 1.9e-4),
    (1000, 4000): (1.1e-6, 3.0e-5),
}


@pytest.mark.parametrize(("omega", "rate"), [(250, 1000), (250, 4000), (1000, 1000), (1000, 4000)])
@pytest.mark.parametrize("form", ["current", "predictor"])
def test_sampled_observer_is_as_exact_as_its_table(omega, rate, form):
    robot = one_joint()
    columns, q, dq = exact_log(rate)
    observer = AccelerationObserver(robot, poles.damped(omega), form=form, accelerations="joints", start="rest")
    estimate = observer.run(Log.from_table(columns, robot))
    worst = np.abs(estimate.q[:, 0] - q).max(), np.abs(estimate.dq[:, 0] - dq).max()
    allowed = TABLE[omega, rate]
    assert worst[0] <= 1.02 * allowed[0]
    assert worst[1] <= 1.02 * allowed[1]


def wandering(rng, t, size):
    """Smooth motion with its first two derivatives, (T,) each: sums of slow sines."""
    w, phase, a = rng.uniform(2, 12, 4), rng.uniform(0, 6, 4), size * rng.uniform(-1, 1, 4)
    x = w * t[:, None] + phase
    return (a * np.sin(x)).sum(1), (a * w * np.cos(x)).sum(1), (-a * w**2 * np.sin(x)).sum(1)


def coupled_motion(rng, coupling, rate, seconds=0.4, fine=10):
    """Any motion of links and motors, and the torque that the motors' equations then ask for."""
    k, d, b = np.array([1.2e5, 5e4]), np.array([60.0, 20.0]), np.array([30.0, 8.0])
    t = np.arange(round(seconds * rate) * fine + 1) / (rate * fine)
    q, dq, ddq = (np.stack(x, 1) for x in zip(*(wandering(rng, t, 0.3) for _ in range(2)), strict=True))
    s, ds, dds = (np.stack(x, 1) for x in zip(*(wandering(rng, t, 1e-3) for _ in range(2)), strict=True))
    tau = b * (ddq + dds) + d * ds + k * s + ddq @ coupling
    held = np.vstack([tau[:-1].reshape(-1, fine, 2).mean(axis=1), tau[-1:]])
    return t[::fine], (q + s)[::fine], held, ddq[::fine], q[::fine], (dq + ds)[::fine], dq[::fine]


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), coupled=st.booleans(), bias=st.booleans())
def test_error_decays_as_the_poles_say(seed, coupled, bias):
    """Theorem 1 without coupling, Theorem 2 with: the same decay whatever the links do, from any start."""
    rng = np.random.default_rng(seed)
    coupling = np.array([[0.0, 2.0 * coupled], [0.0, 0.0]])
    robot = two_joints(coupling={"a": {"b": 2.0}} if coupled else {})
    t, theta, tau, ddq, q, dtheta, dq = coupled_motion(rng, coupling, 2000)
    observer = AccelerationObserver(robot, 200.0, bias=bias, accelerations="joints", period=t[1])
    offset = 1e-3 * rng.uniform(-1, 1, (4, 2))
    observer.start(theta=theta[0] + offset[0], q=q[0] + offset[1], dtheta=dtheta[0], dq=dq[0])
    observer.step(theta=theta[0], tau=tau[0], acceleration=ddq[0])
    states = [
        observer.step(theta=a, tau=b, acceleration=c) for a, b, c in zip(theta[1:], tau[1:], ddq[1:], strict=True)
    ]
    # `start` lies one period before the first sample, which we gave it at the same place: a start error of its own.
    error = np.abs(np.array([s.q for s in states]) - q[1:]).max(axis=1)
    assert error[-1] < 1e-5
    assert error[20:].max() < 20 * error[0] + 1e-3


def test_estimate_does_not_depend_on_the_links():
    """Links of three times the mass, elsewhere: the same estimate, once the start at rest is forgotten."""
    robot, log, _ = load("kr15_short")
    text = (demo.FOLDER / "robot.urdf").read_text()
    for mass in ("118.0", "62.0", "45.0"):
        assert f'value="{mass}"' in text
        text = text.replace(f'value="{mass}"', f'value="{3 * float(mass)}"')
    settings = robot.config.model_dump(exclude={"joints", "urdf"})
    heavy = Robot.from_urdf(text, joints=robot.config.joints, **settings)
    a, b = (AccelerationObserver(r).run(log) for r in (robot, heavy))
    assert np.abs(a.q - b.q)[0].max() > 1e-6
    assert np.abs(a.q - b.q)[1200:].max() < 1e-12


def test_bias_state_takes_a_bias_out_of_the_link():
    robot = one_joint()
    columns, q, _ = exact_log(1000)
    columns["ddq_a"] = columns["ddq_a"] + 2.0
    log = Log.from_table(columns, robot)
    plain, biased = (AccelerationObserver(robot, 100.0, bias=b, accelerations="joints").run(log) for b in (False, True))
    assert np.abs(plain.q[-1] - q[-1]).max() > 1e-4
    assert np.abs(biased.q[-1] - q[-1]).max() < 1e-8
    assert biased.ddq[-1] == pytest.approx(0, abs=1e-6)


# Recordings

LIMITS = {  # tool error with its offset out, RMS [mm]
    "kr15_short": 0.060,
    "kr15_long": 0.184,
    "kr15_six_axes": 0.042,
    "arm2_square": 0.061,
    "arm2_square_mismatch": 0.154,
}


@pytest.mark.parametrize("name", LIMITS)
def test_tool_error_on_recordings(name):
    robot, log, truth = load(name)
    estimate = AccelerationObserver(robot).run(log)
    assert estimate.error_against(truth).tool_rms_centred < LIMITS[name]
    assert not estimate.status.any()


def equal(a, b):
    return all(np.array_equal(a.columns()[c], b.columns()[c]) for c in a.columns())


def test_run_step_pieces_and_batch_are_the_same_bits():
    robot, log, _ = load("kr15_six_axes")
    log = log[:700]
    observer = AccelerationObserver(robot)
    whole = observer.run(log)
    pieces = linkside.Estimate.concatenate(observer.run_pieces(log[a : a + 99] for a in range(0, 700, 99)))
    assert equal(whole, pieces)
    assert all(equal(whole, one) for one in observer.run([log, log, log]))
    for i in range(len(log)):
        state = observer.step(theta=log.theta[i], tau=log.tau[i], acceleration=log.acceleration[i])
        for name in ("q", "dq", "ddq", "theta", "dtheta", "tool_position"):
            assert np.array_equal(getattr(state, name), getattr(whole, name)[i])
    observer.reset()
    assert np.array_equal(
        observer.step(theta=log.theta[0], tau=log.tau[0], acceleration=log.acceleration[0]).q, whole.q[0]
    )


def test_a_row_is_the_state_at_its_time():
    """Shifting the estimate by one sample either way makes it worse: it is neither early nor late."""
    robot, log, truth = load("kr15_long")
    q = AccelerationObserver(robot).run(log).q[:, 0]
    true = linkside.Estimate.read(truth).q[:, 0]
    error = [np.std(q[1:-1] - true[1 + k : len(true) - 1 + k]) for k in (-1, 0, 1)]
    assert error[1] < min(error[0], error[2])


# Missing and bad readings


def with_nan(log, signal, rows, channel):
    values = getattr(log, signal).copy()
    values[rows, channel] = np.nan
    return dataclasses.replace(log, **{signal: values})


@pytest.mark.parametrize(("signal", "channel"), [("theta", 0), ("tau", 1), ("acceleration", 2)])
def test_a_short_dropout_is_bridged_and_flagged(signal, channel):
    robot, log, truth = load("kr15_short")
    estimate = AccelerationObserver(robot).run(with_nan(log, signal, slice(900, 910), channel))
    flagged = (estimate.status & linkside.Status.BRIDGED) != 0
    assert np.array_equal(np.flatnonzero(flagged), np.arange(900, 910))
    assert estimate.error_against(truth).tool_rms_centred < 0.07


def test_a_long_dropout_is_refused_by_row_and_channel():
    robot, log, _ = load("kr15_short")
    with pytest.raises(LogError, match=r"log\.parquet: row 300 .*'acc_link4_z'"):
        AccelerationObserver(robot).run(with_nan(log, "acceleration", slice(300, 500), 2))
    pieces = (with_nan(log, "acceleration", slice(300, 500), 2)[a : a + 90] for a in range(0, 2000, 90))
    with pytest.raises(LogError, match=r"row 300 \(t = 0.15\)"):
        list(AccelerationObserver(robot).run_pieces(pieces))
    with pytest.raises(LogError, match="theta_a1 is missing"):
        AccelerationObserver(robot).run(with_nan(log, "theta", slice(0, 1), 0))


def test_near_a_singular_posture_the_estimate_stays_finite_and_says_so():
    """The sensor stands above joint axis 1: that joint's acceleration is not seen, the others are."""
    robot, *_ = load("kr15_short")
    posture = singular_posture(robot)
    theta = np.tile(posture, (400, 1))
    rest = robot.specific_force(posture, 0 * posture, 0 * posture)
    columns = {"t": np.arange(400) * 5e-4, **dict(zip(robot.acceleration_channels, rest, strict=True))}
    columns = {k: np.broadcast_to(v, 400) for k, v in columns.items()}
    columns |= {f"theta_{n}": theta[:, i] for i, n in enumerate(robot.names)}
    columns |= {f"tau_{n}": np.full(400, g) for n, g in zip(robot.names, robot.gravity_torque(posture), strict=True)}
    estimate = AccelerationObserver(robot).run(Log.from_table(columns, robot))
    assert (estimate.status & linkside.Status.DAMPED).all()
    assert np.abs(estimate.q - theta).max() < 0.02
    assert np.abs(estimate.dq).max() < 0.1


def singular_posture(robot):
    """A posture of the base joints at which the determinant of the acceleration map changes its sign."""

    def determinant(a2):
        posture = np.array([0, a2, 1.1, 0.2, 0.5, 0])
        return np.linalg.det(linkside.sensors.acceleration_map(robot, posture).matrix[:, :3])

    grid = np.linspace(-3, 3, 61)
    i = int(np.flatnonzero(np.diff(np.sign([determinant(a) for a in grid])))[0])
    return np.array([0, scipy.optimize.brentq(determinant, grid[i], grid[i + 1]), 1.1, 0.2, 0.5, 0])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"poles": {"a": [-1, -2, -3]}}, "joint 'a' has 3 poles, expected 4"),
        ({"poles": {"a": [-1, -2, -3, 4]}}, "expected a negative real part"),
        ({"poles": {"a": [-1, -2, -3, -4 + 1j]}}, "without its conjugate"),
        ({"poles": {"b": [-1, -2, -3, -4]}}, "none given for joint 'a'"),
        ({"poles": 2.0e4, "period": 1e-3}, "too fast for a period of 0.001 s"),
        ({"poles": -5.0}, "positive number of rad/s"),
        ({"period": 0.0}, "the sampling period is 0"),
        ({"period": float("nan")}, "the sampling period is NaN"),
        ({"form": "future"}, "'current' or 'predictor'"),
        ({"worst_acceleration_std": 0.0, "period": 1e-3}, "worst_acceleration_std is 0"),
    ],
)
def test_settings_out_of_range_are_refused(arguments, message):
    arguments = {"period": 1e-3, **arguments}
    with pytest.raises(EstimatorError, match=message):
        AccelerationObserver(one_joint(), accelerations="joints", **arguments)


def test_too_few_accelerations_are_refused():
    robot = load("kr15_six_axes")[0]
    settings = robot.config.model_dump(exclude={"joints", "urdf", "accelerometers"})
    urdf = RECORDINGS["kr15_six_axes"] / "robot.urdf"
    one_sensor = robot.config.accelerometers[:1]
    poor = Robot.from_urdf(urdf, joints=robot.config.joints, accelerometers=one_sensor, **settings)
    with pytest.raises(EstimatorError, match="6 elastic joints but only 3 accelerations"):
        AccelerationObserver(poor, period=1e-3)


def test_step_refuses_wrong_shapes_and_types():
    observer = AccelerationObserver(one_joint(), accelerations="joints", period=1e-3)
    with pytest.raises(EstimatorError, match="theta has 2 entries, expected 1"):
        observer.step(theta=[0.0, 1.0], tau=[0.0], acceleration=[0.0])
    with pytest.raises(EstimatorError, match=r"theta is \['zero'\], expected a vector of numbers"):
        observer.step(theta=["zero"], tau=[0.0], acceleration=[0.0])
    with pytest.raises(EstimatorError, match="needs the sampling period"):
        AccelerationObserver(one_joint(), accelerations="joints").step(theta=[0.0], tau=[0.0], acceleration=[0.0])


def test_logs_of_different_rates_are_run_together():
    robot, log, _ = load("kr15_short")
    logs, observer = [log[:200], log[:200:2]], AccelerationObserver(robot)
    assert all(equal(observer.run(log), one) for log, one in zip(logs, observer.run(logs), strict=True))


def test_uneven_time_is_refused():
    robot = one_joint()
    columns, _, _ = exact_log(1000)
    columns["t"] = columns["t"].copy()
    columns["t"][500] += 4e-4
    with pytest.raises(LogError, match=r"row 500 .*even rate"):
        AccelerationObserver(robot, accelerations="joints").run(Log.from_table(columns, robot, check=False))
