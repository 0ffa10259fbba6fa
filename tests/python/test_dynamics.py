"""Every quantity of a robot against Pinocchio: on random trees, on public arms; and what its methods refuse."""

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkside.errors import EstimatorError
from linkside.robot import Robot

from .robots import ARM, EXAMPLES, robots, spring, states

GRAVITY = (1.2, -3.4, -9.0)
SEEDS = st.integers(0, 2**32 - 1)
Array = Any


def fixed(examples: int) -> settings:
    return settings(max_examples=examples, deadline=None, derandomize=True)


def check_close(found: np.ndarray, expected: np.ndarray, name: str, tolerance: float = 1e-10) -> None:
    """Equal, relative to the largest expected entry or 1."""
    scale = max(1.0, np.abs(expected).max(initial=0.0))
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance * scale, err_msg=name)


class Oracle:
    """Pinocchio's answers for one state, in log order.

    Its frames are its own: it places sensors and the tool from what the robot's configuration says.
    """

    def __init__(self, robot: Robot, model: Any) -> None:
        self.model = pin.Model(model)
        joints = [model.joints[model.getJointId(name)] for name in robot.names]
        self.order = np.array([joint.idx_v for joint in joints])
        self.joints = joints
        self.accelerometers = [(self.mount(s), rows(s.axes)) for s in robot.accelerometers]
        self.gyroscopes = [(self.mount(s), rows(s.axes)) for s in robot.gyroscopes]
        self.tool = self.mount(robot.tool)
        self.data = self.model.createData()

    def mount(self, config: Any) -> int:
        """Add a frame; its index."""
        link = self.model.getFrameId(config.link, pin.FrameType.BODY)
        carrier = self.model.frames[link]
        pose = pin.SE3(pin.rpy.rpyToMatrix(*config.rpy), np.array(config.xyz))
        name = f"mounted{self.model.nframes}"
        frame = pin.Frame(name, carrier.parentJoint, link, carrier.placement * pose, pin.FrameType.SENSOR)
        return self.model.addFrame(frame)

    def position(self, q: Array) -> Array:
        x = np.empty(self.model.nq)
        for joint, value in zip(self.joints, q, strict=True):
            x[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else [np.cos(value), np.sin(value)]
        return x

    def rate(self, dq: Array) -> Array:
        v = np.empty(self.model.nv)
        v[self.order] = dq
        return v

    def state(self, *signals: Array) -> tuple[Any, ...]:
        """Arguments of Pinocchio's algorithms for q, or q and dq, or q, dq and ddq."""
        return self.model, self.data, self.position(signals[0]), *map(self.rate, signals[1:])

    def square(self, matrix: Array) -> Array:
        return matrix[np.ix_(self.order, self.order)]

    def inverse_dynamics(self, q: Array, dq: Array, ddq: Array) -> Array:
        return pin.rnea(*self.state(q, dq, ddq))[self.order]

    def mass_matrix(self, q: Array) -> Array:
        upper = np.triu(pin.crba(*self.state(q)))
        return self.square(upper + np.triu(upper, 1).T)

    def coriolis_matrix(self, q: Array, dq: Array) -> Array:
        return self.square(pin.computeCoriolisMatrix(*self.state(q, dq)))

    def gravity_torque(self, q: Array) -> Array:
        return pin.computeGeneralizedGravity(*self.state(q))[self.order]

    def inverse_dynamics_derivatives(self, q: Array, dq: Array, ddq: Array) -> Array:
        by_q, by_dq, by_ddq = pin.computeRNEADerivatives(*self.state(q, dq, ddq))
        upper = np.triu(by_ddq)
        return np.stack([self.square(m) for m in (by_q, by_dq, upper + np.triu(upper, 1).T)])

    def specific_force(self, q: Array, dq: Array, ddq: Array) -> Array:
        """R^T (acceleration - gravity) of every accelerometer's point."""
        pin.forwardKinematics(*self.state(q, dq, ddq))
        return self.stack(self.accelerometers, self.force_at, ())

    def force_at(self, frame: int) -> Array:
        motion = pin.getFrameClassicalAcceleration(self.model, self.data, frame, pin.LOCAL)
        upright = pin.updateFramePlacement(self.model, self.data, frame).rotation
        return motion.linear - upright.T @ self.model.gravity.linear

    def angular_rate(self, q: Array, dq: Array) -> Array:
        pin.forwardKinematics(*self.state(q, dq))
        return self.stack(self.gyroscopes, lambda f: pin.getFrameVelocity(self.model, self.data, f).angular, ())

    def tool_position(self, q: Array) -> Array:
        pin.forwardKinematics(*self.state(q))
        return pin.updateFramePlacement(self.model, self.data, self.tool).translation.copy()

    def acceleration_jacobian(self, q: Array) -> Array:
        """T_A."""
        pin.computeJointJacobians(*self.state(q))
        return self.stack(self.accelerometers, self.linear_jacobian, (len(self.order),))

    def linear_jacobian(self, frame: int) -> Array:
        jacobian = pin.getFrameJacobian(self.model, self.data, frame, pin.LOCAL)
        return jacobian.reshape(6, -1)[:3, self.order]  # of a single joint, Pinocchio makes a vector

    def stack(self, sensors: list[Any], sense: Callable[[int], Array], shape: tuple[int, ...]) -> Array:
        """The recorded axes of all sensors, one below the other."""
        return np.concatenate([np.empty((0, *shape)), *(sense(frame)[axes] for frame, axes in sensors)])

    def acceleration_map(self, q: Array, dq: Array) -> Array:
        """T_A with W_A as a further column."""
        offset = self.specific_force(q, dq, np.zeros_like(q))
        return np.column_stack([self.acceleration_jacobian(q), offset])


def rows(axes: str) -> list[int]:
    return ["xyz".index(axis) for axis in axes]


def stacked_derivatives(robot: Robot, *state: Array) -> Array:
    return np.stack(robot.inverse_dynamics_derivatives(*state), axis=-3)


def stacked_map(robot: Robot, *state: Array) -> Array:
    matrix, offset = robot.acceleration_map(*state)
    return np.concatenate([matrix, offset[..., np.newaxis]], axis=-1)


# Name, the robot's answer as one array, how many of q, dq and ddq it takes.
QUANTITIES: dict[str, tuple[Callable[..., Array], int]] = {
    "inverse_dynamics": (Robot.inverse_dynamics, 3),
    "mass_matrix": (Robot.mass_matrix, 1),
    "coriolis_matrix": (Robot.coriolis_matrix, 2),
    "gravity_torque": (Robot.gravity_torque, 1),
    "inverse_dynamics_derivatives": (stacked_derivatives, 3),
    "specific_force": (Robot.specific_force, 3),
    "angular_rate": (Robot.angular_rate, 2),
    "tool_position": (Robot.tool_position, 1),
    "acceleration_map": (stacked_map, 2),
}


def check_against(oracle: Oracle, robot: Robot, state: tuple[Array, ...]) -> None:
    """Every quantity, all samples at once from the robot and one by one from Pinocchio."""
    for name, (quantity, count) in QUANTITIES.items():
        found = quantity(robot, *state[:count])
        expected = [getattr(oracle, name)(*sample) for sample in zip(*state[:count], strict=True)]
        assert found.shape == np.shape(expected), name
        for one, other in zip(found, expected, strict=True):
            check_close(one, other, name)


@fixed(250)
@given(robot=robots(), seed=SEEDS)
def test_random_trees_move_as_in_pinocchio(robot: Robot, seed: int) -> None:
    check_against(Oracle(robot, robot.model), robot, states(robot, 2, seed))


# Urdf, which joints to list, and a link for the sensors and the tool.
ARMS = {
    "ur5": ("ur_description/urdf/ur5_robot.urdf", ".*", "ee_link"),
    "ur10": ("ur_description/urdf/ur10_robot.urdf", ".*", "tool0"),
    "panda with its fingers locked": ("panda_description/urdf/panda.urdf", r"panda_joint\d", "panda_rightfinger"),
    "xarm7": ("xarm_description/urdf/xarm7.urdf", ".*", "link_eef"),
    "z1": ("z1_description/urdf/z1.urdf", ".*", "gripperMover"),
    "double pendulum": ("double_pendulum_description/urdf/double_pendulum.urdf", ".*", "link2"),
    "continuous pendulum": ("double_pendulum_description/urdf/double_pendulum_continuous.urdf", ".*", "link2"),
    "kinova": ("kinova_description/robots/kinova.urdf", ".*", "j2s6s200_link_6"),
    "so101": ("so_arm_description/urdf/so101.urdf", ".*", "gripper_frame_link"),
    "arm of icub": ("icub_description/robots/icub_reduced.urdf", "l_(shoulder|elbow|wrist).*", "l_hand"),
    "upper body of icub": ("icub_description/robots/icub_reduced.urdf", "torso.*|[lr]_(sh|el|wr).*", "r_hand"),
    "hand": ("allegro_hand_description/urdf/allegro_left_hand.urdf", ".*", "link_11.0_tip"),
    "torso and arm of tiago": ("tiago_description/robots/tiago.urdf", r"torso.*|arm_\d_joint", "arm_7_link"),
}


def public_arm(name: str) -> tuple[Robot, Any]:
    """A robot in shuffled log order under tilted gravity, and the Pinocchio model of what it was made from."""
    file, pattern, link = ARMS[name]
    model = pin.buildModelFromUrdf(str(EXAMPLES / file))
    listed = [joint for joint in list(model.names)[1:] if re.fullmatch(pattern, joint)]
    locked = [model.getJointId(joint) for joint in list(model.names)[1:] if joint not in listed]
    if locked:  # Pinocchio stumbles here over a joint and a link of the same name, as z1 has them
        model = pin.buildReducedModel(model, locked, pin.neutral(model))
    model.gravity.linear = np.array(GRAVITY)
    sensor = {"name": "tip", "link": link, "xyz": [0.1, -0.2, 0.3], "rpy": [0.4, 0.5, -0.6]}
    joints = [spring(str(joint)) for joint in np.random.default_rng(7).permutation(listed)]
    fittings = {"accelerometers": [sensor], "gyroscopes": [sensor], "tool": {"link": link, "xyz": [0, 0, 0.1]}}
    return Robot.from_urdf(EXAMPLES / file, joints, gravity=GRAVITY, **fittings), model


@pytest.mark.parametrize("name", ARMS)
def test_public_arms_move_as_in_pinocchio(name: str) -> None:
    robot, model = public_arm(name)
    state = np.random.default_rng(11).uniform(-10, 10, (3, 20, robot.n))
    check_against(Oracle(robot, model), robot, tuple(state))


def differences(function: Callable[[Array], Array], point: Array) -> Array:
    """Central differences by each entry of a vector, as columns."""
    steps = 1e-5 * np.eye(len(point))
    return np.stack([(function(point + step) - function(point - step)) / 2e-5 for step in steps], axis=-1)


def check_force_derivatives(robot: Robot, oracle: Oracle, state: tuple[Array, ...]) -> None:
    [found] = robot.core.specific_force_derivatives(*(signal[np.newaxis] for signal in state))
    for which, derivative in enumerate(found):

        def force(signal: Array, which: int = which) -> Array:
            return oracle.specific_force(*state[:which], signal, *state[which + 1 :])

        check_close(derivative, differences(force, state[which]), f"by signal {which}", 1e-7)


@fixed(60)
@given(robot=robots(most=5), seed=SEEDS)
def test_specific_force_derivatives_are_slopes_of_pinocchio(robot: Robot, seed: int) -> None:
    q, dq, ddq = (signal[0] for signal in states(robot, 1, seed))
    check_force_derivatives(robot, Oracle(robot, robot.model), (q, dq, ddq))


@pytest.mark.parametrize("name", ["ur5", "panda with its fingers locked", "kinova"])
def test_specific_force_derivatives_of_public_arms_are_slopes_of_pinocchio(name: str) -> None:
    robot, model = public_arm(name)
    q, dq, ddq = np.random.default_rng(13).uniform(-2, 2, (3, robot.n))
    check_force_derivatives(robot, Oracle(robot, model), (q, dq, ddq))


# Joint axes of an answer, from the last: how it is to be permuted with the log order.
JOINT_AXES = {
    "inverse_dynamics": [-1],
    "mass_matrix": [-1, -2],
    "coriolis_matrix": [-1, -2],
    "gravity_torque": [-1],
    "inverse_dynamics_derivatives": [-1, -2],
    "specific_force": [],
    "angular_rate": [],
    "tool_position": [],
}


def reordered(robot: Robot, order: list[int]) -> Robot:
    config = robot.config.model_copy(update={"joints": tuple(robot.drives[i] for i in order)})
    return Robot(config, robot.tree)


@fixed(40)
@given(robot=robots(), data=st.data())
def test_the_log_order_permutes_answers_and_changes_none(robot: Robot, data: st.DataObject) -> None:
    order = data.draw(st.permutations(range(robot.n)))
    other, state = reordered(robot, order), states(robot)
    for name, axes in JOINT_AXES.items():
        quantity, count = QUANTITIES[name]
        expected = quantity(robot, *state[:count])
        for axis in axes:
            expected = expected.take(order, axis)
        found = quantity(other, *(signal[:, order] for signal in state[:count]))
        np.testing.assert_array_equal(found, expected, err_msg=name)


@pytest.mark.parametrize("axis", ["1 0 0", "0 -1 0", "0 0 1", "1 2 -2"])
def test_a_continuous_joint_winds_as_far_as_it_likes(axis: str) -> None:
    urdf = ARM.replace('axis xyz="0 1 0"', f'axis xyz="{axis}"', 1).replace("revolute", "continuous")
    sensor = {"name": "tip", "link": "fore", "xyz": [0.1, 0.2, 0.3]}
    joints = [spring("elbow"), spring("shoulder")]
    robot = Robot.from_urdf(urdf, joints, accelerometers=[sensor], gyroscopes=[sensor], tool={"link": "hand"})
    oracle = Oracle(robot, pin.buildModelFromXML(urdf))
    q, dq, ddq = states(robot, 5)
    check_against(oracle, robot, (q * 100, dq, ddq))
    turned = q + 2 * np.pi * np.array([3, -50])
    check_close(robot.inverse_dynamics(turned, dq, ddq), robot.inverse_dynamics(q, dq, ddq), "whole turns")


@fixed(25)
@given(robot=robots())
def test_a_sample_alone_is_its_row_among_others(robot: Robot) -> None:
    state = states(robot, 3)
    for name, (quantity, count) in QUANTITIES.items():
        together = quantity(robot, *state[:count])
        for row in range(3):
            alone = quantity(robot, *(signal[row] for signal in state[:count]))
            np.testing.assert_array_equal(alone, together[row], err_msg=name)


@pytest.fixture(scope="module")
def arm() -> Robot:
    sensor = {"name": "tip", "link": "hand", "axes": "xz"}
    joints = [spring("shoulder"), spring("elbow")]
    return Robot.from_urdf(ARM, joints, accelerometers=[sensor], gyroscopes=[sensor], tool={"link": "hand"})


LAYOUTS: dict[str, Callable[[Array], Any]] = {
    "fortran": np.asfortranarray,
    "strided": lambda signal: np.repeat(signal, 2, axis=0)[::2],
    "strided columns": lambda signal: np.repeat(signal, 2, axis=-1)[..., ::2],
    "reversed": lambda signal: signal[::-1].copy()[::-1],
    "read-only": lambda signal: np.frombuffer(signal.tobytes()).reshape(signal.shape),
    "big-endian": lambda signal: signal.astype(">f8"),
    "list": lambda signal: signal.tolist(),
}


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("name", QUANTITIES)
def test_any_layout_of_numbers_will_do(arm: Robot, name: str, layout: str) -> None:
    quantity, count = QUANTITIES[name]
    rows = states(arm)[:count]
    for state in (rows, [signal[0] for signal in rows]):
        found = quantity(arm, *map(LAYOUTS[layout], state))
        np.testing.assert_array_equal(found, quantity(arm, *state))


@pytest.mark.parametrize("dtype", [np.float32, np.int64, np.uint8, np.bool_])
def test_other_real_numbers_are_converted(arm: Robot, dtype: type[np.generic]) -> None:
    q = np.array([[0, 1], [1, 0]], dtype)
    np.testing.assert_array_equal(arm.mass_matrix(q), arm.mass_matrix(q.astype(np.float64)))


@pytest.mark.parametrize("name", QUANTITIES)
def test_no_samples_give_no_rows(arm: Robot, name: str) -> None:
    quantity, count = QUANTITIES[name]
    some, none = (quantity(arm, *[np.zeros((samples, 2))] * count) for samples in (4, 0))
    assert (len(some), len(none), some.shape[1:]) == (4, 0, none.shape[1:])


@pytest.mark.parametrize("name", ["specific_force", "angular_rate", "acceleration_map"])
def test_without_sensors_there_are_no_channels(name: str) -> None:
    robot = Robot.from_urdf(ARM, [spring("shoulder"), spring("elbow")])
    quantity, count = QUANTITIES[name]
    assert quantity(robot, *[np.zeros((4, 2))] * count).shape[:2] == (4, 0)


METHODS = [(getattr(Robot, name), count) for name, (_, count) in QUANTITIES.items()]
NAMES = ("q", "dq", "ddq")


@pytest.mark.parametrize(("method", "count"), METHODS, ids=QUANTITIES)
@pytest.mark.parametrize("shape", [(), (0,), (1,), (3,), (4, 3), (2, 0), (1, 4, 2)])
def test_a_position_of_another_shape_is_refused(
    arm: Robot, method: Callable[..., Any], count: int, shape: tuple[int, ...]
) -> None:
    expected = f"q: expected shape (2,) or (T, 2), got {shape}"
    with pytest.raises(EstimatorError, match=f"^{re.escape(expected)}$"):
        method(arm, *[np.zeros(shape)] * count)


ARGUMENTS = [(method, count, which) for method, count in METHODS for which in range(count)]


@pytest.mark.parametrize(("method", "count", "which"), [a for a in ARGUMENTS if a[2] > 0])
@pytest.mark.parametrize("shape", [(), (2,), (3, 2), (5, 2), (4, 3), (2, 4), (1, 4, 2)])
def test_an_argument_unlike_q_is_refused_by_name(
    arm: Robot, method: Callable[..., Any], count: int, which: int, shape: tuple[int, ...]
) -> None:
    state = [np.zeros((4, 2))] * count
    state[which] = np.zeros(shape)
    expected = f"{NAMES[which]}: expected shape (4, 2), that of q, got {shape}"
    with pytest.raises(EstimatorError, match=f"^{re.escape(expected)}$"):
        method(arm, *state)


@pytest.mark.parametrize(("method", "count", "which"), ARGUMENTS)
@pytest.mark.parametrize("value", [["a", "b"], "ab", [{}, {}], [{1}, 1.0]], ids=repr)
def test_what_is_no_number_is_refused_by_name(
    arm: Robot, method: Callable[..., Any], count: int, which: int, value: Any
) -> None:
    state: list[Any] = [np.zeros(2)] * count
    state[which] = value
    with pytest.raises(EstimatorError, match=f"^{NAMES[which]}: expected an array of numbers$"):
        method(arm, *state)


def test_a_robot_without_a_tool_has_no_tool_position() -> None:
    robot = Robot.from_urdf(ARM, [spring("shoulder"), spring("elbow")])
    with pytest.raises(EstimatorError, match="the robot has no tool"):
        robot.tool_position([0.0, 0.0])
