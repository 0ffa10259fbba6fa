"""The kinematic tree of a URDF, every joint on its own, those that mimic others included."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections import defaultdict
from dataclasses import replace

import numpy as np

from linkside.arrays import FloatArray

from .rigid import Body, Pose
from .tree import BASE, CONTINUOUS, UNLIMITED, Joint, Link, Tree

FREEDOM = {"floating": 6, "planar": 3}

MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def tree_of(root: ET.Element) -> Tree:
    """Build the tree of a URDF whose elements and numbers were checked.

    Joints are in the order of a walk from the base, those on one link by their names, as Pinocchio has them.

    Raises
    ------
    ValueError
        A link does not hang on the base: names it.
    """
    elements = {link.get("name", ""): link for link in root.findall("link")}
    hanging: dict[str, list[ET.Element]] = defaultdict(list)
    for joint in root.findall("joint"):
        hanging[end(joint, "parent")].append(joint)
    children = {end(joint, "child") for on_link in hanging.values() for joint in on_link}
    base = next(name for name in elements if name not in children)

    joints: list[Joint] = []
    links = [Link(base, BASE, Pose.neutral())]
    waiting = [(joint, links[0]) for joint in _last_first(hanging[base])]
    while waiting:
        joint, parent = waiting.pop()
        link = _hung(joint, parent, joints)
        links.append(link)
        if link.joint != BASE:
            _put_on(joints, link, elements[link.name])
        waiting += [(child, link) for child in _last_first(hanging[link.name])]
    if alone := elements.keys() - {link.name for link in links}:
        raise ValueError(f"link '{min(alone)}' hangs on itself: joints lead from it back to it, not from '{base}'")
    fixed = (joint.get("name", "") for joint in root.findall("joint") if joint.get("type") == "fixed")
    return Tree(root.get("name", ""), tuple(joints), tuple(links), tuple(fixed))


def end(joint: ET.Element, role: str) -> str:
    """Name the link that is a joint's parent or child."""
    element = joint.find(role)
    return "" if element is None else element.get("link", "")


def mass_and_inertia(link: ET.Element) -> tuple[float, FloatArray]:
    """Mass [kg] and inertia (3, 3) [kg m²] of a link that has them."""
    mass, inertia = link.find("inertial/mass"), link.find("inertial/inertia")
    assert mass is not None
    assert inertia is not None
    xx, xy, xz, yy, yz, zz = (float(inertia.get(key, "")) for key in MOMENTS)
    return float(mass.get("value", "")), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _last_first(joints: list[ET.Element]) -> list[ET.Element]:
    return sorted(joints, key=lambda joint: joint.get("name", ""), reverse=True)


def _hung(element: ET.Element, parent: Link, joints: list[Joint]) -> Link:
    """The link that a joint moves, or fixes to its parent; the joint goes to the others, unless it is fixed."""
    child, placement = end(element, "child"), parent.placement * _origin(element.find("origin"))
    kind = element.get("type", "")
    if kind == "fixed":
        return Link(child, parent.joint, placement)
    limits = UNLIMITED if kind == CONTINUOUS else _limits(element.find("limit"))
    joint = Joint(
        element.get("name", ""),
        kind,
        parent.joint,
        placement,
        _axis(element),
        limits,
        FREEDOM.get(kind, 1),
        Body.nothing(),
    )
    joints.append(joint)
    return Link(child, len(joints) - 1, Pose.neutral())


def _put_on(joints: list[Joint], link: Link, element: ET.Element) -> None:
    if element.find("inertial") is None:
        return
    mass, inertia = mass_and_inertia(element)
    at = link.placement * _origin(element.find("inertial/origin"))
    joint = joints[link.joint]
    joints[link.joint] = replace(joint, body=joint.body + Body(mass, np.zeros(3), inertia).seen_from(at))


def _origin(origin: ET.Element | None) -> Pose:
    if origin is None:
        return Pose.neutral()
    return Pose.of(_vector(origin.get("xyz", "0 0 0")), _vector(origin.get("rpy", "0 0 0")))


def _axis(joint: ET.Element) -> FloatArray:
    """The axis at length one; one that lies along a coordinate stays what it is, bit by bit."""
    axis = joint.find("axis")
    x, y, z = (1.0, 0.0, 0.0) if axis is None else _vector(axis.get("xyz", "1 0 0"))
    return np.array([x, y, z]) / math.hypot(x, y, z)


def _limits(limit: ET.Element | None) -> tuple[float, float]:
    """Least and largest position; zero for what is not given, as the standard has it."""
    lower, upper = ("0", "0") if limit is None else (limit.get("lower", "0"), limit.get("upper", "0"))
    return float(lower), float(upper)


def _vector(text: str) -> list[float]:
    return [float(word) for word in text.split()]
