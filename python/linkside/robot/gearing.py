"""Gears that several motors share: what turns a joint is a sum over motors, as in the wrists of heavy arms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from linkside.arrays import FloatArray
from linkside.files.yaml_source import refusal, suggest

from .joints import JointConfig
from .transmission import Efficiency

MOST = 8
"""No more joints share their motors."""

Shares = Mapping[str, Mapping[str, float]]
"""By joint, and by the joint that a motor belongs to: how far that motor turns it, both as seen behind their gears."""


def shared(gearing: Shares, names: Sequence[str]) -> list[int]:
    """Joints that several motors turn, and those whose motors turn others, in the order of the log."""
    named = {name for row, shares in gearing.items() for name in (row, *shares)}
    return [index for index, name in enumerate(names) if name in named]


def matrix(gearing: Shares, names: Sequence[str]) -> FloatArray:
    """Γ, (n, n): how far each motor, in columns, turns each joint; 1 of its own unless given."""
    found = np.eye(len(names))
    for row, shares in gearing.items():
        for column, share in shares.items():
            found[names.index(row), names.index(column)] = share
    return found


def refuse_impossible(gearing: Shares, joints: Sequence[JointConfig], coupled: Sequence[str]) -> None:
    """Refuse what is no gearing; ``coupled``: joints whose motors have a coupling or a rotor."""
    names = [joint.name for joint in joints]
    for row, shares in gearing.items():
        for keys in ((row,), *((row, column) for column in shares)):
            if keys[-1] not in names:
                raise refusal(f"expected a joint; {suggest(keys[-1], names)}", "gearing", *keys)
            _refuse_drive(joints[names.index(keys[-1])], keys[-1] in coupled, "gearing", *keys)
    block = (found := shared(gearing, names)) and matrix(gearing, names)[np.ix_(found, found)]
    if len(found) > MOST:
        raise refusal(f"expected at most {MOST} joints, got {len(found)}", "gearing")
    if found and not np.linalg.cond(block) < 1e6:
        raise refusal("expected motors that turn each joint on its own: the matrix has no inverse", "gearing")


def _refuse_drive(joint: JointConfig, coupled: bool, *keys: str) -> None:
    if joint.passive or not joint.elastic:
        raise refusal("expected a joint with a motor and a spring", *keys)
    if coupled:
        raise refusal("expected a motor without coupling and rotor, whose inertia is not its own", *keys)
    if joint.motor_friction.load or joint.efficiency != Efficiency():
        raise refusal("expected neither load nor efficiency: the gears' loads are not known one by one", *keys)
    turning = [*(one.of for one in joint.ripple), *(one.of for one in joint.encoder_error.harmonics)]
    if "motor" in turning:
        raise refusal("expected no harmonics of this motor's turns: it turns other joints, too", *keys)
