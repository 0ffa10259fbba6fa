"""Inverse dynamics and its derivatives against Pinocchio called from Python, six joints."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pinocchio as pin
from timing import Result, microseconds

from linkside import Robot

ROBOT = Path(__file__).parents[2] / "tests/data/kr15_six_axes/robot.yaml"
SAMPLES = 5000


def bench() -> Iterator[Result]:
    """Arrays of samples, and one sample a call."""
    robot = Robot.load(ROBOT)
    states = np.random.default_rng(0).uniform(-2, 2, (3, SAMPLES, robot.n))
    model, data = robot.model, robot.model.createData()
    np.testing.assert_allclose(
        robot.inverse_dynamics(*states)[0], pin.rnea(model, data, *states[:, 0]), rtol=1e-10, atol=1e-10
    )
    yield from against("inverse dynamics", robot.inverse_dynamics, lambda *s: pin.rnea(model, data, *s), "rnea", states)
    yield from against(
        "its derivatives",
        robot.inverse_dynamics_derivatives,
        lambda *s: pin.computeRNEADerivatives(model, data, *s),
        "computeRNEADerivatives",
        states,
    )


def against(
    what: str, ours: Callable[..., object], theirs: Callable[..., object], peer: str, states: np.ndarray
) -> Iterator[Result]:
    """One function of linkside, in both ways of calling it."""
    samples = list(zip(*states, strict=True))
    loop = microseconds(lambda: each(theirs, samples), SAMPLES)
    yield Result(f"{what}, array of {SAMPLES}", microseconds(lambda: ours(*states), SAMPLES), f"pinocchio.{peer}", loop)
    yield Result(f"{what}, one a call", microseconds(lambda: each(ours, samples), SAMPLES), f"pinocchio.{peer}", loop)


def each(call: Callable[..., object], samples: list[tuple[np.ndarray, ...]]) -> None:
    """Call for one sample after the other."""
    for sample in samples:
        call(*sample)
