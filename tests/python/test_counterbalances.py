"""Counterbalances: torques from a potential, and estimates that know of it."""

import functools

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from linkside import (
    AccelerationObserver,
    ConfigError,
    ElasticJointFilter,
    ElasticJointSmoother,
    ExtendedKalmanFilter,
    ParticleFilter,
    RauchTungStriebelSmoother,
    Robot,
    simulate,
)
from linkside.control import inverse_dynamics
from linkside.control.trajectories import rest_to_rest

from .robots import ARM, models, spring
from .transmissions import Gear, move, tool_error

TIP = {"name": "tip", "link": "hand", "xyz": [0.1, 0, 0.3], "noise_std": 0.02}
ENDS = [{"link": "base", "xyz": [0.15, 0, 0.02]}, {"link": "upper", "xyz": [0.05, 0.01, 0.3]}]
COIL = {"ends": ENDS, "spring": {"stiffness": 900.0, "length": 0.1}}
GAS = {
    "ends": [{"link": "upper", "xyz": [-0.1, 0, 0.1]}, {"link": "hand", "xyz": [-0.1, 0, -0.1]}],
    "gas": {"pressure": 2e6, "volume": 5e-5, "length": 0.6, "area": 5e-5, "exponent": 1.3},
}
CYLINDER = {"ends": ENDS, "gas": {**GAS["gas"], "length": 0.3, "acts": "pull", "ambient": 0}}
SERIES = {"joints": ["shoulder", "elbow"], "series": [{"order": 1, "sine": -3}, {"order": 3, "cosine": 2, "sine": 1}]}
ALL = [COIL, GAS, CYLINDER, SERIES, {"joints": ["elbow"], "series": [{"order": 0, "cosine": 1.5}]}]


def arm(counterbalances=(), **drive):
    return Robot.from_urdf(
        ARM,
        [spring(name, **drive) for name in ("shoulder", "elbow")],
        accelerometers=[TIP],
        encoder={"resolution": 1e-6},
        tool={"link": "hand", "xyz": [0, 0, 0.2]},
        counterbalances=counterbalances,
    )


@functools.cache
def axes(robot):
    """Of each joint, along which it slides and about which it turns."""
    data = robot.model.createData()
    pin.computeJointJacobians(robot.model, data, pin.neutral(robot.model))
    return [None, *(np.split(np.asarray(joint.S).reshape(6), 2) for joint in list(data.joints)[1:])]


def pose(robot, q, joint):
    """Axes and origin of a joint's body, of complex positions too."""
    if joint == 0:
        return np.eye(3), np.zeros(3)
    parent, rotation, translation = placement(robot, joint)
    frame, origin = pose(robot, q, parent)
    frame, origin = frame @ rotation, origin + frame @ translation
    slide, turn = axes(robot)[joint]
    x, cross = q[joint - 1], np.cross(turn, np.eye(3)).T
    return frame @ (np.eye(3) + np.sin(x) * cross + (1 - np.cos(x)) * cross @ cross), origin + frame @ slide * x


@functools.cache
def anchor(robot, link, xyz):
    """The joint that carries a point, and where in its frame."""
    frame = next(f for f in robot.model.frames if f.name == link and f.type != pin.FrameType.JOINT)
    return frame.parentJoint, frame.placement.act(np.array(xyz))


@functools.cache
def placement(robot, joint):
    place = robot.model.jointPlacements[joint]
    return robot.model.parents[joint], place.rotation, place.translation


def energy(robot, q):
    """Potential of the counterbalances [J], as text books have it."""
    total = 0.0
    for balance in robot.config.counterbalances:
        if balance.series:
            angle = sum(q[robot.names.index(name)] for name in balance.joints)
            for k, c, s in ((h.order, h.cosine, h.sine) for h in balance.series):
                total += -(c * np.sin(k * angle) - s * np.cos(k * angle)) / k if k else -c * angle
            continue
        points = []
        for end in balance.ends:
            joint, point = anchor(robot, end.link, end.xyz)
            turned, origin = pose(robot, q, joint)
            points.append(origin + turned @ point)
        length = np.sqrt(np.sum((points[1] - points[0]) ** 2))
        if balance.spring:
            total += 0.5 * balance.spring.stiffness * (length - balance.spring.length) ** 2
            continue
        gas = balance.gas
        volume = gas.volume + (gas.area if gas.acts == "push" else -gas.area) * (length - gas.length)
        n, begun = gas.exponent, gas.pressure * gas.volume
        work = (
            begun * np.log(volume / gas.volume) if n == 1 else begun * ((gas.volume / volume) ** (n - 1) - 1) / (1 - n)
        )
        total += -work + gas.ambient * volume
    return total


def gradient(robot, q):
    steps = 1e-30j * np.eye(len(q))
    return np.array([energy(robot, q + step).imag / 1e-30 for step in steps])


POINT = st.tuples(*[st.floats(-1, 1)] * 3)


@settings(max_examples=60, deadline=None)
@given(models(5), st.data())
def test_torques_are_the_gradient_of_the_potential(model, data):
    names = list(model.names)[1:]
    joints = [{"name": name, "elastic": False} for name in names]
    turning = [n for n, j in zip(names, list(model.joints)[1:], strict=True) if "P" not in j.shortname()[10:]]
    links = [f.name for f in model.frames if f.name.startswith("link")]
    model.addFrame(pin.Frame("floor", 0, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    pair = st.lists(st.sampled_from(["floor", *links]), min_size=2, max_size=2, unique=True)
    ends = [{"link": link, "xyz": data.draw(POINT)} for link in data.draw(pair)]
    gas = {
        "pressure": 1e5,
        "volume": 0.1,
        "length": 1.0,
        "area": 3e-3,
        "exponent": data.draw(st.sampled_from([1, 1.4])),
    }
    pieces = [{"ends": ends, "spring": {"stiffness": 80.0, "length": data.draw(st.floats(-1, 1))}}]
    pieces += [{"ends": ends, "gas": gas | {"acts": acts}} for acts in ("push", "pull")]
    if turning:
        pieces.append(
            {"joints": turning[:2], "series": [{"order": data.draw(st.integers(0, 9)), "sine": 2, "cosine": 1}]}
        )
    balanced = Robot.from_pinocchio(model, joints, counterbalances=pieces)
    plain = Robot.from_pinocchio(model, joints)
    q, dq, ddq = np.array(
        data.draw(st.lists(st.floats(-2, 2), min_size=3 * len(names), max_size=3 * len(names)))
    ).reshape(3, -1)
    rest = np.zeros_like(q)
    expected = gradient(balanced, q)
    near = {
        "rtol": 1e-10,
        "atol": 1e-10 * (1 + np.abs(plain.inverse_dynamics(q, dq, ddq)).max() + np.abs(expected).max()),
    }
    assert_allclose(balanced.gravity_torque(q) - plain.gravity_torque(q), expected, **near)
    assert_allclose(balanced.inverse_dynamics(q, dq, ddq) - plain.inverse_dynamics(q, dq, ddq), expected, **near)
    state = (q, dq, rest, rest, rest)
    pushed = plain.forward_dynamics(q, dq, rest, rest, -expected)
    assert_allclose(
        balanced.forward_dynamics(*state)[0], pushed[0], rtol=1e-7, atol=1e-9 * (1 + np.abs(pushed[0]).max())
    )


def test_slopes_are_those_of_the_torques():
    """By central differences of the gradient by complex steps; the Rust tests have them exactly, by dual numbers."""
    robot, plain, rest = arm(ALL), arm(), np.zeros(2)
    for q in np.random.default_rng(0).uniform(-1.5, 1.5, (20, 2)):
        by_q = (
            robot.inverse_dynamics_derivatives(q, rest, rest)[0] - plain.inverse_dynamics_derivatives(q, rest, rest)[0]
        )
        steps = 1e-4 * np.eye(2)
        slope = [(gradient(robot, q + h) - gradient(robot, q - h)) / 2e-4 for h in steps]
        assert_allclose(by_q, np.transpose(slope), rtol=1e-5, atol=1e-5)
        assert_allclose(by_q, by_q.T, rtol=1e-12, atol=1e-10)


def test_a_spring_of_no_length_carries_the_whole_weight():
    """Of stiffness m g l/(a b), anchored straight above the joint: a pendulum without weight, in all postures."""
    weight = 9.81 * (3 * 0.2 + 2 * 0.7)
    ends = [{"link": "base", "xyz": [0, 0, 0.4]}, {"link": "upper", "xyz": [0, 0, 0.3]}]
    joint = [spring("shoulder")]
    free = Robot.from_urdf(ARM, joint)
    robot = Robot.from_urdf(
        ARM, joint, counterbalances=[{"ends": ends, "spring": {"stiffness": weight / 0.12, "length": 0}}]
    )
    q = np.linspace(-3, 3, 25)[:, None]
    assert np.abs(free.gravity_torque(q)).max() > 19
    assert_allclose(robot.gravity_torque(q), 0, atol=1e-12)
    assert_allclose(robot.inverse_dynamics_derivatives(q, 0 * q, 0 * q)[0], 0, atol=1e-11)


def test_a_gas_spring_turns_a_lid_as_its_closed_form_says():
    """Anchors a and b from the joint: ℓ² = a² + b² − 2ab cos, ℓ′ = ab sin/ℓ, torque F ℓ′."""
    robot = Robot.from_urdf(
        ARM,
        [spring("shoulder")],
        gravity=[0, 0, 0],
        counterbalances=[
            {
                "ends": [{"link": "base", "xyz": [0.3, 0, 0]}, {"link": "upper", "xyz": [0, 0, 0.5]}],
                "gas": {"pressure": 3e6, "volume": 2e-4, "length": 0.6, "area": 3e-4, "exponent": 1.25, "ambient": 1e5},
            }
        ],
    )
    q = np.linspace(-1.4, 1.4, 29)
    angle = np.pi / 2 - q  # at q = 0 the link points up, the base's anchor lies ahead of it
    length = np.sqrt(0.3**2 + 0.5**2 - 2 * 0.3 * 0.5 * np.cos(angle))
    force = 3e-4 * (3e6 * (2e-4 / (2e-4 + 3e-4 * (length - 0.6))) ** 1.25 - 1e5)
    push = force * 0.3 * 0.5 * np.sin(angle) / length  # along the angle, which falls with q
    assert_allclose(robot.gravity_torque(q[:, None])[:, 0], push, rtol=1e-12)


MJCF = """<mujoco><option gravity="0 0 -9.81" integrator="RK4" timestep="1e-4"/><compiler angle="radian"/>
<worldbody><site name="s0" pos="0.15 0 0.02"/>
<body><inertial pos="0 0 0.2" mass="3" diaginertia="0.1 0.1 0.01"/><joint type="hinge" axis="0 1 0" armature="1.5"/>
<site name="s1" pos="0.05 0.01 0.3"/><site name="t0" pos="-0.1 0 0.1"/>
<body pos="0 0 0.5"><inertial pos="0 0 0.2" mass="2" diaginertia="0.1 0.1 0.01"/>
<joint type="hinge" axis="0 1 0" armature="1.5"/><site name="t1" pos="-0.1 0 0.3"/></body></body></worldbody>
<tendon><spatial stiffness="900" springlength="0.1"><site site="s0"/><site site="s1"/></spatial>
<spatial stiffness="400" springlength="0.25"><site site="t0"/><site site="t1"/></spatial></tendon></mujoco>"""


def test_an_arm_with_springs_moves_as_mujoco_says():
    second = {"ends": GAS["ends"], "spring": {"stiffness": 400.0, "length": 0.25}}
    robot = arm([COIL, second], elastic=False)
    model = mujoco.MjModel.from_xml_string(MJCF)
    data = mujoco.MjData(model)
    for q in np.random.default_rng(1).uniform(-2, 2, (20, 2)):
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        expected = data.qfrc_bias - data.qfrc_passive
        assert_allclose(robot.gravity_torque(q), expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    data.qpos[:], data.time = [0.3, -0.4], 0
    path = [data.qpos.copy()]
    for _ in range(100):
        mujoco.mj_step(model, data, 50)
        path.append(data.qpos.copy())
    precise = {"integrator": "adaptive", "rtol": 1e-10, "atol": 1e-11}
    motion = simulate(robot, lambda t, state: np.zeros(2), 0.505, 200.0, q=[0.3, -0.4], tau=[0, 0], **precise)
    ours = motion.truth["q"][: len(path)]
    assert np.ptp(ours, axis=0).min() > 0.3
    assert_allclose(ours, path[: len(ours)], atol=2e-7)


def test_a_free_arm_keeps_its_energy():
    robot = arm(ALL, damping=0.0)
    start = {"q": [0.3, -0.4], "dq": [1.0, -2.0], "tau": [0, 0], "substeps": 20}
    truth = simulate(robot, lambda t, state: np.zeros(2), 0.5, 2000.0, **start).truth
    total, stored = [], []
    for q, dq, theta, dtheta in zip(*(truth[k][::40] for k in ("q", "dq", "theta", "dtheta")), strict=True):
        height = 9.81 * (3 * 0.2 * np.cos(q[0]) + 2 * (0.5 * np.cos(q[0]) + 0.2 * np.cos(q.sum())))
        kinetic = 0.5 * dq @ robot.mass_matrix(q) @ dq + 0.75 * dtheta @ dtheta
        stored.append(energy(robot, q))
        total.append(kinetic + 0.5e4 * (theta - q) @ (theta - q) + height + stored[-1])
    assert np.ptp(stored) > 1
    assert np.ptp(total) < 1e-6 * np.ptp(stored)


def test_torque_from_inverse_dynamics_leads_the_arm_along():
    robot = arm(ALL)
    desired = inverse_dynamics(robot, rest_to_rest([[0.2, 0.1], [0.7, 0.5]], 0.5, 1e-3, degree=13))
    assert_allclose(desired.tau[0], robot.gravity_torque(desired.q[0]), rtol=1e-9)
    t = np.arange(len(desired.q)) * 1e-3

    def control(at, state):
        feedback = 2e3 * (_at(t, desired.theta, at) - state.theta) + 100 * (_at(t, desired.dtheta, at) - state.dtheta)
        return _at(t, desired.tau, at + 5e-4) + feedback

    motion = simulate(robot, control, 0.5, 1000.0, q=desired.q[0])
    assert np.abs(motion.truth["q"][:500] - desired.q[:500]).max() < 2e-5


def _at(t, values, at):
    return np.array([np.interp(at, t, column) for column in values.T])


METHODS = {
    "EKF": lambda robot: ExtendedKalmanFilter(robot),
    "smoother": lambda robot: RauchTungStriebelSmoother(robot),
    "elastic filter": lambda robot: ElasticJointFilter(robot),
    "elastic smoother": lambda robot: ElasticJointSmoother(robot),
    "particles": lambda robot: ParticleFilter(robot, particles=200),
}


def reference(t):
    phase = np.array([3.0, 3.7]) * t
    return [0.6, -0.4] * np.sin(phase) ** 2, [0.6, -0.4] * np.sin(2 * phase) * [3.0, 3.7]


@pytest.fixture(scope="module")
def recordings():
    """Of a simulator that shares no code with ours, without and with counterbalances."""
    gears = [Gear(1e4, 5.0, 1.5)] * 2
    plain, balanced = arm(), arm(ALL)
    return {
        plain: move(plain, gears, reference, 0.8),
        balanced: move(balanced, gears, reference, 0.8, lift=lambda q: -gradient(balanced, q)),
    }


def test_estimates_know_what_carries_the_weight(recordings):
    (plain, clean), (balanced, motion) = recordings.items()
    log, unaware = motion.log(balanced, 1e-6, 0.02), motion.log(plain, 1e-6, 0.02)
    for name, method in METHODS.items():
        estimate = method(balanced).run(log)
        right = tool_error(estimate, motion, 200)
        assert right < 2 * tool_error(method(plain).run(clean.log(plain, 1e-6, 0.02)), clean, 200), name
        assert tool_error(method(plain).run(unaware), motion, 200) > 5 * right, name
        assert (np.abs(estimate.q - motion.q) < 3 * estimate.q_std).mean() > 0.99, name
        assert (estimate.status == 0).mean() > 0.98, name


def test_an_observer_starts_where_the_load_has_twisted_the_springs(recordings):
    _, (balanced, motion) = recordings.items()
    estimate = AccelerationObserver(balanced).run(motion.log(balanced, 1e-6, 0.02))
    assert_allclose(estimate.q[0], motion.q[0], atol=5e-6)


@pytest.mark.parametrize(
    ("balance", "expected"),
    [
        ({"ends": ENDS}, "expected one of 'spring', 'gas' and 'series'"),
        ({**COIL, "gas": GAS["gas"]}, "expected one of 'spring', 'gas' and 'series'"),
        ({"spring": COIL["spring"]}, "missing key 'ends'"),
        ({"series": SERIES["series"]}, "missing key 'joints'"),
        ({**COIL, "joints": ["elbow"]}, "joints: expected none"),
        ({**COIL, "ends": ENDS[:1]}, "ends: expected 2 points, got 1"),
        ({**COIL, "ends": [ENDS[0], {"link": "base"}]}, "both points are on one link"),
        ({**COIL, "ends": [{"link": "fore"}, {"link": "hand"}]}, "both points are on one link"),
        ({**COIL, "ends": [ENDS[0], {"link": "uper"}]}, "no link 'uper'"),
        ({**SERIES, "joints": ["elbov"]}, "did you mean 'elbow'"),
        ({**SERIES, "joints": ["elbow", "elbow"]}, "each joint once"),
        ({**COIL, "spring": {"stiffness": 0, "length": 1}}, "greater than 0"),
        ({**GAS, "gas": {**GAS["gas"], "exponent": 0.9}}, "exponent"),
        ({**GAS, "gas": {**GAS["gas"], "acts": "up"}}, "acts"),
    ],
)
def test_counterbalances_that_cannot_be_are_refused_with_their_key(balance, expected):
    with pytest.raises(ConfigError, match=expected):
        arm([balance])
