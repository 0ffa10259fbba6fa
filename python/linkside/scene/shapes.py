"""What the links of a robot look like: shapes of its URDF, and lines from joint to joint."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from linkside.arrays import FloatArray
from linkside.errors import ConfigError
from linkside.files.yaml_source import read_text
from linkside.robot import Robot
from linkside.robot.rigid import Pose
from linkside.robot.tree import BASE

MESHES = (".stl", ".obj", ".glb", ".gltf", ".dae")
"""Of files that viewers read."""

LARGEST_MESH = 32 << 20
"""Bytes of a file with a mesh."""


@dataclass(frozen=True)
class Shape:
    """A shape on a body.

    Attributes
    ----------
    body : str
        The joint that moves it; '' for what stands still.
    link : str
        The link of the URDF that it is a shape of.
    placement : Pose
        In the body's frame.
    kind : {"box", "cylinder", "sphere", "mesh"}
        What it is.
    size : tuple of float
        Edges of a box, radius and length of a cylinder, radius of a sphere [m]; scale of a mesh.
    mesh : Path, optional
        The file.
    """

    body: str
    link: str
    placement: Pose
    kind: str
    size: tuple[float, ...]
    mesh: Path | None = None


@dataclass
class Looks:
    """What a robot looks like.

    Attributes
    ----------
    shapes : list of Shape
        Shapes that were found.
    missing : list of str
        Files with meshes that were not.
    """

    shapes: list[Shape] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)


def sticks(robot: Robot) -> dict[str, list[FloatArray]]:
    """Ends of lines from each body's origin to the bodies that it carries and the tool, in its frame, by joint."""
    tree = robot.tree
    ends: dict[str, list[FloatArray]] = {joint.name: [] for joint in tree.joints}
    for joint in tree.joints:
        if joint.parent != BASE:
            ends[tree.joints[joint.parent].name].append(joint.placement.translation)
    if robot.tool is not None:
        carrier, pose = tree.mount(robot.tool)
        ends[tree.joints[carrier].name].append(pose.translation)
    return ends


def looks(robot: Robot, urdf: str | Path) -> Looks:
    """Read the shapes of a URDF's links.

    Raises
    ------
    ConfigError
        The file cannot be read.
    """
    try:
        root = ET.fromstring(read_text(str(urdf)))
    except ET.ParseError as error:
        raise ConfigError(f"{urdf}: not valid XML: {error}") from None
    found = Looks()
    for link in robot.tree.links:
        element = root.find(f"link[@name='{link.name}']") if link.shaped and "'" not in link.name else None
        body = "" if link.joint == BASE else robot.tree.joints[link.joint].name
        for visual in [] if element is None else element.findall("visual"):
            placement = link.placement * _origin(visual.find("origin"))
            for shape in _shape(visual, Path(urdf), found.missing):
                found.shapes.append(Shape(body, link.name, placement, *shape))
    return found


def _origin(origin: ET.Element | None) -> Pose:
    xyz, rpy = (_numbers(None if origin is None else origin.get(key), 3) or (0.0, 0.0, 0.0) for key in ("xyz", "rpy"))
    return Pose.of(xyz, rpy)


def _shape(visual: ET.Element, urdf: Path, missing: list[str]) -> Iterator[tuple[str, tuple[float, ...], Path | None]]:
    geometry = visual.find("geometry")
    for shape in [] if geometry is None else list(geometry):
        sizes = {
            "box": _numbers(shape.get("size"), 3),
            "cylinder": _numbers(f"{shape.get('radius')} {shape.get('length')}", 2),
            "sphere": _numbers(shape.get("radius"), 1),
            "mesh": _numbers(shape.get("scale"), 3) or (1.0, 1.0, 1.0),
        }
        size = sizes.get(str(shape.tag))
        if size is None:
            continue
        if shape.tag != "mesh":
            yield shape.tag, size, None
        elif (file := _mesh(shape.get("filename", ""), urdf)) is not None:
            yield "mesh", size, file
        else:
            missing.append(shape.get("filename", ""))


def _numbers(text: str | None, count: int) -> tuple[float, ...] | None:
    try:
        values = tuple(map(float, (text or "").split()))
    except ValueError:
        return None
    return values if len(values) == count and np.isfinite(values).all() else None


def _mesh(name: str, urdf: Path) -> Path | None:
    """The file of a mesh: beside the URDF, or in a package's folder above it."""
    package, _, inside = name.removeprefix("package://").partition("/")
    places = [urdf.parent / name.removeprefix("file://")]
    if name.startswith("package://"):
        above = urdf.resolve().parents
        places = [folder / package / inside for folder in above] + [f / inside for f in above if f.name == package]
    for place in places:
        if place.suffix.lower() in MESHES and place.is_file() and place.stat().st_size <= LARGEST_MESH:
            return place
    return None
