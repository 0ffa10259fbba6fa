"""A robot.yaml to begin with, from a URDF: what it says, and typical values with their ranges for what it cannot say.

Springs and motors of gears grow with the torque that they are built for. The values follow the URDF's limits of effort
and velocity, if it has them:

- stiffness over peak torque [1/rad]: 170 to 310 for strain-wave gears of sizes 14 to 50 (Harmonic Drive, catalogue of
  CSG component sets: K2 and the limit of repeated peak torque); 340 to 430 for cycloidal gears (Nabtesco, catalogue of
  the RV-E series: torsional rigidity and the torque of acceleration and deceleration). Bearings, links and flanges take
  a part of it away. Those of planetary gears and belts are round figures, without a source.
- reflected motor inertia: peak torque brings the motor alone to its full speed in 30 to 45 ms, by the values that
  Jubien, Gautier and Janot identified for KUKA's LWR IV (IFAC World Congress, 2014) and its limits.
- damping: D = 2 ζ √(K B) with ζ of 1 to 10 %.
"""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from linkside.errors import ConfigError

from .joints import USUAL_FREQUENCY
from .urdf import Urdf


@dataclass(frozen=True)
class Drive:
    """A type of drive: its stiffness over the peak torque, least, typical and greatest [1/rad]; what to know of it."""

    name: str
    stiffness: tuple[float, float, float]
    note: str


DRIVES = {
    "strain-wave": Drive("strain-wave gear", (60.0, 200.0, 310.0), "harder with torque: see stiffness_table"),
    "cycloidal": Drive("cycloidal gear", (150.0, 330.0, 430.0), "play of up to 1 arcmin: see backlash"),
    "planetary": Drive("planetary gear", (100.0, 250.0, 500.0), "play of 1 to 10 arcmin: see backlash"),
    "belt": Drive("belt", (10.0, 50.0, 200.0), "depends on length and tension"),
}
"""By the name that the command line takes."""

SPIN_UP = (0.02, 0.04, 0.2)
"""Time in which peak torque brings a motor alone to full speed, least, typical and greatest [s]."""

DAMPING = (0.01, 0.03, 0.1)
"""Damping ratio of motor and spring."""

ABSURD = 1e5
"""A limit of effort or velocity above this is a placeholder."""


@dataclass(frozen=True)
class _Joint:
    """A joint of a URDF that moves, with its limits, None where there are none to go by."""

    name: str
    link: str
    kind: str
    effort: float | None
    velocity: float | None


def starter(
    urdf: str | PathLike[str],
    beside: str | PathLike[str] = "robot.yaml",
    *,
    drive: str = "strain-wave",
    gear_ratios: Mapping[str, float] | None = None,
) -> str:
    """Write the text of a robot.yaml to begin with.

    Parameters
    ----------
    urdf
        The file.
    beside
        Where the text will be written, which decides how it names the URDF.
    drive
        One of `DRIVES`.
    gear_ratios
        By joint; with any, log columns are taken to be on the motor shaft.

    Raises
    ------
    ConfigError
        The URDF cannot be used, has no joint that moves, or lacks a joint that has a gear ratio.
    """
    if drive not in DRIVES:
        raise ConfigError(f"drive: {drive!r} is not one of {', '.join(DRIVES)}")
    read = Urdf.read(urdf)
    joints = _joints(read.root)
    ratios = dict(gear_ratios or {})
    names = [joint.name for joint in joints]
    if not names:
        raise ConfigError(f"{read.name}: no joint moves: there is nothing to estimate")
    for name, ratio in ratios.items():
        if name not in names:
            raise ConfigError(f"gear ratio of {name!r}: the URDF has no such joint that moves, only {', '.join(names)}")
        if not np.isfinite(ratio) or ratio == 0:
            raise ConfigError(f"gear ratio of {name!r}: expected a number other than 0, got {ratio:g}")
    path = os.path.relpath(Path(urdf), Path(beside).parent)
    last = joints[-1].link
    parts = [
        HEAD.format(urdf=_quoted(path), drive=DRIVES[drive].name, note=DRIVES[drive].note),
        *(_entry(joint, DRIVES[drive], ratios.get(joint.name)) for joint in joints),
        SENSORS.format(links=", ".join(joint.link for joint in joints), last=_quoted(last)),
    ]
    if ratios:
        parts.append("columns: {motor_side: true}    # the log has positions and torques of the motor's shaft\n")
    return "".join(parts)


def _joints(root: ET.Element) -> list[_Joint]:
    """Joints that move on their own and take no other with them, from base to tool."""
    mimicked = {mimic.get("joint") for mimic in root.iter("mimic")}
    elements = [
        e
        for e in root.iter("joint")
        if e.get("type") in ("revolute", "continuous", "prismatic")
        and e.find("mimic") is None
        and e.get("name") not in mimicked
    ]
    return [
        _Joint(
            e.get("name", ""),
            _child(e),
            e.get("type", ""),
            _limit(e, "effort"),
            _limit(e, "velocity"),
        )
        for e in sorted(elements, key=lambda e: _depth(root, e))
    ]


def _child(joint: ET.Element) -> str:
    element = joint.find("child")
    return "" if element is None else element.get("link", "")


def _depth(root: ET.Element, joint: ET.Element) -> int:
    """How many joints are between the base and a joint."""
    above = {_child(j): j for j in root.iter("joint")}
    count, parent = 0, joint.find("parent")
    while parent is not None and (before := above.get(parent.get("link", ""))) is not None:
        count, parent = count + 1, before.find("parent")
    return count


def _limit(joint: ET.Element, key: str) -> float | None:
    element = joint.find("limit")
    value = float(element.get(key, "0")) if element is not None else 0.0
    return value if 0 < value < ABSURD else None


def _entry(joint: _Joint, drive: Drive, ratio: float | None) -> str:
    slides = joint.kind == "prismatic"
    unit = (
        {"K": "N/m", "B": "kg", "D": "N s/m", "F": "N"}
        if slides
        else {"K": "N m/rad", "B": "kg m²", "D": "N m s/rad", "F": "N m"}
    )
    torque, speed = joint.effort, joint.velocity
    lines = [f"- name: {_quoted(joint.name)}"]
    if torque is None or speed is None:
        lines += [
            f"  stiffness: unknown          # no limits to go by; calibration begins at {USUAL_FREQUENCY**2:g} B",
            f"  motor_inertia: 1.0          # ASKED: {unit['B']}, the rotor's inertia times the gear ratio squared",
            "  damping: 0",
        ]
        lines.append(
            f"  gear_ratio: {ratio:g}" if ratio else "  # gear_ratio: 100           # for logs of the motor's shaft"
        )
        return "\n".join(lines) + "\n"
    stiffness = tuple(torque * factor for factor in drive.stiffness)
    inertia = tuple(torque * time / speed for time in SPIN_UP)
    critical = 2 * np.sqrt(stiffness[1] * inertia[1])
    damping = tuple(ratio * critical for ratio in DAMPING)
    lines[0] += f"    # {torque:g} {unit['F']}, {speed:g} {'m/s' if slides else 'rad/s'} at most, by the URDF"
    for key, values, of in (("stiffness", stiffness, "K"), ("motor_inertia", inertia, "B"), ("damping", damping, "D")):
        value = f"  {key}: {_number(values[1])}"
        lines.append(f"{value:<32}# {unit[of]}; typical, {_number(values[0])} … {_number(values[2])}")
    friction = f"  # motor_friction: {{viscous: {_number(0.05 * torque / speed)}, coulomb: {_number(0.05 * torque)}}}"
    lines.append(f"{friction}    # for the observer; each 2 … 15 % of peak torque")
    lines.append(
        f"  gear_ratio: {ratio:g}" if ratio else "  # gear_ratio: 100             # for logs of the motor's shaft"
    )
    return "\n".join(lines) + "\n"


def _number(value: float) -> str:
    """Two digits, as YAML reads a number."""
    rounded = float(f"{value:.2g}")
    return f"{rounded:.1e}" if rounded >= 1e4 else f"{rounded:g}"


def _quoted(text: str) -> str:
    """A YAML string: plain where that is safe."""
    plain = text.replace("_", "").replace("/", "").replace("-", "").replace(".", "").isalnum() and text[0].isalpha()
    return text if plain and text.lower() not in WORDS else "'" + text.replace("'", "''") + "'"


WORDS = ("y", "n", "yes", "no", "on", "off", "true", "false", "null")

HEAD = """\
# Begun by `linkside init`. All values are on the link side of the gear, in SI units. Typical values follow the URDF's
# limits of effort and velocity, for a {drive} ({note});
# they are guesses: replace each by a data sheet's, or write `stiffness: unknown`, and let `linkside calibrate` find it.
# Sources and ranges: docs/start.md of linkside.
urdf: {urdf}
# rate_hz: 1000               # ASKED for `step`: the controller's rate
# gravity: [0, 0, -9.81]      # ASKED if the robot hangs, or stands on a slope
joints:                       # ASKED: in the order of the log; take out what does not move
"""

SENSORS = """\
tolerances: {{stiffness: 0.7, motor_inertia: 0.7}}    # typical values: to within a factor of 2
encoder: {{resolution: 1.0e-6}}    # ASKED: rad at the link, 2π / (counts a turn × gear ratio)
torque: {{noise_std: 1.0}}         # N m; a per mille of peak torque
tool: {{link: {last}, xyz: [0, 0, 0]}}    # ASKED: the point whose path counts, in the link's frame
# ASKED: sensors, on any of the links {links}
# noise_std is the noise density times √(1.57 × bandwidth): 0.006 m/s² of 22 µg/√Hz at 500 Hz, 0.06 of 230 µg/√Hz
accelerometers: []
# - {{name: tool_acc, link: {last}, xyz: [0, 0, 0.05], rpy: [0, 0, 0], noise_std: 0.05}}
"""
