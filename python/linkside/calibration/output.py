"""A robot.yaml with calibrated values and their standard errors; the user's comments and order are kept."""

from __future__ import annotations

import os
from collections.abc import Callable
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from scipy.spatial.transform import Rotation

from linkside.files.writing import write_text
from linkside.files.yaml_source import Source
from linkside.robot.rigid import roll_pitch_yaw, rotation

from .links import OF_BEARINGS, STRENGTHS
from .parameters import AXES, OF_ELEMENTS, OF_LINK_ENCODERS, SHORTEST_FILTER
from .result import Estimated, Result
from .tolerances import errors, readable

Writer = Callable[[Any, Estimated], None]

SECTIONS = {"link_coulomb": ("bearing_friction", "coulomb"), "half_gap": ("backlash", "half_gap")}
"""Where kinds are that a joint has in a section of its own."""


def _folder(path: str | Path) -> str:
    """Where a file is, links followed."""
    return os.path.dirname(os.path.realpath(path))


def write(calibration: Result, source: str | Path, out: str | Path) -> None:
    """Write the calibrated robot.yaml.

    Parameters
    ----------
    calibration
        The outcome.
    source
        The robot.yaml that was calibrated.
    out
        The new one; its ``urdf`` leads to the same file.

    Raises
    ------
    ConfigError
        ``source`` cannot be read.
    """
    tree = copied(source, out)
    for estimated in calibration.estimates:
        if (writer := _WRITERS.get(estimated.parameter.kind)) is not None:
            writer(tree, estimated)
    for index in sorted({e.parameter.core[1] for e in calibration.estimates if e.parameter.kind == "rotation"}):
        _write_rotation(tree["accelerometers"][index], calibration, index)
    _write_errors(tree, calibration)
    dump(tree, out)


def copied(source: str | Path, out: str | Path) -> Any:
    """Read a robot.yaml for a changed copy of it at ``out``, from where ``urdf`` leads to the same file."""
    tree = Source.read(source).tree
    urdf = Path(source).parent / tree["urdf"]
    if _folder(source) != _folder(out) and not os.path.isabs(tree["urdf"]):
        tree["urdf"] = os.path.relpath(os.path.realpath(urdf), _folder(out))
    return tree


def dump(tree: Any, out: str | Path) -> None:
    """Write such a copy, whole or not at all."""
    text = StringIO()
    yaml = YAML()
    yaml.width = 120
    yaml.dump(tree, text)
    write_text(out, text.getvalue())


def rounded(value: float, std: float) -> float:
    """Round a value to two digits of its standard error."""
    if not (np.isfinite(std) and std > 0 and value):
        return float(value)
    return float(round(value, 1 - int(np.floor(np.log10(std)))))


def _put(mapping: Any, key: str, value: Any, after: str | None = None) -> None:
    if key in mapping or after not in mapping:
        mapping[key] = value
    else:
        mapping.insert(list(mapping).index(after) + 1, key, value)


def _note(mapping: Any, key: str, text: str) -> None:
    """Comment at the end of a key's line, behind what is there; not inside braces, where YAML has no place for one."""
    if mapping.fa.flow_style():
        return
    there = mapping.ca.items.get(key)
    old = there[2].value.strip().lstrip("# ") if there and there[2] else ""
    if old:
        there[2].value = f"# {old}; {text}\n" + there[2].value.partition("\n")[2]
    else:
        mapping.yaml_add_eol_comment(text, key)


def _of_joint(tree: Any, e: Estimated) -> None:
    joint = tree["joints"][e.parameter.core[1]]
    if e.parameter.kind == "stiffness":
        joint.pop("stiffness_known", None)  # it is now
    _put(
        joint, e.parameter.kind, rounded(e.value, e.std), "damping" if e.parameter.kind == "mass_scale" else "stiffness"
    )
    _note(joint, e.parameter.kind, f"± {e.std:.2g}")


def _of_friction(tree: Any, e: Estimated) -> None:
    joint = tree["joints"][e.parameter.core[1]]
    _put(joint, "motor_friction", joint.get("motor_friction", _flow_map()), "motor_inertia")
    joint["motor_friction"][e.parameter.kind] = rounded(e.value, e.std)
    _note(joint, "motor_friction", f"{e.parameter.kind} ± {e.std:.2g}")


def _of_element(tree: Any, e: Estimated) -> None:
    """One of the friction elements beside a joint's spring."""
    _, joint, index = e.parameter.core
    element, key = tree["joints"][joint]["hysteresis"][index], e.parameter.kind.partition("_")[2]
    element[key] = rounded(e.value, e.std)
    _note(element, key, f"± {e.std:.2g}")


def _of_torque_constant(tree: Any, e: Estimated) -> None:
    """The parameter is a factor on the one in use; of torques that a log has as such there is none."""
    joint = tree["joints"][e.parameter.core[1]]
    if (constant := joint.get("torque_constant")) is not None:
        joint["torque_constant"] = rounded(constant * e.value, constant * e.std)
        _note(joint, "torque_constant", f"± {constant * e.std:.2g}")


def _of_link_friction(tree: Any, e: Estimated) -> None:
    """The parameter is a factor on all of it."""
    joint = tree["joints"][e.parameter.core[1]]
    if (law := joint.get("link_friction")) is not None:
        for i in STRENGTHS:
            law[i] = rounded(law[i] * e.value, law[i] * e.std)
        _note(joint, "link_friction", f"± {e.std / e.value:.1%}")
    bearing = joint.get("bearing_friction", {})
    for key in (key for key in OF_BEARINGS if bearing.get(key)):
        bearing[key] = rounded(bearing[key] * e.value, bearing[key] * e.std)


def _of_section(tree: Any, e: Estimated) -> None:
    """In a section of a joint of its own."""
    joint = tree["joints"][e.parameter.core[1]]
    section, key = SECTIONS[e.parameter.kind]
    _put(joint, section, joint.get(section, _flow_map()), "stiffness")
    joint[section][key] = rounded(e.value, e.std)
    _note(joint, section, f"{key} ± {e.std:.2g}")


def _of_coupling(tree: Any, e: Estimated) -> None:
    row, column = (tree["joints"][i]["name"] for i in e.parameter.core[1:])
    coupling = tree.setdefault("coupling", CommentedMap())
    coupling.setdefault(row, CommentedMap())[column] = rounded(e.value, e.std)
    _note(coupling[row], column, f"± {e.std:.2g}")


def _of_payload(tree: Any, e: Estimated) -> None:
    _put(tree, "payload", tree.get("payload", CommentedMap()), "tool")
    payload = tree["payload"]
    if e.parameter.kind == "payload_mass":
        payload["mass"] = rounded(e.value, e.std)
        _note(payload, "mass", f"± {e.std:.2g}")
    else:
        _of_vector(payload, "xyz", e, 0.0)


def _of_vector(mapping: Any, key: str, e: Estimated, default: float, added: bool = False) -> None:
    axis = e.parameter.core[2]
    _put(mapping, key, mapping.get(key, _flow_seq([default] * 3)), "noise_std")
    mapping[key][axis] = rounded(e.value + (mapping[key][axis] if added else 0.0), e.std)
    _note(mapping, key, f"{AXES[axis]} ± {e.std:.2g}")


def _of_sensor(tree: Any, e: Estimated) -> None:
    sensor = tree["accelerometers"][e.parameter.core[1]]
    kind = e.parameter.kind
    if kind in ("bias", "scale"):
        _of_vector(sensor, kind, e, 1.0 if kind == "scale" else 0.0)
    elif kind == "translation":
        offset = rotation(sensor.get("rpy", [0.0] * 3))[:, e.parameter.core[2]] * e.value
        _put(sensor, "xyz", sensor.get("xyz", _flow_seq([0.0] * 3)), "link")
        for axis in range(3):
            sensor["xyz"][axis] = float(round(sensor["xyz"][axis] + offset[axis], 6))
        _note(sensor, "xyz", f"along its own {AXES[e.parameter.core[2]]} ± {e.std:.2g}")
    elif kind == "sensor_noise":
        _put(sensor, "noise_std", rounded(sensor.get("noise_std", 0.05) * e.value, 1e-2 * e.value), "rpy")
    else:
        _late(sensor, kind, e)


def _of_link_encoders(tree: Any, e: Estimated) -> None:
    sensor = tree.setdefault("link_encoder", CommentedMap())
    _late(sensor, e.parameter.kind.removeprefix("link_"), e)


def _late(sensor: Any, kind: str, e: Estimated) -> None:
    if kind == "delay":
        _put(sensor, "delay", rounded(e.value, e.std), "noise_std")
        _note(sensor, "delay", f"± {e.std:.2g}")
    elif e.value > 2 * SHORTEST_FILTER:
        corner = 1 / (2 * np.pi * e.value)
        std = corner * e.std / e.value
        _put(sensor, "corner_frequency", rounded(corner, std), "noise_std")
        _note(sensor, "corner_frequency", f"± {std:.2g}")


def _write_rotation(sensor: Any, calibration: Result, index: int) -> None:
    found = {e.parameter.core[2]: e for e in calibration.estimates if e.parameter.core[:2] == ("rotation", index)}
    vector = np.array([found[a].value if a in found else 0.0 for a in range(3)])
    turned = rotation(sensor.get("rpy", [0.0] * 3)) @ Rotation.from_rotvec(vector).as_matrix()
    _put(sensor, "rpy", _flow_seq([float(round(x, 6)) for x in roll_pitch_yaw(turned)]), "xyz")
    _note(sensor, "rpy", "± " + ", ".join(f"{e.std:.2g} about {AXES[a]}" for a, e in sorted(found.items())))


def _write_errors(tree: Any, calibration: Result) -> None:
    """Standard errors in place of the tolerances from which calibration began, for `linkside.robot.considered`."""
    names, covariance = errors(calibration)
    if not names:
        return
    std, correlations = readable(names, covariance)
    tolerances = tree.setdefault("tolerances", CommentedMap())
    tolerances["calibrated"] = {**tolerances.get("calibrated", {}), **dict(zip(names, std, strict=True))}
    old = tolerances.pop("correlations", {})
    kept = {a: {b: x for b, x in row.items() if b not in names} for a, row in old.items() if a not in names}
    if rows := {a: row for a, row in (kept | correlations).items() if row}:
        tolerances["correlations"] = rows


def _flow_map() -> CommentedMap:
    out = CommentedMap()
    out.fa.set_flow_style()
    return out


def _flow_seq(values: list[float]) -> CommentedSeq:
    out = CommentedSeq(values)
    out.fa.set_flow_style()
    return out


_WRITERS: dict[str, Writer] = {
    **dict.fromkeys(("stiffness", "cubic_stiffness", "damping", "motor_inertia", "mass_scale"), _of_joint),
    **dict.fromkeys(("viscous", "coulomb"), _of_friction),
    **dict.fromkeys(("payload_mass", "payload_xyz"), _of_payload),
    **dict.fromkeys(("bias", "scale", "translation", "sensor_noise", "delay", "time_constant"), _of_sensor),
    **dict.fromkeys(OF_ELEMENTS, _of_element),
    "torque_constant": _of_torque_constant,
    **dict.fromkeys(OF_LINK_ENCODERS, _of_link_encoders),
    "link_friction": _of_link_friction,
    **dict.fromkeys(SECTIONS, _of_section),
    "coupling": _of_coupling,
}
