"""One log: from a file to a file, in bounded memory, wherever that runs."""

from __future__ import annotations

import os
import socket
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from linkside.errors import EstimatorError, LinksideError, NumericalError, RecordingWarning
from linkside.recording.checks.finding import Finding
from linkside.recording.estimate import Estimate, EstimateError
from linkside.recording.log import Log
from linkside.recording.writer import EstimateWriter
from linkside.robot import Robot

from . import kept
from .methods import Run
from .places import local_copy, local_output, state
from .provenance import METADATA, MadeFrom, file_digest, is_up_to_date
from .tally import Tally

Progress: TypeAlias = Callable[[str, int], None]
"""Hears of a log and of how many rows more of it are done."""

Stoppable: TypeAlias = Callable[[], AbstractContextManager[None]]
"""Inside, an estimate may be stopped by another thread."""


@dataclass(frozen=True)
class Recipe:
    """How all logs of a run are estimated.

    ``make`` builds the method, one for each log, which gets ``rows`` at a time; ``uneven`` says whether it takes steps
    of time of any length; at ``rate`` [Hz] logs are resampled; ``made_from`` is what all estimates depend on.
    """

    robot: Robot
    make: Callable[[], Run]
    rows: int
    uneven: bool
    rate: float | None
    check: bool
    made_from: MadeFrom


@dataclass(frozen=True)
class EstimateJob:
    """A log to estimate, the place of its estimate, and a truth to compare it with.

    ``seen`` is what an earlier manifest says of a log in a store: its state, and its digest as long as it has that.
    """

    log: str
    output: str
    truth: str | None = None
    seen: tuple[str, bytes] | None = None


@dataclass
class Outcome:
    """What came of a log.

    Attributes
    ----------
    job
        The log.
    tally
        Counts of its estimate.
    error : LinksideError, optional
        Why there is no estimate.
    kept : bool
        Whether its estimate was there already.
    errors : tuple of EstimateError
        Against the truth, where there is one: of the estimate, and where possible of motors alone.
    conversions, suspicions
        Of the log's units, in words; of the checks of recordings.
    log_digest, made_from, digest : str
        Digests of the log, of all the estimate is made from, and of its file.
    log_state : str, optional
        Of a log in a store: what tells a change without reading it.
    begun, elapsed : float
        When work on it began [s since 1970], and how long it took with reading and writing [s].
    worker : str
        Host and process.
    """

    job: EstimateJob
    tally: Tally = field(default_factory=Tally)
    error: LinksideError | None = None
    kept: bool = False
    errors: tuple[EstimateError, ...] = ()
    conversions: tuple[str, ...] = ()
    suspicions: tuple[Finding, ...] = ()
    log_digest: str = ""
    made_from: str = ""
    digest: str = ""
    log_state: str | None = None
    begun: float = 0.0
    elapsed: float = 0.0
    worker: str = ""

    @property
    def believable(self) -> bool:
        """Whether nothing contradicts it."""
        return self.error is None and self.tally.believable

    @property
    def verdict(self) -> str:
        """In a word or some."""
        if self.error is not None:
            return "not estimated"
        if self.tally.findings or self.tally.status["contradicted"]:
            return "contradicted"
        return "believable" if self.believable else "NIS outside its bounds"


def run(
    recipe: Recipe, job: EstimateJob, progress: Progress, stoppable: Stoppable = nullcontext, *, keep: bool
) -> Outcome:
    """Estimate a log; with ``keep``, an estimate that is there and was made from the same is left alone."""
    outcome = Outcome(job, begun=time.time(), worker=f"{socket.gethostname()}:{os.getpid()}")
    clock = time.perf_counter()
    try:
        outcome.log_state = state(job.log)
        if not (keep and _seen(recipe, outcome)):
            with local_copy(job.log) as log:
                _run(recipe, log, outcome, progress, stoppable, keep=keep)
    except LinksideError as error:
        outcome.error = error
    outcome.elapsed = time.perf_counter() - clock
    return outcome


def _seen(recipe: Recipe, outcome: Outcome) -> bool:
    """Whether the estimate of a log in a store can be left alone without reading the log."""
    seen = outcome.job.seen
    return seen is not None and seen[0] == outcome.log_state and _recalled(recipe, seen[1], outcome)


def _recalled(recipe: Recipe, digest: bytes, outcome: Outcome) -> bool:
    """Recall an estimate that is there and was made from the same."""
    outcome.log_digest, outcome.made_from = digest.hex(), recipe.made_from.with_log(digest)
    told = None
    if is_up_to_date(outcome.job.output, {METADATA: outcome.made_from}):
        told = kept.recall(outcome.job.output)
    if told is None:
        return False
    outcome.kept = True
    outcome.tally, outcome.conversions, outcome.suspicions = told
    return True


def _run(recipe: Recipe, log: str, outcome: Outcome, progress: Progress, stoppable: Stoppable, *, keep: bool) -> None:
    digest = file_digest(log)
    if keep and _recalled(recipe, digest, outcome):
        return
    outcome.log_digest, outcome.made_from = digest.hex(), recipe.made_from.with_log(digest)
    with local_output(outcome.job.output) as path:
        _estimate(recipe, log, path, outcome, progress, stoppable)
        outcome.digest = file_digest(path).hex()


def _estimate(
    recipe: Recipe,
    log: str,
    output: Path,
    outcome: Outcome,
    progress: Progress,
    stoppable: Stoppable,
) -> None:
    truth = outcome.job.truth
    known = None if truth is None else Estimate.read(truth)
    pieces = []
    with EstimateWriter(output, {METADATA: outcome.made_from}) as writer:
        for piece in _pieces(recipe, log, outcome, stoppable):
            writer.write(piece)
            outcome.tally.add(piece)
            progress(outcome.job.log, len(piece))
            if known is not None:
                pieces.append(piece)
        if known is not None:  # still inside: an estimate that cannot be compared as asked is not kept
            with naming(str(truth)):
                outcome.errors = tuple(_errors(recipe.robot, Estimate.concatenate(pieces), known))
        writer.note(kept.record(outcome.tally, outcome.conversions, outcome.suspicions))


def _errors(robot: Robot, estimate: Estimate, known: Estimate) -> Iterator[EstimateError]:
    """How far off the estimate is, and the tool where links are taken to follow their motors, if both are known."""
    yield estimate.error_against(known)
    if robot.tool is not None and known.tool_position is not None and not np.isnan(estimate.theta).any():
        yield replace(estimate, tool_position=robot.tool_position(estimate.theta)).error_against(known)


def _pieces(recipe: Recipe, log: str, outcome: Outcome, stoppable: Stoppable) -> Iterator[Estimate]:
    with naming(log):
        run = recipe.make()
    pieces = outcome.tally.timed(_read(recipe, log, outcome), sign=-1)
    estimates = outcome.tally.timed(run(pieces))
    while True:
        with naming(log), stoppable():
            piece = next(estimates, None)
        if piece is None:
            return
        yield piece


def _read(recipe: Recipe, log: str, outcome: Outcome) -> Iterator[Log]:
    """The pieces of a log; what was converted or is suspicious in them is noted."""
    longest, count, last = 0.0, 0, np.inf
    for piece in read_log(recipe, log):
        outcome.conversions, outcome.suspicions = piece.conversions, piece.findings
        if recipe.rate is None:
            steps = np.diff(piece.t, prepend=min(last, piece.t[0]))
            count += int(np.count_nonzero(steps > piece.pace.longest_step(piece.period)))
            longest, last = max(longest, float(steps.max())), float(piece.t[-1])
        yield piece
    if count:
        text = f"{outcome.job.log}: {count} gaps, the longest of {longest:.6g} s, which the model alone bridges"
        warnings.warn(text, RecordingWarning, stacklevel=2)


def read_log(recipe: Recipe, log: str) -> Iterator[Log]:
    """The pieces of a log, as the method gets them."""
    if recipe.rate is None:
        yield from Log.stream(log, recipe.robot, recipe.rows, allow_gaps=recipe.uneven, check=recipe.check)
        return
    even = Log.read(log, recipe.robot, allow_gaps=True, check=recipe.check).resample(recipe.rate)
    yield from (even[first : first + recipe.rows] for first in range(0, len(even), recipe.rows))


@contextmanager
def naming(source: str) -> Iterator[None]:
    """Let errors of an estimator, which knows of no files, say where they come from."""
    try:
        yield
    except (EstimatorError, NumericalError) as error:
        if source in str(error):
            raise
        raise type(error)(f"{source}: {error}") from error
