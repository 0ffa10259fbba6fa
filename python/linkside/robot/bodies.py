"""Whether a robot's links have the masses that a method needs."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .tree import BASE

if TYPE_CHECKING:
    from .joints import JointConfig
    from .tree import Tree

TRIANGLE = 1e-3
"""A principal moment that exceeds the sum of the others by this share is no rounding."""

NEGLIGIBLE = 1e-6
"""Moments of inertia below this are not mentioned [kg m²]."""


def massless(tree: Tree) -> dict[str, str]:
    """Joints that move nothing with a mass, so that a torque's acceleration is not defined: with their links."""
    carried = [float(joint.body.mass + np.trace(joint.body.inertia)) for joint in tree.joints]
    for index, joint in reversed(list(enumerate(tree.joints))):
        if joint.parent != BASE:
            carried[joint.parent] += carried[index]
    links = {link.joint: link.name for link in reversed(tree.links)}
    return {joint.name: links.get(i, "") for i, joint in enumerate(tree.joints) if carried[i] == 0}


def impossible_moments(tree: Tree) -> Iterator[str]:
    """Moving bodies of which one principal moment exceeds the sum of the others, as no body's can."""
    for joint in tree.joints:
        least, middle, most = np.linalg.eigvalsh(joint.body.inertia)
        if most > NEGLIGIBLE and most > (1 + TRIANGLE) * (least + middle):
            moments = f"{least:.4g}, {middle:.4g} and {most:.4g} kg m²"
            yield (
                f"body moved by joint '{joint.name}': principal moments of inertia {moments}, the largest more "
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


def bare_links(tree: Tree, bare: Collection[str]) -> Iterator[str]:
    """Links with a shape but no inertia, whose joint moves no mass of its own."""
    for name in bare:
        link = tree.moving_links.get(name)
        if link is not None and tree.joints[link.joint].body.mass == 0:
            yield f"link '{name}' has a shape and no inertia, its mass is missing in what follows; add an <inertial>"
