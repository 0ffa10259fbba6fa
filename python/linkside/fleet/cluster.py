"""Estimating logs on Dask: processes of this machine, or the workers of any scheduler.

A task is one log. What it leaves is a file that is whole and the same bits wherever it ran, so that a task whose worker
was lost runs again elsewhere, and one that ran twice has done no harm.
"""

from __future__ import annotations

import logging
import pickle
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from linkside.errors import EstimatorError, LinksideError, LinksideWarning
from linkside.files.parts import clear

from .places import is_url
from .provenance import installed
from .task import EstimateJob, Outcome, Recipe, run

HERE = "dask"
"""Stands for processes of this machine."""

PATIENCE = 10.0
"""How long a scheduler may take to answer [s]."""


def on_dask(
    recipe: Recipe,
    jobs: Sequence[EstimateJob],
    address: str,
    workers: int,
    tell: Callable[[Outcome], None],
    note: Callable[[str], None],
    *,
    keep: bool,
) -> list[Outcome]:
    """Estimate each log as a task, and tell of each when it is done.

    Parameters
    ----------
    recipe, jobs
        How to estimate, and what.
    address
        Of a scheduler, ``tcp://host:8786``, or `HERE`.
    workers
        Processes of this machine, for `HERE`.
    tell
        Hears of each outcome, in the order in which they come.
    note
        Hears where the cluster's dashboard is, if it has one.
    keep
        Whether estimates that are there and were made from the same are left alone.

    Raises
    ------
    EstimatorError
        Without Dask, without a scheduler at the address, or where that is lost.
    """
    distributed = _distributed()
    pickled = distributed.protocol.pickle.dumps(recipe)
    outcomes: list[Outcome] = []
    with _client(distributed, address, workers) as client:
        if client.dashboard_link and find_spec("bokeh"):
            note(f"dashboard: {client.dashboard_link}")
        futures = {client.submit(_on_worker, pickled, job, keep, pure=False): job for job in jobs}
        try:
            for future in distributed.as_completed(list(futures)):
                outcomes.append(_outcome(distributed, future, futures.pop(future)))
                future.release()
                tell(outcomes[-1])
        except (CancelledError, OSError) as error:
            raise EstimatorError(
                f"the scheduler {address} was lost after {len(outcomes)} of {len(jobs)} logs: {error}; what is "
                "written is whole, and the same run with those skipped that are there goes on"
            ) from error
        finally:
            client.cancel(list(futures))
    return outcomes


def _on_worker(pickled: bytes, job: EstimateJob, keep: bool) -> tuple[dict[str, Any], list[LinksideWarning]]:
    """Estimate a log; all of its outcome but the job, which the client has, and what was warned of."""
    recipe = _recipe(pickled)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", LinksideWarning)
        found = vars(run(recipe, job, lambda log, rows: None, keep=keep))
    told = [one.message for one in caught if isinstance(one.message, LinksideWarning)]
    return {name: value for name, value in found.items() if name != "job"}, told


@lru_cache(4)
def _recipe(pickled: bytes) -> Recipe:
    """Unpack a recipe once a worker."""
    recipe: Recipe = pickle.loads(pickled)
    if recipe.made_from.version != installed():
        raise EstimatorError(
            f"a worker has linkside {installed()}, expected {recipe.made_from.version}: results would not be the same"
        )
    return recipe


def _outcome(distributed: Any, future: Any, job: EstimateJob) -> Outcome:
    try:
        found, told = future.result()
    except distributed.scheduler.KilledWorker as error:
        lost = f"{job.log}: {error.allowed_failures + 1} workers died while they estimated this; out of memory?"
        return Outcome(job, error=EstimatorError(lost))
    except LinksideError as error:
        return Outcome(job, error=error)
    for warning in told:
        warnings.warn(warning, stacklevel=2)
    return Outcome(job, **found)


@contextmanager
def _client(distributed: Any, address: str, workers: int) -> Iterator[Any]:
    """Connect to a scheduler; one of this machine is there as long as its client."""
    if address != HERE:
        try:
            client = distributed.Client(address, timeout=PATIENCE)
        except (OSError, ValueError) as error:
            raise EstimatorError(f"no scheduler of Dask at {address}: {error}") from error
        with client:
            yield client
        return
    settings = {"n_workers": workers, "threads_per_worker": 1, "dashboard_address": "127.0.0.1:0"}
    cluster = distributed.LocalCluster(**settings, silence_logs=logging.CRITICAL)
    with cluster, distributed.Client(cluster) as client:
        yield client


def clear_parts(jobs: Sequence[EstimateJob]) -> None:
    """Remove what workers that were killed have left beside their outputs."""
    for folder in {Path(job.output).resolve().parent for job in jobs if not is_url(job.output)}:
        clear(folder)


def _distributed() -> Any:
    try:
        import distributed
    except ImportError:
        raise EstimatorError("Dask is needed for this: pip install 'linkside[fleet]'") from None
    return distributed
