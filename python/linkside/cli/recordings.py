"""``linkside init``, ``merge`` and ``convert``: a robot.yaml and logs to begin with."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from linkside.errors import OutputError
from linkside.files.writing import check_writable, write_text
from linkside.recording.log import Log
from linkside.robot import Robot
from linkside.robot.starter import DRIVES, starter

from . import convert_bag
from .group import main
from .options import example, named_number, no_check, refuse_clashes
from .terminal import rate_lines, show


@main.command(epilog=example("linkside init robot.urdf --gear-ratio joint_1=121"))
@click.argument("urdf", type=click.Path())
@click.option("--out", type=click.Path(), default="robot.yaml", show_default=True, help="The file to write.")
@click.option(
    "--drive", type=click.Choice(list(DRIVES)), default="strain-wave", show_default=True, help="Kind of the gears."
)
@click.option(
    "--gear-ratio",
    "ratios",
    multiple=True,
    metavar="JOINT=N",
    help="Gear ratio of a joint; logs then hold values of the motor shaft.",
)
def init(urdf: str, out: str, drive: str, ratios: tuple[str, ...]) -> None:
    """Start a robot.yaml from URDF, with typical values.

    It lists the joints and links, and gives typical values with their ranges. Lines marked ASKED are for you to fill
    in. The file must not exist yet.
    """
    check_writable(out, (".yaml", ".yml"))
    if Path(out).exists():
        raise OutputError(f"{out}: this file exists already; give another --out")
    given = dict(named_number("--gear-ratio", text) for text in ratios)
    write_text(out, starter(urdf, out, drive=drive, gear_ratios=given))
    click.echo(f"written: {out}")
    click.echo(f"Next, fill in what it asks for (ASKED), then: linkside check {out}")


@main.command(epilog=example("linkside merge robot.yaml joints.parquet imu.csv --out log.parquet"))
@click.argument("robot", type=click.Path())
@click.argument("files", metavar="FILE...", type=click.Path(), nargs=-1, required=True)
@click.option("--out", required=True, type=click.Path(), help="The log to write: a .parquet or .csv file.")
@click.option("--shift", "shifts", multiple=True, metavar="FILE=SECONDS", help="How far the clock of a FILE is ahead.")
@click.option("--rate", type=float, help="Resample to this even rate [Hz]; for observers.")
@no_check
def merge(robot: str, files: tuple[str, ...], out: str, shifts: tuple[str, ...], **options: Any) -> None:
    """Merge FILEs of different sensors into one log, by time.

    Each FILE has a column of time and some of the other columns of ROBOT. The log has a row for each time, and NaN
    where a sensor has no reading.
    """
    check_writable(out)
    refuse_clashes([Path(out)], [robot, *files])
    ahead = dict(named_number("--shift", text) for text in shifts)
    if unknown := set(ahead) - set(files):
        raise click.UsageError(f"--shift {min(unknown)}: this is none of the files {', '.join(files)}")
    loaded = Robot.load(robot)
    each = [ahead.get(file, 0.0) for file in files]
    log = Log.merge(files, loaded, shifts=each, rate=options["rate"], check=not options["no_check"])
    log.write(out)
    click.echo(f"{out}: {log!r}")
    for words in log.conversions:
        click.echo(f"  read with units of robot.yaml, written as recorded: {words}")
    for line in rate_lines(log.rates()):
        click.echo(line)


@main.command(epilog=example("linkside convert bag --joints /joint_states --imu tool_acc=/imu_tool --out log.parquet"))
@click.argument("bag", type=click.Path())
@click.option("--out", type=click.Path(), help="The log to write: a .parquet or .csv file.")
@click.option("--robot", type=click.Path(), help="A robot.yaml with `sources`, instead of these options.")
@click.option(
    "--joints",
    multiple=True,
    metavar="TOPIC[:SIGNAL=PATH,…]",
    help="JointState: position, velocity and effort are columns theta_, dtheta_, tau_JOINT; or arrays of any message.",
)
@click.option("--imu", multiple=True, metavar="NAME=TOPIC", help="Imu: columns NAME_x, _y, _z and NAME_wx, _wy, _wz.")
@click.option("--wrench", multiple=True, metavar="NAME=TOPIC", help="WrenchStamped: NAME_fx, _fy, _fz, _tx, _ty, _tz.")
@click.option("--field", "fields", multiple=True, metavar="COLUMN=TOPIC:PATH", help="A numeric field of any message.")
def convert(bag: str, out: str | None, robot: str | None, **options: tuple[str, ...]) -> None:
    """Convert BAG to a log, or without options list what it contains.

    BAG is an MCAP file, an SQLite file of rosbag2, or the directory of either. Times are the stamps of the messages,
    counted from the first. The log has a row for each time, and NaN where a sensor has no reading. JointState does not
    state the side of the gear: q= assigns positions to the links, theta= to the motors.
    """
    given = any(options.values())
    if given and robot is not None:
        raise click.UsageError("--robot says what to take; leave out the other options, or leave out --robot")
    if out is None:
        if given or robot is not None:
            raise click.UsageError("--out is missing: the log, a file that ends in .parquet or .csv")
        show(convert_bag.contents(bag))
        return
    if not given and robot is None:
        raise click.UsageError(
            "nothing to take: name topics (--joints, --imu, …), or --robot robot.yaml with `sources`"
        )
    check_writable(out)
    refuse_clashes([Path(out)], [bag, *([robot] if robot else [])])
    by = convert_bag.sources(options) if robot is None else Robot.load(robot)
    for line in convert_bag.run(bag, by, out):
        click.echo(line)
