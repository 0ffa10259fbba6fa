"""Rerun's recordings (.rrd): the robot by its links and by its motors, the tool's path, and signals over time."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from linkside.arrays import FloatArray
from linkside.errors import EstimatorError
from linkside.recording.estimate import Status
from linkside.robot import Robot
from linkside.robot.kinematics import body_poses

from .excerpts import Excerpt
from .shapes import Looks, Shape, sticks

LINKS, GHOST = "robot/links", "robot/motors"
BLUE, ORANGE, GREY = (0, 114, 178), (213, 94, 0), (120, 120, 120)
FLATTEST = 1e-6
"""Standard deviation from which on an ellipsoid has a volume that is seen [m]."""

THIN = 0.012
"""Radius of a stick [m]."""


def write(robot: Robot, looks: Looks, excerpts: Iterable[Excerpt], path: Path) -> None:
    """Write a recording; a failure leaves an incomplete ``path``."""
    try:
        import rerun as rr
        from rerun.chunk import RrdReader
    except ImportError:
        raise EstimatorError(f"{path}: rerun-sdk is needed to write this: pip install 'linkside[rerun]'") from None
    recording = rr.RecordingStream("linkside", recording_id=robot.tree.name or "robot", send_properties=False)
    try:
        recording.save(path)
        try:
            _Scene(rr, recording, robot, looks).write(excerpts)
        finally:
            recording.flush()
            recording.disconnect()
        for _ in RrdReader(path).stream():  # a write that fails in Rerun's own thread is not reported, and shows here
            pass
    except RuntimeError as error:  # of Rerun
        raise OSError(str(error)) from error


class _Scene:
    def __init__(self, rr: Any, recording: Any, robot: Robot, looks: Looks) -> None:
        self._rr, self._recording, self._robot, self._looks = rr, recording, robot, looks
        self._status: int | None = None
        self._paths: dict[str, list[FloatArray]] = {"links": [], "motors": []}

    def write(self, excerpts: Iterable[Excerpt]) -> None:
        self._recording.log("/", self._rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._bodies()
        for part in excerpts:
            self._poses(LINKS, part, part.estimate.q)
            self._poses(GHOST, part, part.estimate.theta)
            self._tool(part)
            self._signals(part)
            self._say_status(part)
        for name, colour in (("links", BLUE), ("motors", ORANGE)):
            if self._paths[name]:
                strip = self._rr.LineStrips3D([np.concatenate(self._paths[name])], colors=[colour])
                self._recording.log(f"tool/path_of_{name}", strip, static=True)
        self._recording.send_blueprint(self._blueprint())

    def _bodies(self) -> None:
        """What is seen of each body; where the URDF shows nothing, lines from joint to joint."""
        shown = {shape.body for shape in self._looks.shapes}
        for root, colour, alpha in ((LINKS, BLUE, 255), (GHOST, ORANGE, 70)):
            for number, shape in enumerate(self._looks.shapes):
                self._shape(f"{root}/{_name(shape.body)}/{_name(shape.link)}_{number}", shape, (*colour, alpha))
            for joint, ends in sticks(self._robot).items():
                if joint not in shown and ends:
                    strips = [[np.zeros(3), end] for end in ends]
                    lines = self._rr.LineStrips3D(strips, colors=[(*colour, alpha)], radii=[THIN])
                    self._recording.log(f"{root}/{_name(joint)}/stick", lines, static=True)

    def _shape(self, entity: str, shape: Shape, colour: tuple[int, ...]) -> None:
        rr = self._rr
        pose = rr.Transform3D(translation=shape.placement.translation, mat3x3=shape.placement.rotation)
        self._recording.log(entity, pose, static=True)
        if shape.kind == "mesh":
            scaled = rr.Transform3D(scale=list(shape.size))
            self._recording.log(
                f"{entity}/mesh", scaled, rr.Asset3D(path=shape.mesh, albedo_factor=colour), static=True
            )
            return
        solid = {"colors": [colour], "fill_mode": "solid"}
        made = {
            "box": lambda: rr.Boxes3D(sizes=[shape.size], **solid),
            "cylinder": lambda: rr.Cylinders3D(radii=[shape.size[0]], lengths=[shape.size[1]], **solid),
            "sphere": lambda: rr.Ellipsoids3D(half_sizes=[[shape.size[0]] * 3], **solid),
        }[shape.kind]()
        self._recording.log(f"{entity}/{shape.kind}", made, static=True)

    def _poses(self, root: str, part: Excerpt, q: FloatArray) -> None:
        there = np.isfinite(q).all(axis=1)
        for joint, pose in body_poses(self._robot, q[there]).items():
            columns = self._rr.Transform3D.columns(translation=pose.translation, quaternion=pose.quaternion)
            self._send(f"{root}/{_name(joint)}", part.estimate.t[there], columns)

    def _tool(self, part: Excerpt) -> None:
        estimate = part.estimate
        if estimate.tool_position is None or self._robot.tool is None:
            return
        stiff = self._robot.tool_position(np.ascontiguousarray(estimate.theta))
        for name, place, colour in (("links", estimate.tool_position, BLUE), ("motors", stiff, ORANGE)):
            there = np.isfinite(place).all(axis=1)
            if (count := int(there.sum())) == 0:
                continue
            self._paths[name].append(place[there])
            points = self._rr.Points3D.columns(positions=place[there], colors=[colour] * count, radii=[0.006] * count)
            self._send(f"tool/of_{name}", estimate.t[there], points)
        if estimate.tool_std is not None:
            sizes = 2 * np.maximum(estimate.tool_std, FLATTEST)
            ball = self._rr.Ellipsoids3D.columns(half_sizes=sizes, centers=estimate.tool_position)
            self._send("tool/two_sigma", estimate.t, ball)
            self._scalar("tool_two_sigma_mm", estimate.t, 1e3 * np.linalg.norm(sizes, axis=1))
        bend = 1e3 * np.linalg.norm(estimate.tool_position - stiff, axis=1)
        self._scalar("tool_from_motors_mm", estimate.t, bend)

    def _signals(self, part: Excerpt) -> None:
        estimate = part.estimate
        for index, joint in enumerate(estimate.names):
            self._scalar(f"torsion/{_name(joint)}", estimate.t, (estimate.q - estimate.theta)[:, index])
            if estimate.q_std is not None:
                self._scalar(f"two_sigma/{_name(joint)}", estimate.t, 2 * estimate.q_std[:, index])
        for column, values in part.residuals(self._robot).items():
            self._scalar(f"residual/{_name(column)}", part.log.t, values)
        if estimate.nis is not None:
            self._scalar("nis", estimate.t, estimate.nis)
        self._scalar("status", estimate.t, estimate.status.astype(float))

    def _say_status(self, part: Excerpt) -> None:
        """A line of text wherever the status changes."""
        status = part.estimate.status
        changes = np.flatnonzero(np.diff(status, prepend=-1 if self._status is None else self._status))
        for row in changes:
            flags = Status(int(status[row]))
            words = " ".join(str(flag.name).lower() for flag in Status if flag and flag & flags) or "good"
            level = "INFO" if not flags else "ERROR" if flags & (Status.CONTRADICTED | Status.FAULTY) else "WARN"
            self._recording.set_time("time", duration=float(part.estimate.t[row]))
            self._recording.log("status_in_words", self._rr.TextLog(words, level=level))
        self._recording.reset_time()
        self._status = int(status[-1])

    def _scalar(self, entity: str, t: FloatArray, values: FloatArray) -> None:
        there = np.isfinite(values)
        if there.any():
            self._send(entity, t[there], self._rr.Scalars.columns(scalars=values[there]))

    def _send(self, entity: str, t: FloatArray, columns: Any) -> None:
        self._recording.send_columns(entity, indexes=[self._rr.TimeColumn("time", duration=t)], columns=columns)

    def _blueprint(self) -> Any:
        import rerun.blueprint as views

        signals = [views.TimeSeriesView(origin=f"/{name}") for name in ("torsion", "residual", "nis", "status")]
        space = views.Spatial3DView(origin="/", name="robot")
        beside = views.Vertical(*signals, views.TextLogView(origin="/status_in_words"))
        return views.Blueprint(views.Horizontal(space, beside), collapse_panels=True)


def _name(text: str) -> str:
    """A part of an entity's path: Rerun escapes what is not a letter, a digit, or one of these."""
    return "".join(c if c.isalnum() or c in "_-." else "_" for c in text) or "base"
