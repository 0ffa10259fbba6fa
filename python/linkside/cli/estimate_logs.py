"""Estimating logs, several at a time: from files to files, in bounded memory."""

from __future__ import annotations

import ctypes
import os
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import get_ident

import numpy as np
from rich.console import RenderableType

from linkside.errors import EstimatorError, LinksideError, NumericalError, OutputError, RecordingWarning
from linkside.recording.checks.finding import Finding
from linkside.recording.estimate import Estimate, EstimateError
from linkside.recording.log import Log
from linkside.recording.opening import log_rows, stem
from linkside.recording.writer import EstimateWriter
from linkside.robot import Robot

from . import kept
from .error_tables import error_tables
from .methods import Run
from .provenance import METADATA, is_up_to_date
from .tally import Tally
from .terminal import bar


@dataclass(frozen=True)
class EstimateJob:
    """A log to estimate, how, and where the estimate and the truth are.

    ``make`` builds the method, one for each log; ``uneven`` says whether it takes steps of time of any length; at
    ``rate`` [Hz] the log is resampled; ``made_from`` says what the estimate depends on.
    """

    robot: Robot
    make: Callable[[], Run]
    rows: int
    uneven: bool
    rate: float | None
    check: bool
    log: str
    output: Path
    truth: str | None
    made_from: Callable[[], str]


@dataclass
class Outcome:
    """The outcome of a log: its tally and tables, or an error.

    ``kept`` where its estimate was there already; ``conversions`` of the log's units, in words, and
    ``suspicions`` of the checks of recordings.
    """

    job: EstimateJob
    tally: Tally = field(default_factory=Tally)
    tables: list[RenderableType] = field(default_factory=list)
    error: LinksideError | None = None
    kept: bool = False
    conversions: tuple[str, ...] = ()
    suspicions: tuple[Finding, ...] = ()

    @property
    def believable(self) -> bool:
        """Whether nothing contradicts the estimate."""
        return self.error is None and self.tally.believable


class Stopped(Exception):
    """The user interrupted the run."""


class Interruption:
    """Stops the threads that estimate.

    A kernel looks for an exception of its thread as it does for Ctrl-C in the main thread. A thread is sent one only
    while it estimates: between a file's making and the line that knows of it, it would leave the file behind.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._stopped = False
        self._estimating: set[int] = set()

    def stop(self) -> None:
        """Raise `Stopped` in each thread, at once or when it goes on to estimate."""
        with self._lock:
            self._stopped = True
            for thread in self._estimating:
                _raise_in(thread, ctypes.py_object(Stopped))

    @contextmanager
    def estimating(self) -> Iterator[None]:
        """Register this thread, so that it can be stopped."""
        thread = get_ident()
        with self._lock:
            if self._stopped:
                raise Stopped
            self._estimating.add(thread)
        try:
            yield
        finally:
            with self._lock:
                self._estimating.discard(thread)
                if self._stopped:
                    _raise_in(thread, None)  # takes back what has not been raised yet
        if self._stopped:
            raise Stopped


def _raise_in(thread: int, error: ctypes.py_object[type[Stopped]] | None) -> None:
    ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), error)


def cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):  # not on macOS and Windows
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def estimate_all(
    jobs: Sequence[EstimateJob], workers: int, tell: Callable[[Outcome], None], *, keep: bool
) -> list[Outcome]:
    """Estimate each log, ``workers`` at a time, and report each when it is done. If one of several cannot be used, the
    others go on; a single one raises its error. With ``keep``, existing estimates that were made from the same inputs
    are skipped.
    """
    counts = [log_rows(job.log) for job in jobs]
    total = None if None in counts else sum(count for count in counts if count is not None)
    interruption = Interruption()
    outcomes: list[Outcome] = []
    with bar(total) as advance, ThreadPoolExecutor(workers) as pool:

        def progress(job: EstimateJob, rows: int) -> None:
            done = f"{len(outcomes)}/{len(jobs)} " if len(jobs) > 1 else ""
            advance(f"{done}{job.log}", rows)

        waiting = {pool.submit(_outcome, job, progress, interruption, keep=keep) for job in jobs}
        try:
            for outcome in _as_completed(waiting):
                if outcome.error is not None and len(jobs) == 1:
                    raise outcome.error
                outcomes.append(outcome)
                tell(outcome)
        except BaseException:  # an interruption, above all
            pool.shutdown(wait=False, cancel_futures=True)
            interruption.stop()
            raise
    return outcomes


def _as_completed(waiting: set[Future[Outcome]]) -> Iterator[Outcome]:
    """Give results as they come; signals are looked at ten times a second."""
    while waiting:
        done, waiting = wait(waiting, timeout=0.1, return_when=FIRST_COMPLETED)
        for future in done:
            yield future.result()


def _outcome(
    job: EstimateJob, progress: Callable[[EstimateJob, int], None], interruption: Interruption, *, keep: bool
) -> Outcome:
    outcome = Outcome(job)
    try:
        metadata = {METADATA: job.made_from()} if job.output.suffix.lower() == ".parquet" else {}
        told = kept.recall(job.output) if keep and is_up_to_date(job.output, metadata) else None
        if told is not None:
            outcome.kept = True
            outcome.tally, outcome.conversions, outcome.suspicions = told
        else:
            _estimate(job, metadata, outcome, progress, interruption)
    except LinksideError as error:
        outcome.error = error
    return outcome


def _estimate(
    job: EstimateJob,
    metadata: dict[str, str],
    outcome: Outcome,
    progress: Callable[[EstimateJob, int], None],
    interruption: Interruption,
) -> None:
    known = None if job.truth is None else Estimate.read(job.truth)
    pieces = []
    with EstimateWriter(job.output, metadata) as writer:
        for piece in _pieces(job, outcome, interruption):
            writer.write(piece)
            outcome.tally.add(piece)
            progress(job, len(piece))
            if known is not None:
                pieces.append(piece)
        with naming(str(job.truth)):  # still inside: an estimate that cannot be compared as asked is not kept
            estimate = None if known is None else Estimate.concatenate(pieces)
            error = None if estimate is None or known is None else estimate.error_against(known)
        writer.note(kept.record(outcome.tally, outcome.conversions, outcome.suspicions))
    if error is not None and estimate is not None and known is not None:
        outcome.tables += error_tables(error, _motors_alone(job.robot, estimate, known), job.robot, str(job.truth))


def _motors_alone(robot: Robot, estimate: Estimate, known: Estimate) -> EstimateError | None:
    """How far off the tool is where links are taken to follow their motors, as far as both are known."""
    if robot.tool is None or known.tool_position is None or np.isnan(estimate.theta).any():
        return None
    return replace(estimate, tool_position=robot.tool_position(estimate.theta)).error_against(known)


def _pieces(job: EstimateJob, outcome: Outcome, interruption: Interruption) -> Iterator[Estimate]:
    with naming(job.log):
        run = job.make()
    pieces = outcome.tally.timed(_read(job, outcome), sign=-1)
    estimates = outcome.tally.timed(run(pieces))
    while True:
        with naming(job.log), interruption.estimating():
            piece = next(estimates, None)
        if piece is None:
            return
        yield piece


def _read(job: EstimateJob, outcome: Outcome) -> Iterator[Log]:
    """The pieces of a log; what was converted or is suspicious in them is noted."""
    longest, count, last = 0.0, 0, np.inf
    for piece in read_log(job):
        outcome.conversions, outcome.suspicions = piece.conversions, piece.findings
        if job.rate is None:
            steps = np.diff(piece.t, prepend=min(last, piece.t[0]))
            count += int(np.count_nonzero(steps > piece.pace.longest_step(piece.period)))
            longest, last = max(longest, float(steps.max())), float(piece.t[-1])
        yield piece
    if count:
        text = f"{job.log}: {count} gaps, the longest of {longest:.6g} s, which the model alone bridges"
        warnings.warn(text, RecordingWarning, stacklevel=2)


def read_log(job: EstimateJob) -> Iterator[Log]:
    """The pieces of a log, as the method gets them."""
    if job.rate is None:
        yield from Log.stream(job.log, job.robot, job.rows, allow_gaps=job.uneven, check=job.check)
        return
    even = Log.read(job.log, job.robot, allow_gaps=True, check=job.check).resample(job.rate)
    yield from (even[first : first + job.rows] for first in range(0, len(even), job.rows))


@contextmanager
def output_folder(out: str, logs: Sequence[str]) -> Iterator[list[Path]]:
    """Name the output of each log; a directory that had to be made for them is gone again if it stays empty."""
    if "{stem}" in out or (len(logs) == 1 and not Path(out).is_dir()):
        yield [Path(out.replace("{stem}", stem(log))) for log in logs]
        return
    folder = Path(out)
    if folder.suffix in (".parquet", ".csv"):
        raise OutputError(f"{out}: one file for {len(logs)} logs; name a directory, or a file with {{stem}}")
    made = not folder.exists()
    folder.mkdir(exist_ok=True)
    try:
        yield [folder / f"{stem(log)}.estimate.parquet" for log in logs]
    finally:
        if made:
            with suppress(OSError):
                folder.rmdir()


@contextmanager
def naming(source: str) -> Iterator[None]:
    """Let errors of an estimator, which knows of no files, say where they come from."""
    try:
        yield
    except (EstimatorError, NumericalError) as error:
        if source in str(error):
            raise
        raise type(error)(f"{source}: {error}") from error
