"""A tree from a Pinocchio model, and the other way round; Pinocchio is imported when it is needed."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from linkside.errors import ConfigError

from .rigid import Body, Pose
from .tree import CONTINUOUS, PRISMATIC, REVOLUTE, UNLIMITED, Joint, Link, Tree

KINDS = {
    REVOLUTE: re.compile(r"(R|Revolute)(X|Y|Z|Unaligned)"),
    CONTINUOUS: re.compile(r"(RUB|RevoluteUnbounded)(X|Y|Z|Unaligned)"),  # its q is (cos, sin)
    PRISMATIC: re.compile(r"(P|Prismatic)(X|Y|Z|Unaligned)"),
}
"""What Pinocchio calls joints about or along one axis."""

MODELS = {REVOLUTE: ("R", "Revolute"), CONTINUOUS: ("RUB", "RevoluteUnbounded"), PRISMATIC: ("P", "Prismatic")}
"""Beginnings of their names: of those with an axis of the frame, and of those with any."""

ONE_CONTINUOUS = """<robot name="one"><link name="base"/><link name="link"/><joint name="joint" type="continuous">
<parent link="base"/><child link="link"/><axis xyz="{!r} {!r} {!r}"/></joint></robot>"""


def read(model: Any) -> Tree:
    """Read a `pinocchio.Model`: joints, bodies, and the frames that are links or were put on them."""
    import pinocchio as pin

    joints = [_joint(model, index) for index in range(1, model.njoints)]
    shaped = {pin.FrameType.BODY: True, pin.FrameType.OP_FRAME: False}
    links = [
        Link(frame.name, frame.parentJoint - 1, _pose(frame.placement), shaped[frame.type])
        for frame in model.frames
        if frame.type in shaped
    ]
    fixed = [frame.name for frame in model.frames if frame.type == pin.FrameType.FIXED_JOINT]
    return Tree(model.name, tuple(joints), tuple(links), tuple(fixed))


def build(tree: Tree, gravity: Sequence[float]) -> Any:
    """Build a `pinocchio.Model` whose joints are all of `SINGLE_AXIS`, with a frame for each joint and link.

    Raises
    ------
    ConfigError
        Pinocchio is not there.
    """
    try:
        import pinocchio as pin
    except ImportError:
        raise ConfigError("the robot's Pinocchio model needs Pinocchio: pip install pin") from None
    model = pin.Model()
    model.name = tree.name
    model.gravity.linear = np.array(gravity)
    for joint in tree.joints:
        index = model.addJoint(
            joint.parent + 1, _model(pin, joint), _se3(pin, joint.placement), joint.name, *_limits(joint)
        )
        model.addJointFrame(index)
        model.inertias[index] = _inertia(pin, joint.body)
    for link in tree.links:
        kind = pin.FrameType.BODY if link.shaped else pin.FrameType.OP_FRAME
        model.addFrame(pin.Frame(link.name, link.joint + 1, 0, _se3(pin, link.placement), kind))
    return model


def _joint(model: Any, index: int) -> Joint:
    joint, inertia = model.joints[index], model.inertias[index]
    called = joint.shortname().removeprefix("JointModel")
    kind = next((kind for kind, name in KINDS.items() if name.fullmatch(called)), "")
    limits = (model.lowerPositionLimit, model.upperPositionLimit)
    return Joint(
        model.names[index],
        kind or called.replace("FreeFlyer", "Floating").lower(),
        model.parents[index] - 1,
        _pose(model.jointPlacements[index]),
        _axis(joint) if kind else np.zeros(3),
        UNLIMITED if joint.nq != 1 else (float(limits[0][joint.idx_q]), float(limits[1][joint.idx_q])),
        joint.nv,
        Body(inertia.mass, np.array(inertia.lever), np.array(inertia.inertia)),
    )


def _axis(joint: Any) -> Any:
    """Direction in which it turns or slides; the other half of its subspace is zero."""
    data = joint.createData()
    joint.calc(data, np.array([1.0, 0.0]) if joint.nq == 2 else np.zeros(1))
    linear, angular = np.split(np.asarray(data.S).reshape(6), 2)
    return linear + angular


def _model(pin: Any, joint: Joint) -> Any:
    aligned, skew = MODELS[joint.kind]
    for letter, unit in zip("XYZ", np.eye(3), strict=True):
        if (joint.axis == unit).all():
            return getattr(pin, f"JointModel{aligned}{letter}")()
    if joint.kind != CONTINUOUS:
        return getattr(pin, f"JointModel{skew}Unaligned")(joint.axis)
    return pin.buildModelFromXML(ONE_CONTINUOUS.format(*map(float, joint.axis))).joints[1]  # it has no other way


def _limits(joint: Joint) -> tuple[Any, ...]:
    """No limit of torque and velocity, and those of position; none where Pinocchio's own are right."""
    if joint.limits == UNLIMITED:
        return ()
    return tuple(np.full(1, limit) for limit in (np.inf, np.inf, *joint.limits))


def _inertia(pin: Any, body: Body) -> Any:
    inertia = pin.Inertia.Zero()  # not made of numbers: that refuses what rounding made negative
    inertia.mass, inertia.lever, inertia.inertia = body.mass, body.com, body.inertia
    return inertia


def _pose(placement: Any) -> Pose:
    return Pose(np.array(placement.rotation), np.array(placement.translation))


def _se3(pin: Any, pose: Pose) -> Any:
    return pin.SE3(pose.rotation, pose.translation)
