"""Elastic-joint dynamics, held to Pinocchio, to the conservation of energy and to MuJoCo."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from linkside.errors import ConfigError, EstimatorError
from linkside.robot import Robot

from .robots import ARM, models, spring

AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
STIFFNESS = np.array([9e3, 9e3, 6e3, 1e3, 8e2, 5e2])
DAMPING = np.array([5.0, 5.0, 3.0, 0.5, 0.4, 0.2])
INERTIA = np.array([4.0, 4.0, 2.0, 0.3, 0.3, 0.2])
CUBIC = 2e5


def six_axes() -> str:
    """Six links of 0.3 m, lighter towards the tool."""
    links, joints = ['<link name="l0"/>'], []
    for i, axis in enumerate(AXES, start=1):
        mass = 8.0 / i
        diagonal = f'ixx="{0.02 * mass}" ixy="0" ixz="0" iyy="{0.03 * mass}" iyz="0" izz="{0.025 * mass}"'
        inertial = f'<origin xyz="0.15 0.02 0.01"/><mass value="{mass}"/><inertia {diagonal}/>'
        links.append(f'<link name="l{i}"><inertial>{inertial}</inertial></link>')
        limit = '<limit lower="-9" upper="9" effort="1" velocity="1"/>'
        place = f'<parent link="l{i - 1}"/><child link="l{i}"/><origin xyz="{0.3 if i > 1 else 0} 0 0.05"/>'
        joints.append(f'<joint name="a{i}" type="revolute">{place}<axis xyz="{axis}"/>{limit}</joint>')
    return f'<robot name="six">{"".join(links + joints)}</robot>'


def six_axis_robot(cubic: float) -> Robot:
    drives = [
        {"name": f"a{i + 1}", "stiffness": k, "damping": d, "motor_inertia": b, "cubic_stiffness": cubic}
        for i, (k, d, b) in enumerate(zip(STIFFNESS, DAMPING, INERTIA, strict=True))
    ]
    return Robot.from_urdf(six_axes(), drives)


def mujoco_text() -> str:
    """The same arm: a rotor that turns in the world, a link, and a tendon between the two, for each joint."""
    arm, tendons, rotors = "", "", ""
    for i, axis in reversed(list(enumerate(AXES, start=1))):
        mass = 8.0 / i
        inertial = (
            f'<inertial pos="0.15 0.02 0.01" mass="{mass}" diaginertia="{0.02 * mass} {0.03 * mass} {0.025 * mass}"/>'
        )
        place = f'pos="{0.3 if i > 1 else 0} 0 0.05"'
        arm = f'<body name="l{i}" {place}><joint name="a{i}" type="hinge" axis="{axis}"/>{inertial}{arm}</body>'
    for i, (k, d, b) in enumerate(zip(STIFFNESS, DAMPING, INERTIA, strict=True), start=1):
        inertial = f'<inertial pos="0 0 0" mass="1" diaginertia="{b} {b} {b}"/>'
        rotors += f'<body name="r{i}"><joint name="m{i}" type="hinge" axis="0 0 1"/>{inertial}</body>'
        ends = f'<joint joint="m{i}" coef="1"/><joint joint="a{i}" coef="-1"/>'
        tendons += f'<fixed stiffness="{k}" damping="{d}" springlength="0">{ends}</fixed>'
    option = '<option timestep="0.0002" integrator="RK4" gravity="0 0 -9.81"><flag contact="disable"/></option>'
    return f"<mujoco>{option}<worldbody>{arm}{rotors}</worldbody><tendon>{tendons}</tendon></mujoco>"


def torque(t: float) -> np.ndarray:
    return np.array([30.0, -40.0, 20.0, 3.0, -4.0, 2.0]) * np.sin((3.0 + np.arange(6)) * t)


def motion(robot: Robot, drive: Callable[[float], np.ndarray], start: np.ndarray, t: np.ndarray, rtol: float) -> Any:
    """Integrate (q, θ, q̇, θ̇) by SciPy; rows are times of `t`."""
    n = robot.n

    def rate(time: float, x: np.ndarray) -> np.ndarray:
        q, theta, dq, dtheta = x.reshape(4, n)
        return np.concatenate((dq, dtheta, *robot.forward_dynamics(q, dq, theta, dtheta, drive(time))))

    return solve_ivp(rate, (0, t[-1]), start, "DOP853", t, rtol=rtol, atol=1e-3 * rtol).y.T


@settings(max_examples=40)
@given(models(), st.integers(0, 2**32 - 1))
def test_links_and_motors_accelerate_as_pinocchio_says(model: Any, seed: int) -> None:
    rng = np.random.default_rng(seed)
    names = list(model.names)[1:]
    drives = [spring(name, elastic=bool(rng.integers(2)), cubic_stiffness=1e4) for name in names]
    robot = Robot.from_pinocchio(model, drives)
    q, dq, torsion, slip, tau = rng.uniform(-1, 1, (5, robot.n)) * [[3], [1], [0.02], [0.5], [20]]
    shaft = np.where(robot.elastic, 1e4 * torsion + 1e4 * torsion**3 + 5.0 * slip, tau)
    robot.model.armature = robot.velocity_to_pinocchio(np.where(robot.elastic, 0.0, 1.5))
    state = (robot.to_pinocchio(q), robot.velocity_to_pinocchio(dq), robot.velocity_to_pinocchio(shaft))
    expected = pin.aba(robot.model, robot.model.createData(), *state)[robot.velocity_index]
    ddq, ddtheta = robot.forward_dynamics(q, dq, q + torsion, dq + slip, tau)
    scale = max(1.0, float(np.abs(expected).max()))
    np.testing.assert_allclose(ddq, expected, atol=1e-9 * scale)
    np.testing.assert_allclose(ddtheta, np.where(robot.elastic, (tau - shaft) / 1.5, ddq), atol=1e-9 * scale)


def test_energy_stays_without_friction_damping_and_torque() -> None:
    drives = [
        {"name": name, "stiffness": 150.0, "motor_inertia": 0.4, "cubic_stiffness": 2e3}
        for name in ("shoulder", "elbow")
    ]
    robot = Robot.from_urdf(ARM, drives, coupling={"shoulder": {"elbow": 0.1}})
    start = np.array([0.5, 1.0, 0.8, 0.9, 0.4, -0.3, 0.0, 1.0])
    rows = motion(robot, lambda _: np.zeros(2), start, np.linspace(0, 10, 50), 1e-12)

    def energy(x: np.ndarray) -> float:
        q, theta, dq, dtheta = x.reshape(4, 2)
        torsion = theta - q
        gravity = pin.computePotentialEnergy(robot.model, robot.model.createData(), q)
        kinetic = 0.5 * dq @ robot.mass_matrix(q) @ dq + 0.2 * dtheta @ dtheta + dq @ robot.coupling @ dtheta
        return float(kinetic + gravity + np.sum(75.0 * torsion**2 + 500.0 * torsion**4))

    energies = np.array([energy(x) for x in rows])
    assert np.ptp(rows[:, 0]) > 1.0  # it swings
    assert np.ptp(energies) < 1e-8 * np.abs(energies).max()


def test_stiff_springs_approach_the_rigid_robot() -> None:
    def swing(**drive: Any) -> np.ndarray:
        drives = [{"name": name, "damping": 2.0, "motor_inertia": 0.4, **drive} for name in ("shoulder", "elbow")]
        start = np.array([0.5, 1.0, 0.5, 1.0, 0, 0, 0, 0])
        robot = Robot.from_urdf(ARM, drives)
        return np.asarray(motion(robot, lambda t: np.full(2, 5.0 * t), start, np.array([0.0, 0.5]), 1e-8)[-1, :2])

    rigid = swing(elastic=False)
    errors = [np.abs(swing(stiffness=k) - rigid).max() for k in (1e3, 1e4, 1e5)]
    assert errors[0] > 5 * errors[1] > 25 * errors[2]
    assert errors[2] < 1e-3


@pytest.mark.parametrize("cubic", [0.0, CUBIC])
def test_six_axes_move_as_in_mujoco(cubic: float) -> None:
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(mujoco_text())
    data = mujoco.MjData(model)

    def push(_: Any, data: Any) -> None:
        torsion = data.qpos[6:] - data.qpos[:6]
        hardening = cubic * torsion**3
        data.qfrc_passive[:6] += hardening
        data.qfrc_passive[6:] += torque(data.time) - hardening

    mujoco.set_mjcb_passive(push)
    try:
        mujoco.mj_step(model, data, 10_000)
    finally:
        mujoco.set_mjcb_passive(None)
    found = motion(six_axis_robot(cubic), torque, np.zeros(24), np.array([0.0, data.time]), 1e-10)[-1]
    assert data.time == pytest.approx(2.0)
    assert np.abs(data.qpos[:6]).min() > 0.01  # every joint has moved
    np.testing.assert_allclose(found[:12], data.qpos, atol=1e-6)


def test_a_rotor_on_the_moving_upper_arm_couples_as_its_axis_lies() -> None:
    drives = [spring("shoulder"), spring("elbow", gear_ratio=-50.0)]
    still = np.zeros(2)

    def pull(**settings: Any) -> np.ndarray:
        robot = Robot.from_urdf(ARM, drives, **settings)
        return np.asarray(robot.forward_dynamics(still, still, still, still, np.array([0.0, 3.0]))[0])

    parallel = pull(rotors={"elbow": {"link": "upper", "axis": [0, 1, 0]}})
    across = pull(rotors={"elbow": {"link": "upper", "axis": [1, 0, 0]}})
    # S = B/R, of the sign of the ratio; the spin inertia that then belongs to M is B/R² = 6e-4 kg m² on the shoulder.
    constant = pull(coupling={"shoulder": {"elbow": -1.5 / 50.0}})
    np.testing.assert_allclose(across, pull(), atol=1e-12)
    np.testing.assert_allclose(parallel, constant, rtol=2e-3)
    assert parallel[0] * 3.0 > 0


@pytest.mark.parametrize(
    ("rotors", "expected"),
    [
        ({"wrist": {"link": "upper", "axis": [0, 1, 0]}}, "rotors.wrist: expected a joint"),
        ({"elbow": {"link": "upper", "axis": [0, 0, 0]}}, "rotors.elbow.axis: expected a direction, got three zeros"),
        ({"elbow": {"link": "uper", "axis": [0, 1, 0]}}, "no link 'uper'"),
        ({"elbow": {"link": "base", "axis": [0, 1, 0]}}, "link 'base' cannot move"),
    ],
)
def test_rotors_are_refused_where_they_cannot_be(rotors: dict[str, Any], expected: str) -> None:
    with pytest.raises(ConfigError, match=expected):
        Robot.from_urdf(ARM, [spring("shoulder"), spring("elbow")], rotors=rotors)


def test_a_rotor_brings_its_own_coupling() -> None:
    both = {"coupling": {"shoulder": {"elbow": 0.1}}, "rotors": {"elbow": {"link": "upper", "axis": [0, 1, 0]}}}
    with pytest.raises(ConfigError, match="expected no coupling of this motor"):
        Robot.from_urdf(ARM, [spring("shoulder"), spring("elbow")], **both)


def test_coupling_that_makes_the_inertia_indefinite_is_refused() -> None:
    with pytest.raises(ConfigError, match="not positive definite at q = "):
        Robot.from_urdf(ARM, [spring("shoulder"), spring("elbow")], coupling={"shoulder": {"elbow": 30.0}})


def test_a_wrong_shape_is_named() -> None:
    robot = Robot.from_urdf(ARM, [spring("shoulder"), spring("elbow")])
    with pytest.raises(EstimatorError, match=r"dtheta: expected shape \(2,\), that of q, got \(3,\)"):
        robot.forward_dynamics([0, 0], [0, 0], [0, 0], [0, 0, 0], [0, 0])
