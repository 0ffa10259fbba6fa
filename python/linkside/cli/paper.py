"""``linkside paper``: the experiment of a paper, repeated."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import click

from linkside.errors import OutputError
from linkside.files.writing import writing
from linkside.papers.names import PAPERS

from .group import main
from .options import check_figure, draw, example
from .terminal import show

FORMATS = ("svg", "png", "pdf")


@main.command(epilog=example("linkside paper deluca2007 --out figures"))
@click.argument("name", metavar="PAPER", type=click.Choice(list(PAPERS)))
@click.option("--out", type=click.Path(), help="Folder for the figures.  [default: the paper's name]")
@click.option(
    "--format", "kind", type=click.Choice(FORMATS), default="svg", show_default=True, help="Format of the figures."
)
@click.option(
    "--recording", type=click.Path(), help="axelsson2012: use the recording in this folder (robot.yaml, log and truth)."
)
@click.option("--tuned", is_flag=True, help="axelsson2012: also compare with tuned noise (half a minute).")
@click.option("--rate", type=click.FloatRange(500), help="ulrich2011: rate of the loop [Hz].  [default: 1000]")
def paper(name: str, out: str | None, kind: str, **settings: Any) -> None:
    """Repeat the experiment of PAPER.

    PAPER is deluca2007, axelsson2012, ulrich2011 or cristofaro2023.

    The experiment is run, its figures are drawn, and its numbers are compared with those of the paper. The loop of
    ulrich2011 runs at 100 kHz in the paper, which takes minutes.
    """
    given = {key: value for key, value in settings.items() if value not in (None, False)}
    for option in given.keys() - TAKES.get(name, set()):
        raise click.UsageError(f"--{option} has no meaning for {name}")
    folder = Path(name if out is None else out)
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{folder}: expected a folder")
    found = import_module(f"linkside.papers.{name}").reproduce(**given)
    show(found.report())
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    for title, figure in found.figures.items():
        path = str(folder / f"{title}.{kind}")
        check_figure(path, [])
        draw(figure, path)


TAKES = {"axelsson2012": {"recording", "tuned"}, "ulrich2011": {"rate"}}
"""Options that belong to one paper."""
