"""Correlations of the errors of a robot's parameters: `tolerances.correlations` of robot.yaml."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import product

import numpy as np

from linkside.arrays import FloatArray
from linkside.files.yaml_source import refusal, suggest

Correlations = Mapping[str, Mapping[str, float]]
"""By the names of two parameters; each pair once, others are independent."""

AXES = "xyz"
OF_JOINTS = (
    *("stiffness", "cubic_stiffness", "damping", "yielding", "mass_scale", "link_friction", "encoder_zero"),
    *("torque_constant", "motor_friction", "motor_inertia"),
)
OF_SENSORS = ("rotation", "translation", "scale")
"""Kinds of numbers that are one for all time; those of accelerometers have an axis as well."""

ROUNDING = 1e-9
"""Largest negative eigenvalue of a correlation matrix that rounding in a file may cause."""

WHERE = ("tolerances", "correlations")


def names(joints: Iterable[str], accelerometers: Iterable[str]) -> list[str]:
    """Give the parameters that may be correlated."""
    return [
        *(f"{kind}_{joint}" for joint, kind in product(joints, OF_JOINTS)),
        *(f"{kind}_{sensor}_{axis}" for sensor, kind, axis in product(accelerometers, OF_SENSORS, AXES)),
    ]


def refuse_impossible(correlations: Correlations, known: Sequence[str]) -> None:
    """Refuse unknown names, pairs of one name or given twice, and values that no errors can have together.

    Parameters
    ----------
    correlations
        What robot.yaml says.
    known
        What there is, by `names`.
    """
    given: set[frozenset[str]] = set()
    for first, second, value in _pairs(correlations):
        for keys in ((first,), (first, second)):
            if keys[-1] not in known:
                raise refusal(f"expected a parameter with a tolerance; {suggest(keys[-1], known)}", *WHERE, *keys)
        if first == second:
            raise refusal("expected two parameters, got one twice", *WHERE, first, second)
        if frozenset((first, second)) in given:
            raise refusal("expected each pair once, it is given the other way round as well", *WHERE, first, second)
        if not abs(value) <= 1:
            raise refusal(f"expected -1 to 1, got {value:g}", *WHERE, first, second)
        given.add(frozenset((first, second)))
    involved = sorted(set().union(*given))
    if involved and (least := float(np.linalg.eigvalsh(matrix(correlations, involved))[0])) < -ROUNDING:
        message = f"expected a positive semi-definite matrix, got one with the eigenvalue {least:.3g}"
        raise refusal(f"{message}: no errors have these correlations together", *WHERE)


def pairs(correlations: Correlations, parameters: Sequence[str]) -> list[tuple[int, int, float]]:
    """Give those between some parameters, by where these are: two indices and a value each."""
    at = {name: index for index, name in enumerate(parameters)}
    return [(at[a], at[b], value) for a, b, value in _pairs(correlations) if a in at and b in at]


def matrix(correlations: Correlations, parameters: Sequence[str]) -> FloatArray:
    """Give those between some parameters as a matrix, (p, p)."""
    out = np.eye(len(parameters))
    for i, j, value in pairs(correlations, parameters):
        out[i, j] = out[j, i] = value
    return out


def _pairs(correlations: Correlations) -> Iterator[tuple[str, str, float]]:
    return ((first, second, value) for first, row in correlations.items() for second, value in row.items())
