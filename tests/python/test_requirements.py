"""Nothing that robot.yaml declares is ignored in silence: it makes a difference, or is refused by name."""

import numpy as np
import pytest

from linkside import (
    AccelerationObserver,
    ElasticJointFilter,
    ElasticJointSmoother,
    EstimatorError,
    ExtendedKalmanFilter,
    FixedLagSmoother,
    IteratedSmoother,
    Log,
    MarginalizedParticleFilter,
    MotorJerkFilter,
    MotorJerkSmoother,
    NicosiaTomeiObserver,
    Noise,
    ParticleFilter,
    RauchTungStriebelSmoother,
    ReducedOrderObserver,
    Robot,
    Sensor,
    UnscentedKalmanFilter,
    UnscentedSmoother,
    simulate,
)
from linkside.calibration import calibrate
from linkside.control import inverse_dynamics
from linkside.control.feedback import StateFeedback, pole_placement
from linkside.control.trajectories import rest_to_rest
from linkside.robot.requirements import FEATURES, UNSUPPORTED, refuse_unsupported
from linkside.velocity.residual import momentum_residual

from .robots import ARM, spring

ROWS, PERIOD = 60, 1e-3
# With a joint that a linkage may move, at zero without one.
HAND = '<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/>'
MASS = """<link name="hand"><inertial><origin xyz="0.1 0 0.1"/><mass value="0.4"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>"""
URDF = ARM.replace('"wrist" type="fixed">', '"wrist" type="revolute">' + HAND).replace('<link name="hand"/>', MASS)
TIP = {"name": "tip", "link": "hand", "xyz": [0.1, 0, 0.3]}
NOISE = Noise(jerk=100.0)


LIFT = {
    "ends": [{"link": "base", "xyz": [0.2, 0, 0]}, {"link": "fore", "xyz": [0.1, 0, 0.2]}],
    "spring": {"stiffness": 300.0, "length": 0.1},
}

SIZE = {"force": 30.0, "moment": 3.0}
CONTACT = {"name": "contact", "kind": "random-walk", "link": "hand", "std": SIZE, "walk": SIZE}


def robot(sensor=None, drive=None, elbow=None, **settings):
    joints = [spring("shoulder", **(drive or {})), spring("elbow", **(drive or {}), **(elbow or {}))]
    if elbow:
        joints[1] |= {"motor_inertia": None}
    return Robot.from_urdf(URDF, joints, accelerometers=[TIP | (sensor or {})], **settings)


# What robot.yaml can declare beyond the plain robot, by a word that a refusal has to say.
DECLARED = {
    "coupling": {"coupling": {"shoulder": {"elbow": 0.1}}},
    "rotor": {"rotors": {"elbow": {"link": "upper", "axis": [0, 1, 0]}}},
    "gearing": {"gearing": {"elbow": {"shoulder": 0.02}}},
    "linkages": {"linkages": {"wrist": {"follows": "elbow", "ratio": 0.5}}},
    "encoder_error": {"drive": {"encoder_error": {"scale": 1.01}}},
    "corner_frequency": {"sensor": {"corner_frequency": 50.0}},
    "delay": {"sensor": {"delay": 0.004}},
    "link_encoder.corner_frequency": {"link_encoder": {"corner_frequency": 50.0}},
    "link_encoder.delay": {"link_encoder": {"delay": 0.004}},
    "joint_torque.corner_frequency": {"joint_torque": {"corner_frequency": 50.0}},
    "joint_torque.delay": {"joint_torque": {"delay": 0.004}},
    "bias": {"sensor": {"bias": [0.3, 0.1, -0.2]}},
    "cubic_stiffness": {"drive": {"cubic_stiffness": 1e7}},
    "soft_windup": {"drive": {"soft_windup": {"stiffness": 2e3, "shape": 1e4}}},
    "stiffness_table": {
        "drive": {"stiffness": None, "stiffness_table": {"torque": [8, 30], "stiffness": [8e3, 1e4, 2e4]}}
    },
    "stiffness: unknown": {"drive": {"stiffness": "unknown"}},
    "backlash": {"drive": {"backlash": {"half_gap": 1e-3}}},
    "hysteresis": {"drive": {"hysteresis": [{"stiffness": 5e3, "limit": 3.0}]}},
    "ripple": {"drive": {"gear_ratio": 100, "ripple": [{"order": 2, "amplitude": 4e-5}]}},
    "efficiency": {"drive": {"efficiency": {"driving": 0.8, "back_driving": 0.7}}},
    "load": {"drive": {"motor_friction": {"load": 0.2}, "bearing_friction": {"load": 0.1}}},
    "asymmetry": {"drive": {"motor_friction": {"coulomb": 30.0, "asymmetry": 9.0}}},
    "bearing_friction": {"drive": {"bearing_friction": {"coulomb": 0.3, "stribeck": 0.2}}},
    "counterbalances": {"counterbalances": [LIFT]},
    "wrenches": {"wrenches": [{"name": "rope", "kind": "constant", "link": "hand", "force": [0, 0, -30]}]},
    "varying wrenches": {"wrenches": [CONTACT]},
    "passive": {"elbow": {"passive": True}},
    "link_friction": {"drive": {"link_friction": [0.5, 150.0, 50.0, 2.0, 100.0, 0.5]}},
    "motor_friction": {"drive": {"motor_friction": {"viscous": 40.0, "coulomb": 30.0}}},
}


def recording(robot):
    """The same samples whatever the robot: a motion, and readings that are near enough to it."""
    t = PERIOD * np.arange(ROWS)
    phase = 12 * t[:, None] * [1.0, 1.3]
    theta, dtheta = 0.3 * np.sin(phase) ** 2, 0.3 * np.sin(2 * phase) * 12 * [[1.0, 1.3]]
    force = robot.specific_force(theta, dtheta, 90 * np.cos(2 * phase))
    tau = robot.gravity_torque(theta) + 60 * np.cos(2 * phase)
    columns = {"t": t}
    torque = robot.gravity_torque(theta) + 5 * np.cos(2 * phase)
    signals = {"theta": theta, "dtheta": dtheta, "tau": tau, "q": theta - torque / 1e4, "torque": torque}
    for signal, values in signals.items():
        columns |= {f"{signal}_{name}": values[:, j] for j, name in enumerate(robot.names)}
    columns |= {f"tip_{axis}": force[:, i] for i, axis in enumerate("xyz")}
    return Log.from_table(columns, robot)


def fixed_lag(robot, log):
    smoother, rows = FixedLagSmoother(robot, NOISE, lag=3, q=True, torque=True), []
    for k in range(8):
        sample = {name: getattr(log, name)[k] for name in ("theta", "acceleration", "dtheta")}
        rows.append(smoother.step(dt=PERIOD, **sample, further=np.concatenate([log.q[k], log.torque[k]])))
    return np.concatenate([np.ravel(row.q) for row in rows if row is not None])


def feedforward(robot, log):
    return inverse_dynamics(robot, rest_to_rest([[0.0, 0.0], [0.5, 0.4]], 0.2, PERIOD, degree=13)).tau


def feedback(robot, log):
    desired = inverse_dynamics(robot, rest_to_rest([[0.0, 0.0], [0.5, 0.4]], 0.2, PERIOD, degree=13))
    controller = StateFeedback(robot, desired, pole_placement(robot, [0.0, 0.0]))
    samples = zip(log.theta[:20], log.acceleration, strict=False)
    return np.array([controller.step(theta=theta, acceleration=force) for theta, force in samples])


def simulated(robot, log):
    exact = {"q": robot.config.link_encoder, "torque": robot.config.joint_torque}
    sensors = {signal: Sensor() for signal, declared in exact.items() if declared is None}
    start = {"q": [0.4, 0.2], "sensors": sensors, "substeps": 4}
    motion = simulate(robot, lambda t, state: np.array([20.0, 5.0]), 0.03, 1000.0, **start)
    return np.hstack([motion.truth["q"], motion.log.acceleration, motion.log.q, motion.log.torque])


def residual(robot, log, side="motors"):
    return momentum_residual(robot, log, ReducedOrderObserver(robot, 50.0).run(log), side=side).torque


METHODS = {
    "observer": lambda robot, log: AccelerationObserver(robot).run(log).q,
    "ekf": lambda robot, log: ExtendedKalmanFilter(robot, NOISE).run(log).q,
    "ukf": lambda robot, log: UnscentedKalmanFilter(robot, NOISE).run(log).q,
    "smoother": lambda robot, log: RauchTungStriebelSmoother(robot, NOISE).run(log).q,
    "ukf-smoother": lambda robot, log: UnscentedSmoother(robot, NOISE).run(log).q,
    "map": lambda robot, log: IteratedSmoother(robot, NOISE).run(log).q,
    "fixed-lag": fixed_lag,
    "particle": lambda robot, log: ParticleFilter(robot, NOISE, particles=20).run(log[:20]).q,
    "marginalized": lambda robot, log: MarginalizedParticleFilter(robot, NOISE, particles=20).run(log[:20]).q,
    "elastic-ekf": lambda robot, log: ElasticJointFilter(robot).run(log).q,
    "elastic-smoother": lambda robot, log: ElasticJointSmoother(robot).run(log).q,
    "motor-ekf": lambda robot, log: MotorJerkFilter(robot).run(log).q,
    "motor-ekf with torques": lambda robot, log: MotorJerkFilter(robot, tau=True).run(log).q,
    "motor-smoother": lambda robot, log: MotorJerkSmoother(robot).run(log).q,
    "reduced-order": lambda robot, log: ReducedOrderObserver(robot, 50.0).run(log).dq,
    "nicosia-tomei": lambda robot, log: NicosiaTomeiObserver(robot, 50.0).run(log).dq,
    "reduced-order on links": lambda robot, log: ReducedOrderObserver(robot, 50.0, side="links").run(log).dq,
    "residual": residual,
    "residual on links": lambda robot, log: residual(robot, log, "links"),
    "feedforward": feedforward,
    "feedback": feedback,
    "simulation": simulated,
}

SENSOR, SPRING = (
    {"corner_frequency", "delay", "bias"},
    {"cubic_stiffness", "soft_windup", "stiffness_table", "stiffness: unknown", "backlash", "hysteresis", "ripple"},
)
BEHIND_GEARS = {key for key in DECLARED if "." in key}
JERK_DRIVEN = (
    *("ekf", "ukf", "smoother", "ukf-smoother", "map", "fixed-lag", "particle", "marginalized"),
    *("motor-ekf", "motor-smoother"),
)
UNCONCERNED = {
    **dict.fromkeys(("reduced-order", "nicosia-tomei", "residual"), SENSOR | SPRING | BEHIND_GEARS),
    **dict.fromkeys(
        ("reduced-order on links", "residual on links"),
        SENSOR | SPRING | {"coupling", "motor_friction", "asymmetry", "encoder_error"},
    ),
    **{method: {"motor_friction", "asymmetry", "efficiency"} for method in JERK_DRIVEN},
    "observer": {"link_friction", "bearing_friction"} | BEHIND_GEARS,
    "feedforward": SENSOR | BEHIND_GEARS | {"encoder_error"},
    "feedback": BEHIND_GEARS,
    "simulation": {"bias", "encoder_error", "varying wrenches"},
}
"""What a method has nothing to do with.

Velocity observers read no accelerometer and take joints as rigid, and on the links motors do not matter; the
jerk-driven model looks at no motor torque, its observer at none of a link and at no link encoder; a simulated
reading has its bias, which the log takes off, and a wrench is zero unless it is given.
"""


@pytest.mark.parametrize("key", DECLARED)
@pytest.mark.parametrize("method", METHODS)
def test_what_is_declared_makes_a_difference_or_is_refused_by_name(method, key):
    if key in UNCONCERNED.get(method, ()):
        pytest.skip("the method has nothing to do with it")
    plain, other = robot(), robot(**DECLARED[key])
    without = METHODS[method](plain, recording(plain))
    try:
        found = METHODS[method](other, recording(other))
    except EstimatorError as error:
        assert all(word in str(error) for word in key.split("."))  # noqa: PT017 - a difference is as good
    else:
        assert np.abs(found - without).max() > 1e-9 * np.abs(without).max()


@pytest.mark.parametrize(("method", "key"), [(m, key) for m, keys in UNSUPPORTED.items() for key in keys])
def test_a_refusal_names_method_key_and_owner(method, key):
    declared = next(settings for word, settings in DECLARED.items() if key.startswith(word))
    owners, word = ", ".join(map(repr, FEATURES[key](robot(**declared)))), key.rpartition(".")[2]
    with pytest.raises(EstimatorError, match=f"{owners} {word}, which {method} does not account for"):
        refuse_unsupported(robot(**declared), method)
    refuse_unsupported(robot(), method)


def test_calibration_refuses_rotors():
    coupled = robot(**DECLARED["rotor"])
    with pytest.raises(EstimatorError, match="rotors, which calibration does not account for"):
        calibrate(coupled, [recording(coupled)])
