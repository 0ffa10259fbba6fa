"""The kinematic tree of a robot: its joints, the links on them, and what joints can be locked."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from linkside.arrays import FloatArray

from .rigid import Body, Pose

if TYPE_CHECKING:
    from .sensors import FrameConfig

BASE = -1
"""In place of a joint's index: what stands still."""

REVOLUTE, CONTINUOUS, PRISMATIC = SINGLE_AXIS = ("revolute", "continuous", "prismatic")
"""Kinds of joints that linkside works on."""

UNLIMITED = (-np.inf, np.inf)


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint, and all that moves with it up to the joints that it carries.

    Attributes
    ----------
    name : str
        As in the URDF.
    kind : str
        One of `SINGLE_AXIS`, or what it is called that is none of them.
    parent : int
        Index of the joint that carries it, or `BASE`; parents come before their children.
    placement : Pose
        At zero, in the frame of the parent.
    axis : (3,)
        Of length one.
    limits : tuple of float
        Least and largest position [rad or m], as they were given.
    freedom : int
        Degrees of freedom.
    body : Body
        In the joint's own frame.
    """

    name: str
    kind: str
    parent: int
    placement: Pose
    axis: FloatArray
    limits: tuple[float, float] = UNLIMITED
    freedom: int = 1
    body: Body = field(default_factory=Body.nothing)

    @property
    def slides(self) -> bool:
        """Whether it slides instead of turning."""
        return self.kind == PRISMATIC


@dataclass(frozen=True, eq=False)
class Link:
    """A link: the joint that moves it, or `BASE`, and where it is in that joint's frame.

    ``shaped`` tells a link of a URDF from a frame that was put on one.
    """

    name: str
    joint: int
    placement: Pose
    shaped: bool = True


@dataclass(frozen=True, eq=False)
class Tree:
    """Joints and links; constant.

    Attributes
    ----------
    name : str
        Of the robot.
    joints : tuple of Joint
        Each after the one that carries it.
    links : tuple of Link
        All of them.
    fixed : tuple of str
        Joints that do not move.
    """

    name: str
    joints: tuple[Joint, ...]
    links: tuple[Link, ...]
    fixed: tuple[str, ...] = ()

    @cached_property
    def index(self) -> dict[str, int]:
        """Where a joint is in `joints`, by its name."""
        return {joint.name: index for index, joint in enumerate(self.joints)}

    @cached_property
    def link(self) -> dict[str, Link]:
        """Links by name."""
        return {link.name: link for link in self.links}

    @cached_property
    def moving_links(self) -> dict[str, Link]:
        """The links that some joint moves, by name."""
        return {name: link for name, link in self.link.items() if link.joint != BASE}

    def joint(self, name: str) -> Joint:
        """Find a joint by its name."""
        return self.joints[self.index[name]]

    def mount(self, frame: FrameConfig) -> tuple[int, Pose]:
        """Find the joint that moves a sensor or the tool, and the pose in that joint's frame."""
        link = self.link[frame.link]
        return link.joint, link.placement * Pose.of(frame.xyz, frame.rpy)

    def carriers(self, joint: int) -> set[int]:
        """Joints between the base and a joint, itself included."""
        found = set()
        while joint != BASE:
            found.add(joint)
            joint = self.joints[joint].parent
        return found

    def with_bodies(self, bodies: dict[int, Body]) -> Tree:
        """Give the same tree with other bodies on some joints."""
        joints = (replace(joint, body=bodies.get(i, joint.body)) for i, joint in enumerate(self.joints))
        return replace(self, joints=tuple(joints))

    def heavier(self, factor: float) -> Tree:
        """Give the same tree with mass and inertia of all links times a factor."""
        return self.with_bodies({i: joint.body.scaled(factor) for i, joint in enumerate(self.joints)})

    def locked(self, names: Collection[str]) -> Tree:
        """Lock joints at zero: what they move becomes part of what carries them."""
        place: list[tuple[int, Pose]] = []  # of each joint's frame: the joint that moves it now, and where in its frame
        kept: list[Joint] = []
        for joint in self.joints:
            carrier, pose = (BASE, Pose.neutral()) if joint.parent == BASE else place[joint.parent]
            here = pose * joint.placement
            if joint.name not in names:
                place.append((len(kept), Pose.neutral()))
                kept.append(replace(joint, parent=carrier, placement=here))
                continue
            place.append((carrier, here))
            if carrier != BASE:
                kept[carrier] = replace(kept[carrier], body=kept[carrier].body + joint.body.seen_from(here))
        links = (link if link.joint == BASE else _moved(link, *place[link.joint]) for link in self.links)
        return Tree(self.name, tuple(kept), tuple(links), (*self.fixed, *names))


def _moved(link: Link, joint: int, pose: Pose) -> Link:
    return replace(link, joint=joint, placement=pose * link.placement)
