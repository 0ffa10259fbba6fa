"""Whether the model that was built from a URDF has the masses, inertias and placements that were read."""

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import pinocchio as pin

Array: TypeAlias = npt.NDArray[np.float64]

TOLERANCE = 1e-9
"""Of each number, relative to the largest beside it."""


@dataclass(frozen=True)
class Pose:
    """Rotation (3, 3) and translation (3,) [m]."""

    rotation: Array
    translation: Array

    def __mul__(self, other: "Pose") -> "Pose":
        """One pose after the other."""
        return Pose(self.rotation @ other.rotation, self.rotation @ other.translation + self.translation)


@dataclass(frozen=True)
class Moments:
    """Mass [kg], first moment (3,) [kg m] and inertia about the origin (3, 3) [kg m²]."""

    mass: float
    first: Array
    second: Array

    def __add__(self, other: "Moments") -> "Moments":
        """Two bodies that are one."""
        return Moments(self.mass + other.mass, self.first + other.first, self.second + other.second)

    @classmethod
    def about(cls, mass: float, com: Array, inertia: Array) -> "Moments":
        """Of a body with its centre of mass at ``com`` and ``inertia`` about that."""
        return cls(mass, mass * com, inertia + mass * (com @ com * np.eye(3) - np.outer(com, com)))


def compare(root: ET.Element, model: Any) -> None:
    """Compare a model with the URDF that it was built from, link by link and joint by joint.

    Raises
    ------
    ValueError
        Names the first link or joint that the parser took for something else.
    """
    joints = {joint.find("child").get("link", ""): joint for joint in root.findall("joint")}  # type: ignore[union-attr]
    links = {link.get("name", ""): link for link in root.findall("link")}
    mounts: dict[str, tuple[int, Pose]] = {}
    total: dict[int, Moments] = {}
    for name, link in links.items():
        joint, pose = _mount(name, joints, model, mounts)
        body = _body(link, pose)
        total[joint] = total[joint] + body if joint in total else body
        frame = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
        if frame.parentJoint != joint or not _same(frame.placement, pose):
            raise ValueError(f"link '{name}' is placed elsewhere by the URDF parser than its numbers say")
    for index in range(model.njoints):
        _compare_body(model, index, total.get(index, Moments(0.0, np.zeros(3), np.zeros((3, 3)))))


def _mount(
    name: str, joints: dict[str, ET.Element], model: Any, known: dict[str, tuple[int, Pose]]
) -> tuple[int, Pose]:
    """The joint that moves a link, and the link's pose in that joint's frame; parents before their children."""
    path = []
    while name not in known and name in joints:
        path.append(name)
        name = joints[name].find("parent").get("link", "")  # type: ignore[union-attr]
    if name not in known:
        known[name] = 0, Pose(np.eye(3), np.zeros(3))
    for child in reversed(path):
        joint = joints[child]
        parent, pose = known[joint.find("parent").get("link", "")]  # type: ignore[union-attr]
        here = pose * _pose(joint.find("origin"))
        if joint.get("type") == "fixed":
            known[child] = parent, here
            continue
        index = model.getJointId(joint.get("name"))
        if index >= model.njoints or model.parents[index] != parent or not _same(model.jointPlacements[index], here):
            raise ValueError(f"joint '{joint.get('name')}' is placed elsewhere by the URDF parser than its numbers say")
        _compare_axis(joint, model, index)
        known[child] = index, Pose(np.eye(3), np.zeros(3))
    return known[path[0] if path else name]


def _compare_axis(joint: ET.Element, model: Any, index: int) -> None:
    if model.joints[index].nv != 1:
        return  # such a joint is refused by its type
    axis = joint.find("axis")
    wanted = np.array([1.0, 0.0, 0.0]) if axis is None else _vector(axis.get("xyz", "1 0 0"))
    data = model.joints[index].createData()
    neutral = np.array([1.0, 0.0]) if model.joints[index].nq == 2 else np.zeros(1)
    model.joints[index].calc(data, neutral)
    found = np.asarray(data.S).reshape(6)
    if np.abs(found[:3] + found[3:] - wanted / np.linalg.norm(wanted)).max() > TOLERANCE:
        raise ValueError(f"joint '{joint.get('name')}' has another axis for the URDF parser than its numbers say")


def _compare_body(model: Any, index: int, wanted: Moments) -> None:
    found = model.inertias[index]
    moments = Moments.about(found.mass, np.asarray(found.lever), np.asarray(found.inertia))
    for have, want in ((moments.mass, wanted.mass), (moments.first, wanted.first), (moments.second, wanted.second)):
        if np.abs(np.subtract(have, want)).max() > TOLERANCE * max(1e-12, float(np.abs(want).max())):
            body = f"the body moved by joint '{model.names[index]}'" if index else "the base"
            raise ValueError(f"{body} has another mass or inertia for the URDF parser than its numbers say")


def _body(link: ET.Element, pose: Pose) -> Moments:
    """Mass and moments of a link about the frame of the joint that moves it."""
    inertial = link.find("inertial")
    if inertial is None:
        return Moments(0.0, np.zeros(3), np.zeros((3, 3)))
    at = pose * _pose(inertial.find("origin"))
    mass, of = inertial.find("mass"), inertial.find("inertia")
    assert mass is not None
    assert of is not None
    xx, xy, xz, yy, yz, zz = (float(of.get(key, "0")) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return Moments.about(float(mass.get("value", "0")), at.translation, at.rotation @ inertia @ at.rotation.T)


def _pose(origin: ET.Element | None) -> Pose:
    """Of an <origin>: roll, pitch, yaw about fixed axes, one after the other."""
    if origin is None:
        return Pose(np.eye(3), np.zeros(3))
    roll, pitch, yaw = _vector(origin.get("rpy", "0 0 0"))
    rotation = _about(2, yaw) @ _about(1, pitch) @ _about(0, roll)
    return Pose(rotation, _vector(origin.get("xyz", "0 0 0")))


def _about(axis: int, angle: float) -> Array:
    first, second = (axis + 1) % 3, (axis + 2) % 3
    rotation = np.eye(3)
    rotation[first, first] = rotation[second, second] = np.cos(angle)
    rotation[second, first], rotation[first, second] = np.sin(angle), -np.sin(angle)
    return rotation


def _vector(text: str) -> Array:
    return np.array([float(word) for word in text.split()])


def _same(placement: Any, pose: Pose) -> bool:
    scale = max(1.0, float(np.abs(pose.translation).max()))
    turned = np.abs(placement.rotation - pose.rotation).max() > TOLERANCE
    return not turned and bool(np.abs(placement.translation - pose.translation).max() <= TOLERANCE * scale)
