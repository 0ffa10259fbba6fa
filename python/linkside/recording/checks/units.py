"""Checks of units and of the side of the gear: positions against limits, accelerometers, velocities and commands."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from linkside.arrays import FloatArray

from .finding import Finding, Verdict
from .gravity import DIFFERENT, misfit
from .positions import joint_limits, sliding
from .view import View

WORDS = {
    "degrees": ("is in degrees", "convert it to radians"),
    "neither": (
        "cannot be: limits and accelerometers contradict it",
        "is it in degrees, or of the motor's shaft with another gear_ratio (`columns: {motor_side: true}`)?",
    ),
    "unit": ("is not in the unit that robot.yaml says it is in", "correct `units` there"),
    "motor shaft": ("is of the motor's shaft", "write `columns: {motor_side: true}` into robot.yaml"),
}


def hypotheses(view: View) -> dict[str, FloatArray]:
    """Factors (n,) that would put positions right, by what is wrong with them."""
    slides = np.array(sliding(view.robot))
    out = {"degrees": np.where(slides, 1.0, np.pi / 180)}
    ratio = view.robot.gear_ratio
    stated = view.log.recorded_size("theta") * (ratio if view.robot.columns.motor_side else 1.0)
    if (stated != 1).any():
        out["unit"] = 1 / stated
    if not view.robot.columns.motor_side and (np.abs(ratio) > 1.5).any():
        out["motor shaft"] = 1 / ratio
    return out


def positions(view: View) -> Iterator[Finding]:
    """Find positions in degrees or of the motor's shaft: contradicted by limits or accelerometers, until converted."""
    blocks = view.blocks
    if blocks is None or not len(blocks.row):
        return
    one = np.ones(view.robot.n)
    here, outside = misfit(view, one), _outside(view, one)
    if not (outside.any() or (here is not None and here > DIFFERENT)):
        return
    right = []
    for name, factor in hypotheses(view).items():
        there = misfit(view, factor)
        explained = there is None or here is None or there < max(0.3 * here, 0.3)
        if explained and not _outside(view, factor).any() and (here is not None or outside.any()):
            right.append(name)
    if not right and not (outside.any() and here is not None and here > DIFFERENT):
        return
    joint = int(np.argmax(np.where(outside, np.fmax.reduce(np.abs(view.log.theta)), 0)))
    largest = int(np.nanargmax(np.abs(view.log.theta[:, joint])))
    size = float(view.log.theta[largest, joint])
    what, remedy = (" or ".join(dict.fromkeys(WORDS[n][i] for n in right or ["neither"])) for i in (0, 1))
    # Limits alone may be at fault themselves; accelerometers that agree once converted are certain.
    verdict: Verdict = "suspicious" if here is None else "refused"
    column = view.log.columns("theta")[joint]
    kind = right[0] if right else "units"
    yield view.finding(kind, verdict, column, f"{what}: it reaches {size:.6g},", remedy, at=largest, size=size)


def _outside(view: View, factor: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Joints far beyond their limits, positions times a factor."""
    lower, upper = joint_limits(view.robot)
    reach = 1.5 * np.maximum(np.abs(lower), np.abs(upper)) + 0.5
    return np.asarray(np.fmax.reduce(np.abs(view.log.theta * factor)) > reach)


RATIOS = {
    "has its sign turned": -1.0,
    "is in degrees": 180 / np.pi,
    "is per millisecond of a time in milliseconds": 1e3,
}


def velocities(view: View) -> Iterator[Finding]:
    """Compare recorded motor velocities with what positions do."""
    blocks = view.blocks
    if blocks is None or blocks.speed is None:
        return
    for joint, column in enumerate(view.log.columns("dtheta")):
        moved, said = blocks.dtheta[:, joint], blocks.speed[:, joint]
        there = np.isfinite(moved) & np.isfinite(said)
        x, y = moved[there], said[there]
        if len(x) < 10 or x @ x == 0 or y @ y == 0 or (x @ y) ** 2 < 0.9 * (x @ x) * (y @ y):
            continue
        slope = float(x @ y) / float(x @ x)
        ratio = float(view.robot.gear_ratio[joint])
        known = RATIOS | ({"is of the motor's shaft": ratio} if abs(ratio) > 1.5 else {})
        for words, factor in known.items():
            if abs(slope / factor - 1) < 0.1:
                what, remedy = f"{words}: {slope:.4g} times what the position does", "correct its unit or its sign"
                yield view.finding("velocity", "suspicious", column, what, remedy, size=slope)
