"""Estimating logs one after the other: from files to files, in bounded memory."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import cast

import click

from linkside.errors import EstimatorError, LinksideError, NumericalError, OutputError
from linkside.recording.estimate import Estimate
from linkside.recording.log import Log, log_rows
from linkside.recording.writer import EstimateWriter
from linkside.robot import Robot

from .error_tables import error_tables
from .failures import complain, in_words
from .methods import Run
from .tally import Tally
from .terminal import bar, show


@dataclass(frozen=True)
class EstimateJob:
    """A log to estimate, how, and where the estimate and the truth are."""

    robot: Robot
    run: Run
    rows: int
    check: bool
    log: str
    output: Path
    truth: str | None


def estimate_all(jobs: Sequence[EstimateJob]) -> bool:
    """Estimate each log; of several, one that cannot be used does not keep the others waiting.

    Returns whether all are to be believed.
    """
    failed, believable = 0, True
    counts = [log_rows(job.log) for job in jobs]
    with bar(None if None in counts else sum(cast("list[int]", counts))) as advance:
        for job in jobs:
            try:
                believable &= _estimate_one(job, partial(advance, job.log))
            except LinksideError as error:
                if len(jobs) == 1:
                    raise
                failed += 1
                complain(in_words(error))
    if failed:
        raise click.ClickException(f"{failed} of {len(jobs)} logs could not be estimated")
    return believable


def _estimate_one(job: EstimateJob, advance: Callable[[int], None]) -> bool:
    known = None if job.truth is None else Estimate.read(job.truth)
    tally, kept = Tally(), []
    with EstimateWriter(job.output) as writer:
        for piece in _pieces(job, tally):
            writer.write(piece)
            tally.add(piece)
            advance(len(piece))
            if known is not None:
                kept.append(piece)
        with naming(str(job.truth)):  # still inside: an estimate that cannot be compared as asked is not kept
            error = None if known is None else Estimate.concatenate(kept).error_against(known)
    if error is not None:
        show(error_tables(error, job.robot, str(job.truth)))
    click.echo(f"{job.output}: {tally}")
    for finding in tally.findings:
        click.echo(f"{job.log}: {finding}")
    return tally.believable


def _pieces(job: EstimateJob, tally: Tally) -> Iterator[Estimate]:
    pieces = tally.timed(Log.stream(job.log, job.robot, job.rows, check=job.check), sign=-1)
    estimates = tally.timed(job.run(pieces))
    while True:
        with naming(job.log):
            piece = next(estimates, None)
        if piece is None:
            return
        yield piece


@contextmanager
def output_folder(out: str, logs: Sequence[str]) -> Iterator[list[Path]]:
    """Name the output of each log; a directory that had to be made for them is gone again if it stays empty."""
    if "{stem}" in out or (len(logs) == 1 and not Path(out).is_dir()):
        yield [Path(out.replace("{stem}", _stem(log))) for log in logs]
        return
    folder = Path(out)
    if folder.suffix in (".parquet", ".csv"):
        raise OutputError(f"{out}: one file for {len(logs)} logs; name a directory, or a file with {{stem}}")
    made = not folder.exists()
    folder.mkdir(exist_ok=True)
    try:
        yield [folder / f"{_stem(log)}.estimate.parquet" for log in logs]
    finally:
        if made:
            with suppress(OSError):
                folder.rmdir()


def _stem(log: str) -> str:
    return re.sub(r"\.(parquet|csv|csv\.gz)$", "", Path(log).name, flags=re.IGNORECASE)


@contextmanager
def naming(source: str) -> Iterator[None]:
    """Let errors of an estimator, which knows of no files, say where they come from."""
    try:
        yield
    except (EstimatorError, NumericalError) as error:
        if source in str(error):
            raise
        raise type(error)(f"{source}: {error}") from error
