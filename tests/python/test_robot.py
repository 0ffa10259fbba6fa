"""The compiled robot against Pinocchio, and the one line that says why a robot is refused."""

import pickle
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkside.errors import ConfigError, EstimatorError
from linkside.robot import Robot
from linkside.robot.joints import JointConfig

from .robots import ARM, DATA, EXAMPLES, build_model, models, robots, spring, states

SEEDS = st.integers(0, 2**32 - 1)
ARM_JOINTS = [spring("shoulder"), spring("elbow")]
CLOSE: dict[str, Any] = {"rtol": 1e-10, "atol": 1e-10}


def one_state(robot: Robot, seed: int) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """A random q, dq, ddq in log order, and the same as Pinocchio takes it."""
    q, dq, ddq = (rows[0] for rows in states(robot, 1, seed))
    return [q, dq, ddq], [robot.to_pinocchio(q), *map(robot.velocity_to_pinocchio, (dq, ddq))]


def in_log_order(robot: Robot, matrix: np.ndarray) -> np.ndarray:
    return matrix[np.ix_(robot.velocity_index, robot.velocity_index)]


def test_friction_is_that_of_the_papers() -> None:
    motor = {"viscous": 4.0, "coulomb": 3.0, "stribeck": 2.0, "stribeck_velocity": 0.1}
    g = (0.5, 150.0, 50.0, 2.0, 100.0, 0.5)
    robot = Robot.from_urdf(ARM, [spring("shoulder", motor_friction=motor, link_friction=g), spring("elbow")])
    v = np.random.default_rng(0).uniform(-1, 1, (50, 2))
    link = g[0] * (np.tanh(g[1] * v) - np.tanh(g[2] * v)) + g[3] * np.tanh(g[4] * v) + g[5] * v
    dry = (3.0 + 2.0 * np.exp(-((v / 0.1) ** 2))) * v / np.hypot(v, 2e-3)
    here = np.array([1.0, 0.0])
    np.testing.assert_allclose(robot.link_friction(v), link * here, **CLOSE)
    np.testing.assert_allclose(robot.motor_friction(v), (4.0 * v + dry) * here, **CLOSE)
    np.testing.assert_array_equal(robot.motor_friction(v[0]), robot.motor_friction(v)[0])
    with pytest.raises(EstimatorError, match=r"dq: expected shape \(2,\) or \(T, 2\), got \(3,\)"):
        robot.link_friction(np.zeros(3))


@settings(max_examples=60, deadline=None)
@given(robot=robots(), seed=SEEDS)
def test_dynamics_are_those_of_pinocchio(robot: Robot, seed: int) -> None:
    (q, dq, ddq), state = one_state(robot, seed)
    model, data, order = robot.model, robot.model.createData(), robot.velocity_index
    np.testing.assert_allclose(robot.inverse_dynamics(q, dq, ddq), pin.rnea(model, data, *state)[order], **CLOSE)
    gravity = pin.computeGeneralizedGravity(model, data, state[0])
    np.testing.assert_allclose(robot.gravity_torque(q), gravity[order], **CLOSE)
    upper = np.triu(pin.crba(model, data, state[0]))
    mass = upper + np.triu(upper, 1).T
    np.testing.assert_allclose(robot.mass_matrix(q), in_log_order(robot, mass), **CLOSE)
    theirs = pin.computeRNEADerivatives(model, data, *state)
    for ours, expected in zip(robot.inverse_dynamics_derivatives(q, dq, ddq)[:2], theirs[:2], strict=True):
        np.testing.assert_allclose(ours, in_log_order(robot, expected), **CLOSE)


@settings(max_examples=30, deadline=None)
@given(robot=robots(), seed=SEEDS)
def test_coriolis_matrix_is_that_of_christoffel(robot: Robot, seed: int) -> None:
    q, dq, _ = (rows[0] for rows in states(robot, 1, seed))
    other, rest = states(robot, 1, seed + 1)[1][0], np.zeros(robot.n)
    bias = robot.inverse_dynamics(q, dq, rest) - robot.gravity_torque(q)
    np.testing.assert_allclose(robot.coriolis_matrix(q, dq) @ dq, bias, **CLOSE)
    # Only Christoffel's choice commutes: C(q, u) w = C(q, w) u.
    one, two = robot.coriolis_matrix(q, dq) @ other, robot.coriolis_matrix(q, other) @ dq
    np.testing.assert_allclose(one, two, **CLOSE)


@settings(max_examples=40, deadline=None)
@given(robot=robots(), seed=SEEDS)
def test_rates_and_tool_are_those_of_pinocchio(robot: Robot, seed: int) -> None:
    (q, dq, _), (x, v, _) = one_state(robot, seed)
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, x, v)
    pin.updateFramePlacements(robot.model, data)
    for sensor in robot.gyroscopes:
        frame = robot.model.getFrameId(sensor.link)
        rate = pin.getFrameVelocity(robot.model, data, frame).angular
        in_sensor = pin.rpy.rpyToMatrix(*sensor.rpy).T @ rate
        axes = ["xyz".index(axis) for axis in sensor.axes]
        np.testing.assert_allclose(robot.angular_rate(q, dq), in_sensor[axes], **CLOSE)
    assert robot.tool is not None
    tool = data.oMf[robot.model.getFrameId(robot.tool.link)].act(np.array(robot.tool.xyz))
    np.testing.assert_allclose(robot.tool_position(q), tool, **CLOSE)


@settings(max_examples=20, deadline=None)
@given(robot=robots(), seed=SEEDS)
def test_a_row_of_a_batch_is_the_single_state(robot: Robot, seed: int) -> None:
    q, dq, ddq = states(robot, 3, seed)
    for method, arguments in [
        (robot.inverse_dynamics, (q, dq, ddq)),
        (robot.specific_force, (q, dq, ddq)),
        (robot.mass_matrix, (q,)),
        (robot.coriolis_matrix, (q, dq)),
        (robot.tool_position, (np.asfortranarray(q),)),
    ]:
        rows = method(*arguments)
        assert rows.shape[0] == 3
        np.testing.assert_array_equal(rows[1], method(*(a[1] for a in arguments)))


@settings(max_examples=20, deadline=None)
@given(model=models(), seed=SEEDS)
def test_locked_joints_are_held_at_neutral(model: Any, seed: int) -> None:
    names = list(model.names)[1:]
    kept = [spring(name) for name in names[::2]]
    robot, whole = Robot.from_pinocchio(model, kept), Robot.from_pinocchio(model, map(spring, names))
    few = np.random.default_rng(seed).uniform(-2, 2, (3, robot.n))
    q, dq, ddq = np.zeros((3, whole.n))
    q[::2], dq[::2], ddq[::2] = few
    np.testing.assert_allclose(robot.inverse_dynamics(*few), whole.inverse_dynamics(q, dq, ddq)[::2], **CLOSE)


def test_a_continuous_joint_about_any_axis_is_its_revolute_twin() -> None:
    skew = ARM.replace('axis xyz="0 1 0"', 'axis xyz="1 2 -2"', 1)
    revolute, continuous = (
        Robot.from_urdf(text, ARM_JOINTS) for text in (skew, skew.replace("revolute", "continuous"))
    )
    assert (revolute.model.nq, continuous.model.nq) == (2, 4)
    q, dq, ddq = states(revolute)
    np.testing.assert_array_equal(revolute.inverse_dynamics(q, dq, ddq), continuous.inverse_dynamics(q, dq, ddq))


def test_a_tree_in_breadth_first_order_has_the_same_mass_matrix() -> None:
    robot = Robot.from_pinocchio(
        build_model([0, 0, 1], [0, 1, 4], np.random.default_rng(2)), [spring(f"joint{index}") for index in range(3)]
    )
    q = states(robot)[0][0]
    columns = [robot.inverse_dynamics(q, 0 * q, unit) - robot.gravity_torque(q) for unit in np.eye(3)]
    np.testing.assert_allclose(robot.mass_matrix(q), np.transpose(columns), rtol=1e-12, atol=1e-12)


def test_log_order_may_differ_from_the_tree() -> None:
    forward, backward = Robot.from_urdf(ARM, ARM_JOINTS), Robot.from_urdf(ARM, ARM_JOINTS[::-1])
    assert backward.names == ("elbow", "shoulder")
    q = np.array([0.3, -0.7])
    np.testing.assert_allclose(backward.gravity_torque(q[::-1])[::-1], forward.gravity_torque(q), rtol=1e-14)


def test_gravity_is_the_files_or_the_models() -> None:
    q = np.array([0.3, -0.7])
    assert not Robot.from_urdf(ARM, ARM_JOINTS, gravity=[0, 0, 0]).gravity_torque(q).any()
    model = pin.buildModelFromXML(ARM)
    model.gravity.linear = np.array([0.0, 0.0, -1.62])
    moon = Robot.from_pinocchio(model, ARM_JOINTS)
    earth = Robot.from_urdf(ARM, ARM_JOINTS)
    np.testing.assert_allclose(moon.gravity_torque(q) * 9.81, earth.gravity_torque(q) * 1.62, rtol=1e-12)
    np.testing.assert_array_equal(model.gravity.linear, [0, 0, -1.62])


def test_attributes_are_in_log_order() -> None:
    sensor = {"name": "tip", "link": "hand", "axes": "xz"}
    joints = [spring("elbow", gear_ratio=-80), JointConfig(name="shoulder", elastic=False)]
    robot = Robot.from_urdf(ARM, joints, accelerometers=[sensor], gyroscopes=[sensor], tool={"link": "hand"})
    assert (robot.n, robot.names, robot.elastic.tolist()) == (2, ("elbow", "shoulder"), [True, False])
    assert robot.gear_ratio.tolist() == [-80.0, 1.0]
    assert (robot.acceleration_channels, robot.gyroscope_channels) == (("tip_x", "tip_z"), ("tip_wx", "tip_wz"))
    assert (robot.drives[0].stiffness, robot.columns.names) == (1e4, {})
    assert repr(robot) == "<Robot arm: elbow (shoulder); sensors: tip, tip>"
    np.testing.assert_allclose(robot.tool_position([0.0, 0.0]), [0, 0, 0.9], atol=1e-15)


def test_coupling_is_a_matrix_in_log_order() -> None:
    robot = Robot.from_urdf(ARM, ARM_JOINTS, coupling={"shoulder": {"elbow": 0.25}})
    assert robot.coupling.tolist() == [[0.0, 0.25], [0.0, 0.0]]


def test_a_robot_is_constant() -> None:
    robot = Robot.from_urdf(ARM, ARM_JOINTS)
    with pytest.raises(AttributeError):
        robot.config = None  # type: ignore[assignment]
    for array in (robot.elastic, robot.gear_ratio, robot.coupling, robot.velocity_index):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


@settings(max_examples=10, deadline=None)
@given(robot=robots())
def test_a_pickled_robot_is_the_same_robot(robot: Robot) -> None:
    copy, (q, dq, ddq) = pickle.loads(pickle.dumps(robot)), states(robot)
    assert copy.config == robot.config
    np.testing.assert_array_equal(copy.inverse_dynamics(q, dq, ddq), robot.inverse_dynamics(q, dq, ddq))
    np.testing.assert_array_equal(copy.specific_force(q, dq, ddq), robot.specific_force(q, dq, ddq))


def test_a_scaled_robot_is_that_of_scaled_settings() -> None:
    joints = [spring("shoulder", mass_scale=1.1), spring("elbow", elastic=False)]
    payload = {"tool": {"link": "hand"}, "payload": {"mass": 2.0, "xyz": [0.1, 0.0, 0.2]}}
    scaled = Robot.from_urdf(ARM, joints, **payload).scaled(stiffness=0.9, damping=1.2, motor_inertia=1.3, mass=2.0)
    drive = {"stiffness": 0.9 * 1e4, "damping": 1.2 * 5.0, "motor_inertia": 1.3 * 1.5}
    joints = [spring("shoulder", mass_scale=2.2, **drive), spring("elbow", elastic=False, mass_scale=2.0, **drive)]
    payload["payload"]["mass"] = 4.0
    expected = Robot.from_urdf(ARM, joints, **payload)
    assert scaled.config == expected.config
    state = [0.3, -0.5], [1.0, 2.0], [3.0, -1.0]
    np.testing.assert_allclose(scaled.inverse_dynamics(*state), expected.inverse_dynamics(*state), rtol=1e-12)
    with pytest.raises(ConfigError, match=r"factor on damping: 0\.0, expected a positive number"):
        scaled.scaled(damping=0.0)


def test_shapes_are_checked_by_name() -> None:
    robot = Robot.from_urdf(ARM, ARM_JOINTS)
    with pytest.raises(EstimatorError, match=re.escape("q: expected shape (2,) or (T, 2), got (3,)")):
        robot.mass_matrix(np.zeros(3))
    with pytest.raises(EstimatorError, match=re.escape("q: expected shape (2,) or (T, 2), got ()")):
        robot.mass_matrix(0.0)
    with pytest.raises(EstimatorError, match=re.escape("dq: expected shape (5, 2), that of q, got (4, 2)")):
        robot.coriolis_matrix(np.zeros((5, 2)), np.zeros((4, 2)))
    with pytest.raises(EstimatorError, match="q: expected an array of numbers"):
        robot.mass_matrix(["a", "b"])
    with pytest.raises(EstimatorError, match="no tool"):
        robot.tool_position(np.zeros(2))


def test_no_samples_give_no_rows() -> None:
    robot = Robot.from_urdf(ARM, ARM_JOINTS)
    assert robot.mass_matrix(np.zeros((0, 2))).shape == (0, 2, 2)
    assert robot.specific_force(*np.zeros((3, 4, 2))).shape == (4, 0)


# Refusals: of the URDF, of what is listed, of a model.

BROKEN_URDFS = [
    ("</robot>", "", ":13: not valid XML: no element found"),
    ('<robot name="arm">', "<robot>", ": expected <robot name=…>, got <robot>"),
    ('<mass value="3"/>', '<mass value="-3"/>', ": link 'upper': expected a mass of at least 0, got -3"),
    ('<mass value="3"/>', "", ": link 'upper': expected a finite number in <inertial/mass value=…>, got ''"),
    (
        '<mass value="3"/>',
        '<mass value="nan"/>',
        ": link 'upper': expected a finite number in <inertial/mass value=…>, got 'nan'",
    ),
    (
        'ixx="0.1"',
        'ixx="-0.1"',
        ": link 'upper': expected a positive semidefinite inertia, got a principal moment of -0.1 kg m²",
    ),
    ('ixx="0.1" ', "", ": link 'upper': expected a finite number in <inertial/inertia ixx=…>, got ''"),
    (
        'xyz="0 0 0.2"',
        'xyz="0 0.2"',
        ": link 'upper': expected 3 finite numbers in <inertial/origin xyz=…>, got '0 0.2'",
    ),
    ('axis xyz="0 1 0"', 'axis xyz="0 0 0"', ": joint 'shoulder': expected an axis of some length, got 0 0 0"),
    ('axis xyz="0 1 0"', 'axis xyz="0 1"', ": joint 'shoulder': expected 3 finite numbers in <axis xyz=…>, got '0 1'"),
    (
        'type="revolute"',
        'type="hinge"',
        ": joint 'shoulder': expected a type out of "
        "revolute, continuous, prismatic, fixed, floating, planar, got 'hinge'",
    ),
    ('parent link="base"', 'parent link="bass"', ": joint 'shoulder': no parent link 'bass'; did you mean 'base'?"),
    ('effort="1"', 'effort=""', ": joint 'shoulder': expected a finite number in <limit effort=…>, got ''"),
    ('joint name="elbow"', 'joint name="shoulder"', ": joint 'shoulder' is there 2 times"),
    ('<link name="base"/>', '<link name="base"/><link name="hand"/>', ": link 'hand' is there 2 times"),
    ('<link name="base"/>', '<link name="base"/><link/>', ": a link has no name"),
    (
        '<link name="base"/>',
        '<link name="base"/><link name="other"/>',
        ": expected one link that hangs on no joint, got base and other",
    ),
    ('child link="hand"', 'child link="upper"', ": link 'upper' hangs on two joints"),
    (
        '<axis xyz="0 1 0"/>',
        '<axis xyz="0 1 0"/><mimic joint="elbow"/>',
        ": joint 'shoulder' is a mimic of 'elbow'; list neither, fix it in the URDF, or write "
        "`linkages: {shoulder: {follows: elbow, ratio: 1, offset: 0}}` into robot.yaml",
    ),
]


@pytest.mark.parametrize(("old", "new", "expected"), BROKEN_URDFS)
def test_a_broken_urdf_is_one_line_and_no_more(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], old: str, new: str, expected: str
) -> None:
    path = tmp_path / "arm.urdf"
    assert old in ARM
    path.write_text(ARM.replace(old, new, 1))
    with pytest.raises(ConfigError) as caught:
        Robot.from_urdf(path, ARM_JOINTS)
    assert str(caught.value) == f"{path}{expected}"
    assert capfd.readouterr() == ("", "")


def test_meshes_and_materials_are_not_looked_at(capfd: pytest.CaptureFixture[str]) -> None:
    shape = '<geometry><mesh filename="package://nowhere/a.dae"/></geometry><material name="none"/>'
    urdf = ARM.replace('<link name="hand"/>', f'<link name="hand"><visual>{shape}</visual></link>')
    assert Robot.from_urdf(urdf, ARM_JOINTS).n == 2
    assert capfd.readouterr() == ("", "")


def test_a_link_that_does_not_move_may_weigh_anything() -> None:
    inertial = ET.tostring(ET.fromstring(ARM).find("link/inertial"), encoding="unicode")
    base = f'<link name="base">{inertial.replace("0.01", "-0.01")}</link>'
    assert Robot.from_urdf(ARM.replace('<link name="base"/>', base), ARM_JOINTS).n == 2


REFUSED_SETTINGS: list[tuple[list[Any], dict[str, Any], str]] = [
    ([], {}, "joints: expected a list of one joint or more, got an empty one"),
    ([spring("elbo")], {}, "joints[0].name: no moving joint 'elbo'; did you mean 'elbow'?"),
    ([spring("elbow"), spring("wrist")], {}, "joints[1].name: no moving joint 'wrist'; it is fixed"),
    ([spring("elbow", stiffness=-1)], {}, "joints[0].stiffness: expected a number greater than 0, got -1"),
    (ARM_JOINTS, {"tool": {"link": "hnd"}}, "tool.link: no link 'hnd'; did you mean 'hand'?"),
    (ARM_JOINTS, {"tol": {"link": "hand"}}, "tol: unknown key; did you mean 'tool'?"),
    (
        ARM_JOINTS,
        {"accelerometers": [{"name": "a", "link": "base"}]},
        "accelerometers[0].link: link 'base' cannot move: no joint that is listed carries it",
    ),
    (
        ARM_JOINTS[1:],
        {"gyroscopes": [{"name": "g", "link": "upper"}]},
        "gyroscopes[0].link: link 'upper' cannot move: no joint that is listed carries it",
    ),
]


@pytest.mark.parametrize(("joints", "others", "expected"), REFUSED_SETTINGS)
def test_settings_that_do_not_fit_the_urdf_are_refused(
    joints: list[Any], others: dict[str, Any], expected: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        Robot.from_urdf(ARM, joints, **others)
    assert str(caught.value) == expected


FLOATING = [
    (pin.JointModelFreeFlyer(), "floating (6 degrees of freedom)"),
    (pin.JointModelPlanar(), "planar (3 degrees of freedom)"),
    (pin.JointModelSpherical(), "spherical (3 degrees of freedom)"),
    (pin.JointModelTranslation(), "translation (3 degrees of freedom)"),
    (pin.JointModelHX(0.1), "hx (1 degree of freedom)"),
    (pin.JointModelComposite(pin.JointModelRX()), "composite (1 degree of freedom)"),
]


@pytest.mark.parametrize(("joint", "kind"), FLOATING, ids=[kind for _, kind in FLOATING])
def test_a_joint_of_another_kind_is_refused_even_if_not_listed(joint: Any, kind: str) -> None:
    model = pin.Model()
    root = model.addJoint(0, joint, pin.SE3.Identity(), "root")
    model.addJoint(root, pin.JointModelRX(), pin.SE3.Identity(), "knee")
    with pytest.raises(ConfigError) as caught:
        Robot.from_pinocchio(model, [spring("knee")])
    reason = "linkside works on revolute and prismatic joints, fix it in the URDF"
    assert str(caught.value) == f"joint 'root' is {kind}; {reason}"


def test_a_floating_joint_in_a_urdf_is_refused() -> None:
    with pytest.raises(ConfigError, match="joint 'shoulder' is floating"):
        Robot.from_urdf(ARM.replace("revolute", "floating", 1), ARM_JOINTS[1:])


def test_a_model_without_joint_frames_works() -> None:
    model = pin.Model()
    for parent, name in enumerate(["hip", "knee"]):
        model.addJoint(parent, pin.JointModelRX(), pin.SE3.Identity(), name)
    assert Robot.from_pinocchio(model, [spring("knee"), spring("hip")]).n == 2
    assert Robot.from_pinocchio(model, [spring("knee")]).n == 1


def test_links_may_be_called_as_joints_are() -> None:
    urdf = ARM.replace('"hand"', '"wrist"').replace('"fore"', '"elbow"')
    robot = Robot.from_urdf(urdf, ARM_JOINTS[:1], tool={"link": "wrist"})
    np.testing.assert_allclose(robot.tool_position([0.0]), [0, 0, 0.9], atol=1e-15)


def test_an_impossible_body_of_a_model_is_named_by_its_joint() -> None:
    model = build_model([0, 1], [0, 1], np.random.default_rng(1))
    model.inertias[2] = pin.Inertia(-1.0, np.zeros(3), np.eye(3))
    with pytest.raises(ConfigError, match="body moved by joint 'joint1': expected a mass of at least 0, got -1"):
        Robot.from_pinocchio(model, [spring("joint0")])


def write_robot(folder: Path, text: str) -> Path:
    (folder / "arm.urdf").write_text(ARM)
    (folder / "robot.yaml").write_text(text)
    return folder / "robot.yaml"


YAML_TEXT = """\
urdf: arm.urdf
joints:
- {name: elbow, stiffness: 1, motor_inertia: 1}
accelerometers:
- name: tip
  link: fore
"""


def test_loads_a_urdf_beside_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_robot(tmp_path, YAML_TEXT)
    assert Robot.load(path).names == ("elbow",)
    monkeypatch.chdir(tmp_path)
    assert Robot.load("robot.yaml").acceleration_channels == ("tip_x", "tip_y", "tip_z")


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("arm.urdf", "leg.urdf", "1: urdf: no such file: "),
        ("arm.urdf", ".", "1: urdf: no such file: "),
        ("elbow", "elbo", "3: joints[0].name: no moving joint 'elbo'; did you mean 'elbow'?"),
        ("fore", "for", "6: accelerometers[0].link: no link 'for'; did you mean 'fore'?"),
    ],
)
def test_a_file_that_does_not_fit_its_urdf_is_blamed_by_line(tmp_path: Path, old: str, new: str, expected: str) -> None:
    path = write_robot(tmp_path, YAML_TEXT.replace(old, new))
    with pytest.raises(ConfigError) as caught:
        Robot.load(path)
    assert str(caught.value).startswith(f"{path}:{expected}")


@pytest.mark.parametrize("path", sorted(DATA.glob("*/robot.yaml")), ids=lambda path: path.parent.name)
def test_loads_the_recorded_robots(path: Path) -> None:
    robot = Robot.load(path)
    assert np.linalg.eigvalsh(robot.mass_matrix(np.zeros(robot.n))).min() > 0


# Public URDFs: each loads with all its joints elastic, or is refused for one of these reasons.

REASONS = re.compile(
    r"is a mimic of .*"
    r"|expected a positive semidefinite inertia, got a principal moment of -.* kg m²"
    r"|expected <robot name=…>, got <robot>"
    r"|joints: expected a list of one joint or more, got an empty one"
)
MUST_LOAD = {
    *("ur3_robot", "ur5_robot", "ur10_robot", "xarm7", "z1", "icub", "icub_reduced", "kinova", "so101"),
    *("double_pendulum", "double_pendulum_continuous", "double_pendulum_simple", "TwoDofs", "human"),
}
URDFS = sorted(EXAMPLES.rglob("*.urdf"))


def moving_joints(path: Path) -> list[str]:
    kinds = ("revolute", "continuous", "prismatic")
    joints = ET.parse(path).getroot().findall("joint")
    return [joint.get("name", "") for joint in joints if joint.get("type") in kinds]


@pytest.mark.parametrize("path", URDFS, ids=lambda path: f"{path.parts[-3]}/{path.stem}")
def test_public_urdfs_load_or_are_refused_for_a_reason(path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    try:
        robot = Robot.from_urdf(path, map(spring, moving_joints(path)))
    except ConfigError as error:
        assert path.stem not in MUST_LOAD
        assert REASONS.search(str(error))  # noqa: PT017
    else:
        (q, dq, ddq), state = one_state(robot, 7)
        expected = pin.rnea(robot.model, robot.model.createData(), *state)[robot.velocity_index]
        scale = np.abs(expected).max()
        np.testing.assert_allclose(robot.inverse_dynamics(q, dq, ddq), expected, rtol=1e-10, atol=1e-12 * scale)
    assert capfd.readouterr() == ("", "")


def test_the_public_urdfs_are_there() -> None:
    assert {path.stem for path in URDFS} >= MUST_LOAD


def test_panda_loads_with_its_fingers_locked_and_not_otherwise() -> None:
    [path] = EXAMPLES.rglob("panda.urdf")
    names = moving_joints(path)
    arm = [name for name in names if "finger" not in name]
    assert Robot.from_urdf(path, map(spring, arm)).n == 7
    with pytest.raises(ConfigError, match="'panda_finger_joint2' is a mimic of 'panda_finger_joint1'"):
        Robot.from_urdf(path, map(spring, [*arm, "panda_finger_joint1"]))
