"""Forces and moments from outside on links: known, measured, or part of the estimate."""

from functools import cache

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from linkside import (
    ConfigError,
    ElasticJointFilter,
    ElasticJointSmoother,
    Estimate,
    EstimatorError,
    ExtendedKalmanFilter,
    FixedLagSmoother,
    Log,
    LogError,
    Noise,
    RauchTungStriebelSmoother,
    Robot,
    simulate,
)
from linkside.control.controllers import JointPD
from linkside.kalman import smooth_pieces
from linkside.kalman.elastic_joint import ElasticJoint
from linkside.observability.elements import element_words

from .robots import ARM, mountings, robots, spring
from .transmissions import Gear, move, tool_error

PLACE = {"link": "hand", "xyz": [0.05, 0.02, 0.1], "rpy": [0.3, -0.4, 0.2]}
TIP = {"name": "tip", "link": "hand", "xyz": [0.1, 0, 0.05], "noise_std": 0.02}
HELD = [30.0, 5.0, -40.0, 0.5, 2.0, -1.0]
SMOOTHERS = ((RauchTungStriebelSmoother, {}), (FixedLagSmoother, {"lag": 20}))
METHODS = (ExtendedKalmanFilter, RauchTungStriebelSmoother, ElasticJointFilter, ElasticJointSmoother)


def arm(*wrenches, **others):
    joints = [spring("shoulder"), spring("elbow")]
    return Robot.from_urdf(ARM, joints, accelerometers=[TIP], tool={"link": "hand"}, wrenches=list(wrenches), **others)


def constant(values, name="rope", place=PLACE):
    return {"name": name, "kind": "constant", "force": values[:3], "moment": values[3:], **place}


def measured(name="press", place=PLACE, **others):
    return {"name": name, "kind": "measured", **place, **others}


def unknown(std, walk, place=PLACE):
    sizes = {key: {"force": f, "moment": m} for key, (f, m) in {"std": std, "walk": walk}.items()}
    return {"name": "contact", "kind": "random-walk", **sizes, **place}


def test_smoothers_of_pieces_and_streams_have_the_wrench_of_the_whole():
    robot = arm(unknown((20.0, 2.0), (5.0, 0.5)))
    control = JointPD(1e4, 1e3, [0, 0.5], [[0, 0], [0.2, 0.1]], tau=robot.gravity_torque(np.zeros(2)))
    log = simulate(robot, control, 0.2, 1000.0, q=[0, 0], substeps=4).log
    smoother, lagged = (method(robot, Noise(jerk=50.0), **more) for method, more in SMOOTHERS)
    whole = smoother.run(log)
    parts = Estimate.concatenate(list(smooth_pieces(smoother, [log[:120], log[120:]])))
    for row in range(len(log)):
        lagged.step(dt=1e-3, theta=log.theta[row], acceleration=log.acceleration[row], dtheta=log.dtheta[row])
    last = lagged.flush()
    for estimate, rows in ((parts, slice(None)), (last, slice(-20, None))):
        assert estimate.wrenches == ("contact",)
        assert (np.abs(estimate.q - whole.q[rows]) < 1e-6 * whole.q_std[rows]).all()
        assert (np.abs(estimate.wrench - whole.wrench[rows]) < 1e-6 * whole.wrench_std[rows]).all()


def outside(robot, wrench, values):
    """The same for Pinocchio: a force on each joint's body, in its axes."""
    forces = pin.StdVec_Force()
    forces.extend([pin.Force.Zero() for _ in range(robot.model.njoints)])
    frame = robot.model.frames[robot.model.getFrameId(wrench["link"])]
    pose = frame.placement * pin.SE3(pin.rpy.rpyToMatrix(*wrench["rpy"]), np.array(wrench["xyz"]))
    forces[frame.parentJoint] = pose.act(pin.Force(np.array(values[:3]), np.array(values[3:])))
    return forces


def with_wrenches(robot, *wrenches):
    extra = robot.config.model_dump(include={"wrenches"}) | {"wrenches": list(wrenches)}
    return Robot.from_pinocchio(robot.model, [spring(name) for name in robot.names], **extra)


@settings(max_examples=40, deadline=None)
@given(robot=robots(), data=st.data())
def test_torques_and_their_derivatives_are_those_of_pinocchio(robot, data):
    place = data.draw(mountings([f"link{index}" for index in range(robot.n)]))
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    values, state = rng.uniform(-20, 20, 6), rng.uniform(-2, 2, (3, robot.n))
    known = with_wrenches(robot, constant(values.tolist(), place=place))
    varies = with_wrenches(robot, measured(place=place))
    own = (known.to_pinocchio(state[0]), *(known.velocity_to_pinocchio(row) for row in state[1:]))
    model, order = known.model, known.velocity_index
    force, scale = outside(known, place, values), 1 + np.abs(values).max() * 10
    torque = pin.rnea(model, model.createData(), *own, force)[order]
    assert_allclose(known.inverse_dynamics(*state), torque, atol=1e-11 * scale)
    assert_allclose(varies.inverse_dynamics(*state, wrench=values), torque, atol=1e-11 * scale)
    data = model.createData()
    by = [np.array(part) for part in pin.computeRNEADerivatives(model, data, *own, force)]
    for ours, theirs in zip(known.inverse_dynamics_derivatives(*state)[:2], by[:2], strict=True):
        assert_allclose(ours, theirs[np.ix_(order, order)], atol=1e-10 * scale)


def test_links_accelerate_as_in_mujoco():
    robot, gears = arm(constant(HELD)), [spring("shoulder"), spring("elbow")]
    model = mujoco.MjModel.from_xml_string(
        ARM.replace('<link name="hand"/>', "").replace(
            '<joint name="wrist" type="fixed"><parent link="fore"/><child link="hand"/><origin xyz="0 0 0.4"/></joint>',
            "",
        )
    )
    data, rng = mujoco.MjData(model), np.random.default_rng(1)
    rotation = pin.rpy.rpyToMatrix(*PLACE["rpy"])
    for _ in range(5):
        q, dq, twist = rng.uniform(-1, 1, 2), rng.uniform(-2, 2, 2), rng.uniform(-1e-3, 1e-3, 2)
        found, _ = robot.forward_dynamics(q, dq, q + twist, dq, np.zeros(2))
        data.qpos[:], data.qvel[:] = q, dq
        data.qfrc_applied[:] = twist * [g["stiffness"] for g in gears]
        mujoco.mj_forward(model, data)
        body = model.body("fore").id
        axes, origin = data.xmat[body].reshape(3, 3), data.xpos[body]
        force, moment = axes @ rotation @ HELD[:3], axes @ rotation @ HELD[3:]
        point = origin + axes @ (np.array([0, 0, 0.4]) + PLACE["xyz"])
        data.xfrc_applied[body] = [*force, *(moment + np.cross(point - data.xipos[body], force))]
        mujoco.mj_forward(model, data)
        assert_allclose(found, data.qacc, rtol=1e-9)


def led(t):
    return 0.6 * np.sin(np.outer(t, [2.0, 3.1])) ** 2 + [0.3, 0.5]


def path(count, rate=1000.0):
    """A force of the size of a grinding process, in its frame."""
    t = np.arange(count)[:, None] / rate
    return HELD * np.sin(2 * np.pi * t * [0.7, 1.1, 0.5, 2.0, 1.3, 0.9])


@cache
def pressed(seed=0, seconds=1.2, **sensors):
    """A motion with a force sensor on the hand."""
    robot = arm(measured(noise_std={"force": 0.5, "moment": 0.05}))

    def servo(t, state):
        goal, speed = led(np.array([t]))[0], (led(np.array([t + 1e-4])) - led(np.array([t - 1e-4])))[0] / 2e-4
        return 4e3 * (goal - state.theta) + 200.0 * (speed - state.dtheta)

    count = round(1000 * seconds) + 1
    run = simulate(robot, servo, seconds, 1000.0, q=led(np.zeros(1))[0], wrench=path(count), substeps=4, seed=seed)
    return robot, run


def held(method):
    """`simulate` holds torques between samples."""
    return {"motor_torque": "held"} if issubclass(method, ElasticJoint) else {}


def columns(log):
    """A log's columns, to be written into."""
    table = log.to_arrow()
    return {name: table[name].to_numpy().copy() for name in table.column_names}


def link_error(estimate, run):
    return 1e6 * np.sqrt(np.mean((estimate.q - run.truth["q"]) ** 2))


@pytest.mark.parametrize("method", METHODS)
def test_a_measured_wrench_is_accounted_for(method):
    robot, run = pressed()
    options = held(method)
    found = method(robot, **options).run(run.log)
    blind = method(arm(), **options).run(Log.from_table(run.log.to_arrow(), arm()))
    assert link_error(found, run) < 30.0 < 1000.0 < link_error(blind, run)
    assert np.mean(np.abs(found.q - run.truth["q"]) < 3 * found.q_std) > 0.99
    force = found.wrench - run.truth["wrench"]
    assert np.mean(np.abs(force) < 3 * found.wrench_std) > 0.98
    assert (force[:, :3].std(axis=0) < 0.6).all()


@pytest.mark.parametrize("method", METHODS)
def test_a_gap_of_the_force_sensor_is_uncertainty(method):
    robot, run = pressed()
    table = columns(run.log)
    for column in robot.wrench_channels:
        table[column][500:560] = np.nan
    options = held(method)
    whole, gap = method(robot, **options).run(run.log), method(robot, **options).run(Log.from_table(table, robot))
    assert (gap.wrench_std[530] > 5 * whole.wrench_std[530]).all()
    assert (np.abs(gap.q - run.truth["q"]) < 4 * gap.q_std).all()


@pytest.mark.parametrize("method", METHODS)
def test_an_unmeasured_wrench_is_found_by_joint_torque_sensors(method):
    robot = arm(unknown(std=(50.0, 3.0), walk=(150.0, 10.0)), joint_torque={"noise_std": 0.2})
    told = simulate(
        robot,
        lambda t, state: 4e3 * (led(np.array([t]))[0] - state.theta) - 200.0 * state.dtheta,
        1.0,
        1000.0,
        q=led(np.zeros(1))[0],
        wrench=path(1001),
        substeps=4,
    )
    options = held(method)
    found = method(robot, **options).run(told.log)
    torque = robot.wrench_torque(found.q, found.wrench) - robot.wrench_torque(told.truth["q"], told.truth["wrench"])
    assert np.sqrt(np.mean(torque[100:] ** 2)) < 2.0
    assert np.mean(np.abs(found.wrench - told.truth["wrench"]) < 3 * found.wrench_std) > 0.97


@pytest.mark.parametrize("method", METHODS[:3:2])
def test_a_known_wrench_on_a_recording_of_another_simulator(method):
    robot, plain = arm(constant(HELD)), arm()
    frame, data = robot.model.getFrameId("hand"), robot.model.createData()
    pose = pin.SE3(pin.rpy.rpyToMatrix(*PLACE["rpy"]), np.array(PLACE["xyz"]))

    def lift(q):
        own = pin.computeFrameJacobian(robot.model, data, q, frame, pin.LOCAL)
        return own.T @ pose.act(pin.Force(np.array(HELD[:3]), np.array(HELD[3:]))).vector

    def reference(t):
        return led(np.array([t]))[0], (led(np.array([t + 1e-4])) - led(np.array([t - 1e-4])))[0] / 2e-4

    motion = move(robot, [Gear(1e4, 5.0, 1.5)] * 2, reference, 0.6, lift=lift)
    found, blind = (tool_error(method(one).run(motion.log(one, 1e-6, 0.01)), motion) for one in (robot, plain))
    assert found < 0.005 < 0.05 < blind


def test_live_steps_are_those_of_a_recording():
    robot, run = pressed()
    for method, options in ((ExtendedKalmanFilter, {"noise": Noise(jerk=50.0)}), (ElasticJointFilter, {})):
        whole, live = (method(robot, start="rest", **options) for _ in range(2))
        signals = ("theta", "acceleration", "dtheta", *(("tau",) if method is ElasticJointFilter else ()))
        for k in range(40):
            sample = {name: getattr(run.log, name)[k] for name in signals}
            state = live.step(dt=1e-3, **sample, further=run.log.wrench[k])
        found = whole.run(run.log[:40])
        assert_allclose(state.q, found.q[-1], atol=1e-12)
        assert_allclose(state.wrench, found.wrench[-1], atol=1e-9)
        assert_allclose(state.wrench_std, found.wrench_std[-1], rtol=1e-9)


def test_files_have_wrenches_by_name(tmp_path):
    robot, run = pressed()
    run.write(tmp_path)
    log = Log.read(tmp_path / "log.parquet", robot)
    assert_array_equal(log.wrench, run.log.wrench)
    found = ExtendedKalmanFilter(robot).run(log)
    found.write(tmp_path / "estimate.parquet")
    again = Estimate.read(tmp_path / "estimate.parquet")
    assert again.wrenches == ("press",)
    assert_array_equal(again.wrench_std, found.wrench_std)
    truth = Estimate.read(tmp_path / "truth.parquet")
    assert_array_equal(truth.wrench, run.truth["wrench"])


def test_units_of_forces_and_moments():
    robot = arm(measured(), units={"press_fx": "kN", "press_tz": "Nmm"})
    table = {name: np.ones(3) for name in robot.wrench_channels}
    table |= {"t": np.arange(3.0), "theta_shoulder": np.zeros(3), "theta_elbow": np.zeros(3)}
    assert_allclose(Log.from_table(table, robot, check=False).wrench[0], [1e3, 1, 1, 1, 1, 1e-3])
    with pytest.raises(ConfigError, match="press_fx"):
        arm(measured(), units={"press_fx": "Nm"})


@pytest.mark.parametrize(
    ("wrench", "message"),
    [
        (measured() | {"force": [1, 0, 0]}, "force: expected none: the wrench is measured"),
        (constant(HELD) | {"std": {"force": 1, "moment": 1}}, "std: expected none: the wrench is constant"),
        ({"name": "a", "kind": "random-walk", **PLACE}, "missing key 'std'"),
        (measured() | {"link": "nowhere"}, "no link 'nowhere'"),
        (measured() | {"link": "base"}, "link 'base' cannot move"),
        (measured() | {"kind": "gone"}, "kind: expected one of 'constant', 'measured' or 'random-walk'"),
    ],
)
def test_what_cannot_be_is_refused_by_name(wrench, message):
    with pytest.raises(ConfigError, match=message):
        arm(wrench)


def test_missing_columns_and_wrong_shapes_are_named():
    robot, run = pressed()
    without = {name: values for name, values in columns(run.log).items() if name != "press_tz"}
    with pytest.raises(LogError, match="column 'press_tz' is missing"):
        ExtendedKalmanFilter(robot).run(Log.from_table(without, robot))
    with pytest.raises(EstimatorError, match=r"wrench has shape \(5,\), expected \(6,\) or \(11, 6\)"):
        simulate(robot, lambda t, state: np.zeros(2), 0.01, 1000.0, wrench=np.zeros(5))
    with pytest.raises(EstimatorError, match=r"wrench: expected shape \(6,\), got \(3,\)"):
        robot.wrench_torque(np.zeros(2), np.zeros(3))
    with pytest.raises(ConfigError, match="expected a name of its own"):
        arm(measured(), measured())


def test_check_says_what_each_wrench_does():
    words = "\n".join(element_words(arm(measured(), constant(HELD), unknown((1.0, 1.0), (1.0, 1.0)))))
    for said in ("press is measured", "rope is known", "contact twists springs by what nothing measures"):
        assert said in words
