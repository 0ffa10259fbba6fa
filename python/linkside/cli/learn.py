"""``linkside learn``: compute the next command from each repeat of a motion."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from linkside.files.writing import check_writable
from linkside.learning import PathLearning, read, wanted_motion, write
from linkside.recording.estimate import Estimate
from linkside.recording.log import Log
from linkside.robot import Robot
from linkside.text import Titled

from .group import main
from .options import example, kept_limits, limits_of, refuse_clashes
from .terminal import show


class Gains(click.ParamType):  # type: ignore[type-arg]  # generic since click 8.4 only
    """A number for all joints, or one for each, ``2e5,1e5``."""

    name = "gain,gain"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> list[float]:
        """Read the numbers."""
        try:
            return [float(number) for number in str(value).split(",")]
        except ValueError:
            self.fail(f"{value!r} is not a number, nor a list of numbers with commas between", param, ctx)


@main.group(epilog=example("linkside learn start robot.yaml log.parquet --kp 4e5 --kd 1e4 --out learning.parquet"))
def learn() -> None:
    """Improve a motion from repeat to repeat.

    Each repeat is corrected by the estimate of the links in the repeat before (iterative learning control).
    """


@learn.command(
    epilog=example("linkside learn start robot.yaml log.parquet --kp 4e5,2e5 --kd 1e4,6e3 --out learning.parquet")
)
@click.argument("robot", type=click.Path())
@click.argument("motion", type=click.Path())
@click.option("--kp", type=Gains(), required=True, help="Gains of the motors' positions, link side [N m/rad].")
@click.option("--kd", type=Gains(), required=True, help="Gains of the motors' velocities, link side [N m s/rad].")
@click.option("--bandwidth", type=float, help="Learn up to this frequency [Hz].  [default: what converges, at most 20]")
@click.option(
    "--rate",
    type=float,
    default=0.5,
    show_default=True,
    help="1: learn the whole correction at once; less: average noise over repeats.",
)
@click.option("--limits", is_flag=True, help="Keep limits: the URDF's, and those that follow.")
@kept_limits
@click.option("--out", required=True, type=click.Path(), help="State of the iteration, a Parquet file.")
def start(robot: str, motion: str, out: str, limits: bool, **options: Any) -> None:
    """Start learning a MOTION of ROBOT's links.

    MOTION is a file with columns t and qref_<joint>, or q_<joint>. Limits are of the motors' reference, ref_<joint>,
    and of motor torques; the next repeats keep them as far as ROBOT is known.
    """
    refuse_clashes([Path(out)], [robot, motion])
    check_writable(out, (".parquet",))
    loaded = Robot.load(robot)
    settings = {name: options[name] for name in ("kp", "kd", "bandwidth", "rate")}
    if limits or any(options[name] for name in ("ranges", "velocity", "acceleration", "torque")):
        settings["limits"] = limits_of(loaded, options)
    learning = PathLearning(loaded, wanted_motion(motion, loaded), **settings)
    write(learning, out)
    margin = learning.margin
    click.echo(
        f"{out}: {len(learning.motion.t)} rows, learns up to {learning.bandwidth:g} Hz; a repeat brings the correction "
        f"to at most {margin.contraction:.2f} of its distance from its limit, {margin.worst:.2f} on a robot of "
        f"{margin.stiffness:.2f} times the stiffness and {margin.mass:.2f} times the mass"
    )


@learn.command(
    "next", epilog=example("linkside learn next robot.yaml learning.parquet estimate.parquet --out learning.parquet")
)
@click.argument("robot", type=click.Path())
@click.argument("state", type=click.Path())
@click.argument("estimate", type=click.Path())
@click.option("--log", type=click.Path(), help="The recording of the repeat; needed where torques have limits.")
@click.option("--out", required=True, type=click.Path(), help="The new state; may be STATE itself.")
def next_(robot: str, state: str, estimate: str, log: str | None, out: str) -> None:
    """Learn from the ESTIMATE of a repeat.

    The repeat followed the command in STATE; the next command is ref_<joint> of --out.

    Exit status 3: the errors are as small as the estimate's standard deviation can tell, and the command stays.
    """
    refuse_clashes([Path(out)], [robot, estimate, log])
    check_writable(out, (".parquet",))
    loaded = Robot.load(robot)
    learning = read(state, loaded)
    last = learning.learn(Estimate.read(estimate), None if log is None else Log.read(log, loaded))
    write(learning, out)
    show([_trials(learning)])
    if last.held:
        click.echo(f"held back by limits: {', '.join(last.held)}")
    click.echo(f"{out}: the next command")
    if last.reached:
        click.echo(
            "the step is small beside the estimate's standard deviation: more cannot be learnt by such estimates"
        )
        sys.exit(3)


def _trials(learning: PathLearning) -> Titled:
    """A row for each repeat."""
    joints = (f"{name} [mrad]" for name in learning.robot.names)
    table = Titled("Errors, rms", ("repeat", "tool [mm]", *joints, "expected next"))
    for trial in learning.trials:
        tool = "" if trial.tool_rms is None else _deviating(trial.tool_rms, trial.tool_std or 0.0)
        errors = (_deviating(rms, std) for rms, std in zip(trial.rms, trial.std, strict=True))
        table.add_row(str(trial.number), tool, *errors, ", ".join(f"{1e3 * e:.3g}" for e in trial.expected))
    return table


def _deviating(value: float, std: float) -> str:
    return f"{1e3 * value:.4g} ± {1e3 * std:.2g}"
