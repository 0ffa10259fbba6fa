"""Scenes as files, by their suffix."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from linkside.arguments import positive
from linkside.files.parts import replacing, spill_folder
from linkside.files.writing import check_writable, writing
from linkside.robot import Robot

from . import mcap_recording, rerun_recording
from .excerpts import excerpts
from .shapes import Looks, looks

SUFFIXES = (".rrd", ".mcap")

PICTURES = 200.0
"""Rows a second that are written."""


def write_scene(
    robot: Robot,
    log: str | Path,
    estimate: str | Path,
    out: str | Path,
    *,
    urdf: str | Path | None = None,
    rate: float = PICTURES,
) -> Looks:
    """Write a robot in motion: ``.rrd`` for Rerun, or ``.mcap`` for PlotJuggler and Foxglove, whole or not at all.

    Parameters
    ----------
    robot
        The robot.
    log, estimate
        The recording, and its estimate as a file.
    out
        The file to write.
    urdf
        Whose shapes to show; without it robots are lines from joint to joint.
    rate
        About how many rows a second to write [Hz].

    Returns
    -------
    Looks
        The shapes, and files with meshes that were not found.

    Raises
    ------
    LogError, EstimatorError
        The files cannot be read, or do not belong together.
    OutputError
        ``out`` cannot be written.
    """
    out = Path(out)
    check_writable(out, SUFFIXES)
    found = Looks() if urdf is None else looks(robot, urdf)
    parts = excerpts(robot, log, estimate, positive("rate", rate))
    with writing(out), spill_folder(Path(os.path.realpath(out)).parent) as folder:
        whole = folder / f"scene{out.suffix.lower()}"
        if whole.suffix == ".rrd":
            rerun_recording.write(robot, found, parts, whole)
        else:
            mcap_recording.write(robot, parts, whole)
        with whole.open("rb") as source, replacing(out) as file:
            shutil.copyfileobj(source, file, 1 << 20)
    return found
