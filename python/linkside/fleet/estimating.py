"""Estimating many logs, here or on a cluster."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from linkside.arguments import whole
from linkside.errors import EstimatorError, OutputError
from linkside.files.writing import check_writable
from linkside.recording.opening import stem
from linkside.robot import Robot
from linkside.robot.config import RobotFile

from .cluster import clear_parts, on_dask
from .manifest import Manifest
from .methods import METHODS, Options
from .places import check_store, is_url, joined, logs_of, plain
from .provenance import MadeFrom
from .task import EstimateJob, Outcome, Progress, Recipe, naming
from .threads import cores, on_threads

ROWS = 8192
"""Rows of a log that are in memory at a time."""

WHOLE = 2**62
"""More rows than a log has."""


def estimate(
    robot: str | Path,
    logs: Sequence[str | Path] | str | Path,
    out: str | Path,
    method: str = "observer",
    *,
    on: str | None = None,
    workers: int | None = None,
    skip_existing: bool = False,
    manifest: str | Path | None = None,
    rate: float | None = None,
    check: bool = True,
    tell: Callable[[Outcome], None] = lambda outcome: None,
    note: Callable[[str], None] = lambda text: None,
    **options: Any,
) -> list[Outcome]:
    """Estimate logs into files, several at a time, with results that do not depend on how many or where.

    Parameters
    ----------
    robot
        A robot.yaml.
    logs
        Paths, globs (``logs/*.parquet``) and URLs (``s3://bucket/logs/*.parquet``).
    out
        A folder or its URL; results are ``<log>.estimate.parquet`` there. Or a name with ``{stem}``.
    method
        Of `METHODS`, as ``linkside estimate --with``.
    on
        None for the threads of this process, ``"dask"`` for processes of this machine, or the address of a scheduler
        of Dask, whose workers reach the same paths or URLs.
    workers
        Logs at a time, on this machine; one a core by default.
    skip_existing
        Skip existing estimates that were made from the same log, robot, settings and version.
    manifest
        A Parquet file for a row of each log, see `Manifest`.
    rate
        Resample logs to this even rate [Hz].
    check
        Whether recordings are checked.
    tell, note
        Called with each outcome, and with the address of the cluster's dashboard.
    **options
        Of the method, as `linkside.fleet.Options` has them; ``tuning`` as the path of a file.

    Returns
    -------
    list of Outcome
        In the order in which they came. The outcome of a log that cannot be used has an error; the others go on.

    Raises
    ------
    LinksideError
        The robot, the settings or the places are wrong; raised before any log is read.
    """
    names = logs_of([str(log) for log in ([logs] if isinstance(logs, (str, Path)) else logs)])
    made = recipe(str(robot), method, rate=rate, check=check, out=str(out), **options)
    with outputs(plain(str(out)), names) as places:
        jobs = [EstimateJob(log, place) for log, place in zip(names, places, strict=True)]
        check_places(jobs, [str(robot)], keep=skip_existing)
        return run_all(
            made,
            jobs,
            on,
            workers,
            tell,
            keep=skip_existing,
            manifest=None if manifest is None else str(manifest),
            note=note,
        )


def recipe(robot: str, method: str, *, rate: float | None, check: bool, out: str, **options: Any) -> Recipe:
    """Check robot and options, and say how to estimate with them; `LinksideError` where they are wrong."""
    if method not in METHODS:
        raise EstimatorError(f"method is {method!r}, expected one of {', '.join(METHODS)}")
    own = METHODS[method]
    if untaken := sorted(set(options) - set(own.takes)):
        raise EstimatorError(f"{untaken[0]} is not for method {method!r}, which takes {', '.join(own.takes) or 'none'}")
    loaded = Robot.load(robot)
    tuning = options.get("tuning")
    files = [robot, urdf_of(robot, loaded), *([tuning] if tuning else [])]
    if tuning is not None:
        options["tuning"] = own.read_tuning(tuning)
    chosen = Options(**options, spill=_spill(out))
    settings = method, rate, not check, {name: getattr(chosen, name) for name in own.takes}
    make = partial(own.build, loaded, chosen)
    with naming(robot):
        make()  # what is wrong with the robot or the options is said before any log is read
    rows = WHOLE if own.whole or chosen.exclude_faulty else ROWS
    return Recipe(loaded, make, rows, own.uneven, rate, check, MadeFrom.of(files, settings))


def run_all(
    recipe: Recipe,
    jobs: Sequence[EstimateJob],
    on: str | None,
    workers: int | None,
    tell: Callable[[Outcome], None],
    progress: Progress = lambda log, rows: None,
    *,
    keep: bool = False,
    manifest: str | None = None,
    note: Callable[[str], None] = lambda text: None,
) -> list[Outcome]:
    """Estimate each log where ``on`` says; the manifest is also written if the run is interrupted."""
    table = None if manifest is None else Manifest(plain(manifest))

    def hear(outcome: Outcome) -> None:
        if table is not None:
            table.add(outcome)
        tell(outcome)

    if table is not None:
        jobs = [replace(job, seen=table.seen(job.output, job.log)) for job in jobs]
    workers = min(cores() if workers is None else whole("workers", workers, 1), len(jobs))
    try:
        if on is None:
            return on_threads(recipe, jobs, workers, hear, progress, keep=keep)
        return on_dask(recipe, jobs, on, workers, hear, note, keep=keep)
    finally:
        if on is not None:
            clear_parts(jobs)
        if table is not None:
            table.write()


@contextmanager
def outputs(out: str, logs: Sequence[str]) -> Iterator[list[str]]:
    """Name the output of each log; a directory that had to be made for them is gone again if it stays empty."""
    file = Path(out).suffix in (".parquet", ".csv") if is_url(out) else Path(out).suffix and not Path(out).is_dir()
    one = len(logs) == 1 and file
    if "{stem}" in out or one:
        yield [out.replace("{stem}", stem(log)) for log in logs]
        return
    if Path(out).suffix in (".parquet", ".csv"):
        raise OutputError(f"{out}: one file for {len(logs)} logs; name a directory, or a file with {{stem}}")
    places = [joined(out, f"{stem(log)}.estimate.parquet") for log in logs]
    if is_url(out):
        yield places
        return
    folder = Path(out)
    made = not folder.exists()
    folder.mkdir(exist_ok=True)
    try:
        yield places
    finally:
        if made:
            with suppress(OSError):
                folder.rmdir()


def check_places(jobs: Sequence[EstimateJob], inputs: Sequence[str | None], *, keep: bool) -> None:
    """Raise `OutputError` where a result could not be written, or would be over another or over what is read."""
    read = [*inputs, *(job.log for job in jobs), *(job.truth for job in jobs)]
    taken = {os.path.realpath(path): "would be written over what is read" for path in read if path is not None}
    stores = set()
    for output in (job.output for job in jobs):
        if (where := os.path.realpath(output)) in taken:
            raise OutputError(f"{output}: {taken[where]}")
        taken[where] = "is the output of two logs; give --out as a name that differs, or run them apart"
        if keep and not output.lower().endswith(".parquet"):
            raise OutputError(f"{output}: only Parquet estimates record their inputs, so that they can be skipped")
        if not is_url(output):
            check_writable(output)
        elif (store := output.rsplit("/", 1)[0]) not in stores:
            check_store(output)
            stores.add(store)


def urdf_of(robot: str, loaded: Robot) -> Path:
    """Where the URDF of a robot.yaml is."""
    assert isinstance(loaded.config, RobotFile)  # it was read from a file
    return Path(robot).parent / loaded.config.urdf


def _spill(out: str) -> Path:
    """A folder for what does not fit into memory: beside the results, if they are on this machine."""
    if is_url(out):
        return Path(tempfile.gettempdir())
    real = Path(os.path.realpath(out))
    return real if real.is_dir() else real.parent
