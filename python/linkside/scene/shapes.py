"""What the links of a robot look like: shapes of its URDF, and lines from joint to joint."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from linkside.arrays import FloatArray
from linkside.errors import ConfigError
from linkside.files.yaml_source import read_text
from linkside.robot import Robot

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
    placement : pinocchio.SE3
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
    placement: Any
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
    model = robot.model
    ends: dict[str, list[FloatArray]] = {name: [] for name in list(model.names)[1:]}
    for index in range(2, model.njoints):
        if model.parents[index] > 0:
            ends[model.names[model.parents[index]]].append(np.array(model.jointPlacements[index].translation))
    if robot.tool is not None:
        at = next(frame for frame in model.frames if frame.name == robot.tool.link and frame.type in _LINKS)
        pose = at.placement * pin.SE3(pin.rpy.rpyToMatrix(*robot.tool.rpy), np.array(robot.tool.xyz))
        ends[model.names[at.parentJoint]].append(np.array(pose.translation))
    return ends


_LINKS = (pin.FrameType.BODY, pin.FrameType.OP_FRAME)


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
    for frame in robot.model.frames:
        if frame.type != pin.FrameType.BODY:
            continue
        link = root.find(f"link[@name='{frame.name}']") if "'" not in frame.name else None
        body = robot.model.names[frame.parentJoint] if frame.parentJoint > 0 else ""
        for visual in [] if link is None else link.findall("visual"):
            placement = frame.placement * _origin(visual.find("origin"))
            for shape in _shape(visual, Path(urdf), found.missing):
                found.shapes.append(Shape(body, frame.name, placement, *shape))
    return found


def _origin(origin: ET.Element | None) -> Any:
    xyz, rpy = (_numbers(None if origin is None else origin.get(key), 3) or (0.0, 0.0, 0.0) for key in ("xyz", "rpy"))
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(xyz))


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
