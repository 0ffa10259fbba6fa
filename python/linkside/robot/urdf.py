"""URDF files: what is wrong in one is refused by name, before the tree of its joints is built."""

import math
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from os import PathLike, fspath
from typing import Any

import numpy as np

from linkside.errors import ConfigError
from linkside.files.yaml_source import read_text, suggest

from .joints import LinkageConfig
from .tree import Tree
from .urdf_text import numbers as _numbers
from .urdf_text import parse, refuse_deep, refuse_twice
from .urdf_tree import MOMENTS, mass_and_inertia, tree_of

JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")


@dataclass(frozen=True)
class Urdf:
    """A URDF whose structure and inertias are sound.

    Attributes
    ----------
    name : str
        The file as messages call it.
    bare : tuple of str
        Links with a shape and no inertia.
    root
        Its `<robot>` element, without shapes: only the kinematics and the inertias matter.
    """

    name: str
    root: ET.Element
    bare: tuple[str, ...] = ()

    @classmethod
    def read(cls, urdf: str | PathLike[str]) -> "Urdf":
        """Read a file, or XML text; raises ConfigError that names the link or the joint that is wrong."""
        is_text = isinstance(urdf, str) and urdf.lstrip().startswith("<")
        name = "URDF" if is_text else fspath(urdf)
        try:
            root = parse(str(urdf) if is_text else read_text(name))
        except ET.ParseError as error:
            raise ConfigError(f"{name}:{error.position[0]}: not valid XML: {str(error).split(':')[0]}") from None
        except ValueError as error:
            raise ConfigError(f"{name}: {error}") from None
        try:
            bare = tuple(link.get("name", "") for link in root.iter("link") if _has_shape(link))
            _check(root)
        except ValueError as error:
            raise ConfigError(f"{name}: {error}") from None
        return cls(name, root, bare)

    def tree(self) -> Tree:
        """Build the tree, every joint on its own (mimic joints included)."""
        try:
            return tree_of(self.root)
        except ValueError as error:
            raise ConfigError(f"{self.name}: {error}") from None

    def refuse_mimics(self, joints: Collection[str], linkages: Mapping[str, LinkageConfig]) -> None:
        """Refuse a joint that follows another as no linkage says, if either is to move; both locked do no harm."""
        for joint in self.root.iter("joint"):
            mimic = joint.find("mimic")
            if mimic is None or not {joint.get("name"), mimic.get("joint")} & {*joints, *linkages}:
                continue
            leader, follower = mimic.get("joint", ""), joint.get("name", "")
            says = (leader, float(mimic.get("multiplier", 1)), float(mimic.get("offset", 0)))
            ours = linkages.get(follower)
            if ours is None or (ours.follows, ours.ratio, ours.offset) != says:
                raise ConfigError(
                    f"{self.name}: joint '{follower}' is a mimic of '{leader}'; list neither, fix it in the URDF, or "
                    f"write `linkages: {{{follower}: {{follows: {leader}, ratio: {says[1]:g}, offset: {says[2]:g}}}}}` "
                    "into robot.yaml"
                )

    def refuse_impossible_bodies(self, links: Collection[str]) -> None:
        """Refuse a negative mass, or an inertia that is not positive semidefinite, on any of the links."""
        for link in self.root.iter("link"):
            judged = link.find("inertial") is not None and link.get("name") in links
            if judged and (fault := impossible(*mass_and_inertia(link))):
                raise ConfigError(f"{self.name}: link '{link.get('name')}': {fault}")


def impossible(mass: float, inertia: np.ndarray[Any, Any]) -> str:
    """Say why no body has this mass [kg] and inertia about its centre of mass [kg m²]; '' if one may."""
    if not (mass >= 0 and math.isfinite(mass)):
        return f"expected a mass of at least 0, got {mass:g}"
    if not np.isfinite(inertia).all():
        return "expected an inertia of finite numbers"
    least, *_, most = np.linalg.eigvalsh(inertia)
    # URDFs carry six digits: a rod's inertia, singular in truth, may come out negative in the seventh.
    if least < -1e-6 * abs(most) - 1e-12:
        return f"expected a positive semidefinite inertia, got a principal moment of {least:g} kg m²"
    return ""


def _check(root: ET.Element) -> None:
    """Check what makes a URDF; a ValueError names the element, where other readers print and say no more."""
    if root.tag != "robot" or not root.get("name"):
        raise ValueError(f"expected <robot name=…>, got <{root.tag}>")
    links = [link.get("name", "") for link in root.findall("link")]
    joints = root.findall("joint")
    _check_unique("link", links)
    _check_unique("joint", [joint.get("name", "") for joint in joints])
    known = dict.fromkeys(links)
    for joint in joints:
        _check_joint(joint, known)
    children = Counter(joint.find("child").get("link") for joint in joints)  # type: ignore[union-attr]
    if twice := [name for name, count in children.items() if count > 1]:
        raise ValueError(f"link '{twice[0]}' hangs on two joints")
    refuse_deep(root)
    roots = [name for name in links if name not in children]
    if len(roots) != 1:
        raise ValueError(f"expected one link that hangs on no joint, got {' and '.join(roots) or 'none'}")
    for link in root.findall("link"):
        _check_link(link)


def _check_unique(kind: str, names: list[str]) -> None:
    for name, count in Counter(names).items():
        if not name or count > 1:
            raise ValueError(f"{kind} '{name}' is there {count} times" if name else f"a {kind} has no name")


def _check_joint(joint: ET.Element, links: Collection[str]) -> None:
    name, kind = f"joint '{joint.get('name')}'", joint.get("type", "")
    if kind not in JOINT_TYPES:
        raise ValueError(f"{name}: expected a type out of {', '.join(JOINT_TYPES)}, got '{kind}'")
    refuse_twice(joint, "parent", "child", "origin", "axis", "limit", "mimic", "dynamics", "safety_controller")
    for role in ("parent", "child"):
        end = joint.find(role)
        link = "" if end is None else end.get("link", "")
        if link not in links:
            raise ValueError(f"{name}: no {role} link '{link}'; {suggest(link, links)}")
    _check_limit(joint, kind)
    for path, keys in (("dynamics", ("damping", "friction")), ("mimic", ("multiplier", "offset"))):
        _check_optional(joint, path, keys)
    _check_optional(joint, "safety_controller", ("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity"))
    mimic = joint.find("mimic")
    if mimic is not None and not mimic.get("joint"):
        raise ValueError(f"{name}: expected <mimic joint=…>, got a mimic of no joint")
    _check_origin(joint, "origin")
    axis = joint.find("axis")
    if axis is not None and "xyz" not in axis.attrib:
        axis.set("xyz", "1 0 0")  # as the standard has it
    if axis is not None and not any(_numbers(joint, "axis", "xyz", 3)) and kind != "fixed":
        raise ValueError(f"{name}: expected an axis of some length, got 0 0 0")


def _check_limit(joint: ET.Element, kind: str) -> None:
    needed = ("effort", "velocity") if kind in ("revolute", "prismatic") else ()
    for key in needed:
        _numbers(joint, "limit", key)
    _check_optional(joint, "limit", ("lower", "upper", "effort", "velocity"))


def _check_optional(element: ET.Element, path: str, keys: Collection[str]) -> None:
    child = element.find(path)
    for key in keys:
        if child is not None and key in child.attrib:
            _numbers(element, path, key)


def _has_shape(link: ET.Element) -> bool:
    """Whether a link has a shape and no inertia."""
    return link.find("inertial") is None and (link.find("visual") is not None or link.find("collision") is not None)


def _check_link(link: ET.Element) -> None:
    for shape in (*link.findall("visual"), *link.findall("collision")):
        link.remove(shape)
    refuse_twice(link, "inertial")
    inertial = link.find("inertial")
    if inertial is not None:
        refuse_twice(inertial, "mass", "inertia", "origin", owner=f"link '{link.get('name')}'")
        _numbers(link, "inertial/mass", "value")
        for key in MOMENTS:
            _numbers(link, "inertial/inertia", key)
        _check_origin(link, "inertial/origin")


def _check_origin(element: ET.Element, path: str) -> None:
    origin = element.find(path)
    for key in ("xyz", "rpy"):
        if origin is not None and key in origin.attrib:
            _numbers(element, path, key, 3)
