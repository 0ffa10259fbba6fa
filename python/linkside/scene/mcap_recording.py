"""MCAP with JSON schemas, as PlotJuggler and Foxglove read it."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from linkside.arrays import FloatArray
from linkside.errors import EstimatorError
from linkside.recording.estimate import Status
from linkside.robot import Robot
from linkside.robot.kinematics import body_poses

from .excerpts import Excerpt

NUMBER = {"type": "number"}
TIME = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}


def _fields(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


VECTOR = _fields(x=NUMBER, y=NUMBER, z=NUMBER)
QUATERNION = _fields(x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER)
BY_JOINT = {"type": "object", "additionalProperties": NUMBER}
TRANSFORM = _fields(
    timestamp=TIME,
    parent_frame_id={"type": "string"},
    child_frame_id={"type": "string"},
    translation=VECTOR,
    rotation=QUATERNION,
)

TOPICS: dict[str, tuple[str, dict[str, Any]]] = {
    "/links": ("linkside.Links", _fields(q=BY_JOINT, dq=BY_JOINT, ddq=BY_JOINT, q_std=BY_JOINT, torsion=BY_JOINT)),
    "/motors": ("linkside.Motors", _fields(theta=BY_JOINT, dtheta=BY_JOINT)),
    "/tool": ("linkside.Tool", _fields(position=VECTOR, std=VECTOR, of_motors=VECTOR)),
    "/residuals": ("linkside.Residuals", BY_JOINT),
    "/status": ("linkside.Status", _fields(status={"type": "integer"}, words={"type": "string"}, nis=NUMBER)),
    "/tf": ("foxglove.FrameTransforms", _fields(transforms={"type": "array", "items": TRANSFORM})),
}
"""Schema of each topic. Units are SI; what an estimate lacks is left out."""


def write(robot: Robot, excerpts: Iterable[Excerpt], path: Path) -> None:
    """Write a file; a failure leaves an incomplete ``path``."""
    try:
        from mcap.writer import Writer
    except ImportError:
        raise EstimatorError(f"{path}: mcap is needed to write this: pip install 'linkside[mcap]'") from None
    with path.open("wb") as file:
        writer: Any = Writer(file)
        writer.start(profile="", library="linkside")
        channels: dict[str, int] = {}
        for topic, (name, schema) in TOPICS.items():
            title = {"title": name, **schema}
            number = writer.register_schema(name, "jsonschema", json.dumps(title).encode())
            channels[topic] = writer.register_channel(topic, "json", number)
        for part in excerpts:
            for time, topic, message in _messages(robot, part):
                data = json.dumps(message, allow_nan=False).encode()
                writer.add_message(channels[topic], log_time=time, data=data, publish_time=time)
        writer.finish()


def _messages(robot: Robot, part: Excerpt) -> Iterator[tuple[int, str, dict[str, Any]]]:
    """Messages of each row: its time [ns], its topic, its content."""
    estimate = part.estimate
    joints = estimate.names
    links = {"q": estimate.q, "dq": estimate.dq, "ddq": estimate.ddq, "q_std": estimate.q_std}
    links["torsion"] = estimate.q - estimate.theta
    motors = {"theta": estimate.theta, "dtheta": estimate.dtheta}
    has_tool = estimate.tool_position is not None and robot.tool is not None
    stiff = robot.tool_position(np.ascontiguousarray(estimate.theta)) if has_tool else None
    tool = {"position": estimate.tool_position, "std": estimate.tool_std, "of_motors": stiff}
    residuals = part.residuals(robot)
    poses = {**{f"link {j}": p for j, p in body_poses(robot, estimate.q).items()}}
    poses |= {f"motor {j}": p for j, p in body_poses(robot, estimate.theta).items()}
    places = {name: (pose.translation, pose.quaternion) for name, pose in poses.items()}
    nanoseconds = np.round(1e9 * estimate.t).astype(np.int64)
    for row, time in enumerate(nanoseconds.tolist()):
        yield time, "/links", _rows(links, joints, row)
        yield time, "/motors", _rows(motors, joints, row)
        if has_tool:
            yield time, "/tool", _rows(tool, "xyz", row)
        read = {name: float(values[row]) for name, values in residuals.items() if np.isfinite(values[row])}
        yield time, "/residuals", read
        yield time, "/status", _status(estimate.status[row], None if estimate.nis is None else estimate.nis[row])
        stamp = {"sec": time // 10**9, "nsec": time % 10**9}
        frames = [
            {
                "timestamp": stamp,
                "parent_frame_id": "base",
                "child_frame_id": name,
                "translation": _named("xyz", translation[row]),
                "rotation": _named("xyzw", turn[row]),
            }
            for name, (translation, turn) in places.items()
            if np.isfinite(turn[row]).all()
        ]
        yield time, "/tf", {"transforms": frames}


def _rows(arrays: Mapping[str, FloatArray | None], names: Iterable[str], row: int) -> dict[str, Any]:
    there = {key: array[row] for key, array in arrays.items() if array is not None}
    return {key: _named(names, values) for key, values in there.items()}


def _named(names: Iterable[str], values: FloatArray) -> dict[str, float]:
    return {name: float(value) for name, value in zip(names, values, strict=True) if np.isfinite(value)}


def _status(status: Any, nis: float | None) -> dict[str, Any]:
    flags = Status(int(status))
    words = " ".join(str(flag.name).lower() for flag in Status if flag and flag & flags) or "good"
    told = {"status": int(status), "words": words}
    return told if nis is None or not np.isfinite(nis) else {**told, "nis": float(nis)}
