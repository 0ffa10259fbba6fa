"""``linkside compile``: an estimator for a controller."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from linkside.errors import EstimatorError
from linkside.files.writing import check_writable
from linkside.fleet import METHODS
from linkside.fleet.task import naming
from linkside.kalman.elastic_joint import ElasticJointFilter
from linkside.kalman.jerk_driven import ExtendedKalmanFilter
from linkside.observers.tuning_file import ObserverTuning
from linkside.robot import Robot
from linkside.robot.compiled import SUFFIX, Compiles
from linkside.velocity.observers import NicosiaTomeiObserver, ReducedOrderObserver

from .group import main
from .options import example, refuse_clashes

Build = Callable[[Robot, Any, float, float | None], Compiles]
"""Of a robot, a tuning, a gain and a sampling period."""

CONTROLLERS: dict[str, Build] = {
    "observer": lambda robot, tuning, _, period: (tuning or ObserverTuning()).observer(robot, period=period),
    "ekf": lambda robot, tuning, *_: ExtendedKalmanFilter(robot, tuning, start="rest"),
    "elastic-ekf": lambda robot, tuning, *_: ElasticJointFilter(robot, tuning, start="rest"),
    "reduced-order": lambda robot, _, gain, period: ReducedOrderObserver(robot, gain, period=period),
    "nicosia-tomei": lambda robot, _, gain, period: NicosiaTomeiObserver(robot, gain, period=period),
}


@main.command("compile", epilog=example("linkside compile robot.yaml --with ekf --out robot.lsr"))
@click.argument("robot", type=click.Path())
@click.option("--with", "method", type=click.Choice(list(CONTROLLERS)), default="observer", show_default=True)
@click.option("--out", required=True, type=click.Path(), help="The file to write: it ends in .lsr.")
@click.option("--tuning", type=click.Path(), help="A tuning file, as `linkside tune` writes it.")
@click.option("--gain", type=float, default=100, show_default=True, help="Gain of a velocity observer [1/s].")
@click.option("--rate", type=float, help="Rate of the controller [Hz].  [default: rate_hz of robot.yaml]")
def compile_robot(robot: str, method: str, out: str, tuning: str | None, gain: float, rate: float | None) -> None:
    """Compile ROBOT and an estimator into one file for a controller.

    The controller then needs no Python. Filters start from rest: switch them on while the robot stands still.
    """
    check_writable(out, (SUFFIX,))
    refuse_clashes([Path(out)], [robot, tuning])
    if tuning is not None and "tuning" not in METHODS[method].takes:
        raise click.UsageError(f"--tuning is not for --with {method}")
    if rate is not None and not 0 < rate < float("inf"):
        raise EstimatorError(f"--rate is {rate}, expected a number of samples a second")
    read = None if tuning is None else METHODS[method].read_tuning(tuning)
    period = None if rate is None else 1 / rate
    with naming(robot):
        signals = CONTROLLERS[method](Robot.load(robot), read, gain, period).compile(out, period=period)
    click.echo(f"{out}: {method}; a sample has " + ", ".join(f"{name} ({n})" for name, n in signals.items()))
