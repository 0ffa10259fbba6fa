"""Whether a robot's links have the masses that a method needs."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

if TYPE_CHECKING:
    from .joints import JointConfig

LINK_FRAMES = (pin.FrameType.BODY, pin.FrameType.OP_FRAME)

TRIANGLE = 1e-3
"""A principal moment that exceeds the sum of the others by this share is no rounding."""

NEGLIGIBLE = 1e-6
"""Moments of inertia below this are not mentioned [kg m²]."""


def massless(model: Any) -> dict[str, str]:
    """Joints that move nothing with a mass, so that a torque's acceleration is not defined: with their links."""
    carried = [inertia.mass + np.trace(inertia.inertia) for inertia in model.inertias]
    for index in reversed(range(1, model.njoints)):
        carried[model.parents[index]] += carried[index]
    links = {frame.parentJoint: frame.name for frame in reversed(list(model.frames)) if frame.type in LINK_FRAMES}
    return {model.names[i]: links.get(i, "") for i in range(1, model.njoints) if carried[i] == 0}


def impossible_moments(model: Any) -> Iterator[str]:
    """Moving bodies of which one principal moment exceeds the sum of the others, as no body's can."""
    for index in range(1, model.njoints):
        least, middle, most = np.linalg.eigvalsh(model.inertias[index].inertia)
        if most > NEGLIGIBLE and most > (1 + TRIANGLE) * (least + middle):
            moments = f"{least:.4g}, {middle:.4g} and {most:.4g} kg m²"
            yield (
                f"body moved by joint '{model.names[index]}': principal moments of inertia {moments}, the largest more "
                "than the sum of the others, as no body has; correct its <inertia>"
            )


def dropped_armature(model: Any, joints: Sequence[JointConfig]) -> Iterator[str]:
    """Joints whose armature in a Pinocchio model is not the motor inertia that was given."""
    for joint in joints:
        armature = float(model.armature[model.joints[model.getJointId(joint.name)].idx_v])
        motor = joint.motor_inertia or 0.0
        if armature and not np.isclose(armature, motor, rtol=1e-6):
            yield (
                f"joint '{joint.name}': the model's armature of {armature:g} kg m² is not used, its motor_inertia of "
                f"{motor:g} kg m² is; give the armature as motor_inertia, or set it to 0"
            )


def bare_links(model: Any, bare: Collection[str], moving: dict[str, int]) -> Iterator[str]:
    """Links with a shape but no inertia, whose joint moves no mass of its own."""
    for link in bare:
        index = model.frames[moving[link]].parentJoint if link in moving else 0
        if index > 0 and model.inertias[index].mass == 0:
            yield f"link '{link}' has a shape and no inertia, its mass is missing in what follows; add an <inertial>"
