"""``linkside view``: an estimate for other programs to show."""

from __future__ import annotations

from pathlib import Path

import click

from linkside.files.writing import check_writable
from linkside.fleet.estimating import urdf_of
from linkside.robot import Robot

from .group import main
from .options import example, refuse_clashes

MOST = 3
"""Number of missing files that are named."""


@main.command(epilog=example("linkside view robot.yaml log.parquet estimate.parquet --out motion.rrd"))
@click.argument("robot", type=click.Path())
@click.argument("log", type=click.Path())
@click.argument("estimate", type=click.Path())
@click.option("--out", required=True, type=click.Path(), help="A file that ends in .rrd (Rerun) or .mcap.")
@click.option("--rate", type=float, default=200, show_default=True, help="About how many rows a second to write [Hz].")
def view(robot: str, log: str, estimate: str, out: str, rate: float) -> None:
    """Write an animation of ROBOT for Rerun or Foxglove.

    It shows the links by ESTIMATE and by the motors alone, the tool's path, and the residuals of LOG.

    .rrd is for Rerun (pip install 'linkside[rerun]'; show it with `rerun FILE`), .mcap for PlotJuggler and Foxglove
    (pip install 'linkside[mcap]').
    """
    from linkside.scene import SUFFIXES, write_scene

    check_writable(out, SUFFIXES)
    refuse_clashes([Path(out)], [robot, log, estimate])
    loaded = Robot.load(robot)
    found = write_scene(loaded, log, estimate, out, urdf=urdf_of(robot, loaded), rate=rate)
    if found.missing:
        names = ", ".join(found.missing[:MOST])
        click.echo(f"{len(found.missing)} meshes are missing, and their links are drawn without them: {names}")
    click.echo(f"written: {out}")
