"""Robots to test with: random trees for Hypothesis, an arm in a few lines of URDF, and paths to others."""

from collections.abc import Callable
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from hypothesis import strategies as st

from linkside.robot import Robot

DATA = Path(__file__).parents[1] / "data"
EXAMPLES = Path(distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data/robots"))

ARM = """<robot name="arm">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0 0 0.2"/><mass value="3"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.01"/></inertial></link>
  <link name="fore"><inertial><origin xyz="0 0 0.2"/><mass value="2"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.01"/></inertial></link>
  <link name="hand"/>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0 0 0.5"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <joint name="wrist" type="fixed"><parent link="fore"/><child link="hand"/><origin xyz="0 0 0.4"/></joint>
</robot>"""

JOINT_MODELS: list[Callable[[np.ndarray], Any]] = [
    lambda axis: pin.JointModelRX(),
    lambda axis: pin.JointModelRZ(),
    lambda axis: pin.JointModelRUBY(),
    lambda axis: pin.JointModelPX(),
    lambda axis: pin.JointModelRevoluteUnaligned(axis),
    lambda axis: pin.JointModelPrismaticUnaligned(axis),
]


def spring(name: str, **settings: Any) -> dict[str, Any]:
    """An elastic joint of round figures."""
    return {"name": name, "stiffness": 1e4, "damping": 5.0, "motor_inertia": 1.5, **settings}


def random_pose(rng: np.random.Generator) -> Any:
    return pin.SE3(pin.Quaternion(*rng.standard_normal(4)).normalized().matrix(), rng.uniform(-0.5, 0.5, 3))


def random_inertia(rng: np.random.Generator) -> Any:
    root = rng.uniform(-0.3, 0.3, (3, 3))
    spread = root @ root.T + 0.005 * np.eye(3)  # ∫ r rᵀ dm: no moment is more than the sum of the others
    return pin.Inertia(rng.uniform(0.1, 5), rng.uniform(-0.3, 0.3, 3), np.trace(spread) * np.eye(3) - spread)


def build_model(parents: list[int], kinds: list[int], rng: np.random.Generator) -> Any:
    """A tree whose joint i hangs on joint parents[i] (0 the base); its link is off the joint's frame."""
    model = pin.Model()
    for index, (parent, kind) in enumerate(zip(parents, kinds, strict=True)):
        axis = rng.standard_normal(3)
        joint_model = JOINT_MODELS[kind](axis / np.linalg.norm(axis))
        joint = model.addJoint(parent, joint_model, random_pose(rng), f"joint{index}")
        model.addJointFrame(joint)
        model.appendBodyToJoint(joint, random_inertia(rng), random_pose(rng))
        model.addBodyFrame(f"link{index}", joint, random_pose(rng), -1)
    return model


@st.composite
def models(draw: st.DrawFn, most: int = 7) -> Any:
    """Pinocchio trees of up to `most` revolute, continuous and prismatic joints about any axis."""
    kinds = draw(st.lists(st.integers(0, len(JOINT_MODELS) - 1), min_size=1, max_size=most))
    parents: list[int] = []
    branch = [0]  # depth first, as URDFs are read: Pinocchio's mass matrix is wrong in any other order
    for joint in range(1, len(kinds) + 1):
        del branch[draw(st.integers(1, len(branch))) :]
        parents.append(branch[-1])
        branch.append(joint)
    return build_model(parents, kinds, np.random.default_rng(draw(st.integers(0, 2**32 - 1))))


@st.composite
def mountings(draw: st.DrawFn, links: list[str]) -> dict[str, Any]:
    vector = st.lists(st.floats(-1, 1), min_size=3, max_size=3)
    return {"link": draw(st.sampled_from(links)), "xyz": draw(vector), "rpy": draw(vector)}


@st.composite
def robots(draw: st.DrawFn, most: int = 7) -> Robot:
    """Robots on random trees: any log order, some joints rigid, accelerometers, a gyroscope, a tool."""
    model = draw(models(most))
    names = draw(st.permutations(list(model.names)[1:]))
    joints = [spring(name, elastic=draw(st.booleans())) for name in names]
    mounting = mountings([f"link{index}" for index in range(len(names))])
    axes = st.sampled_from(["x", "y", "z", "xy", "xz", "yz", "xyz"])
    sensors = [
        {
            "name": f"sensor{index}",
            "axes": draw(axes),
            "noise_std": draw(st.floats(0.01, 1)),
            **draw(mounting),
        }
        for index in range(draw(st.integers(0, 3)))
    ]
    return Robot.from_pinocchio(model, joints, accelerometers=sensors, gyroscopes=sensors[:1], tool=draw(mounting))


def states(robot: Robot, samples: int = 3, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random q, dq, ddq, each (samples, n), in log order."""
    q, dq, ddq = np.random.default_rng(seed).uniform(-2, 2, (3, samples, robot.n))
    return q, dq, ddq
