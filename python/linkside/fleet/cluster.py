"""Work for each log on Dask: on processes of this machine, or the workers of any scheduler.

A task is one log. Its result, a whole file or a few arrays, has the same bits wherever it runs, so that a task whose
worker was lost can be repeated elsewhere, and a task that ran twice does no harm.
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
from linkside.mapping import Map, Result, Task

from .places import is_url
from .provenance import installed
from .task import EstimateJob, Outcome, Recipe, run

HERE = "dask"
"""The address that means processes of this machine."""

PATIENCE = 10.0
"""How long a scheduler may take to answer [s]."""


class _Died(EstimatorError):
    """A task that kills its workers."""


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
    """Estimate each log as a task, and report each when it is done.

    Parameters
    ----------
    recipe, jobs
        How to estimate, and what.
    address
        Of a scheduler, ``tcp://host:8786``, or `HERE`.
    workers
        Processes of this machine, for `HERE`.
    tell
        Called with each outcome, in the order in which they come.
    note
        Called with the address of the dashboard, if there is one.
    keep
        Whether existing estimates that were made from the same inputs are skipped.

    Raises
    ------
    EstimatorError
        Dask is not installed, there is no scheduler at the address, or it was lost.
    """
    distributed = _distributed()
    pickled = distributed.protocol.pickle.dumps(recipe)
    outcomes: list[Outcome] = []
    with _client(distributed, address, workers, note) as client:
        futures = {client.submit(_on_worker, pickled, job, keep, pure=False): job for job in jobs}
        try:
            for future in distributed.as_completed(list(futures)):
                outcomes.append(_outcome(distributed, future, futures.pop(future)))
                future.release()
                tell(outcomes[-1])
        except (CancelledError, OSError) as error:
            raise EstimatorError(
                f"the scheduler {address} was lost after {len(outcomes)} of {len(jobs)} logs: {error}; "
                "estimates that were written are whole: the same run with existing ones skipped does the rest"
            ) from error
        finally:
            client.cancel(list(futures))
    return outcomes


def _on_worker(pickled: bytes, job: EstimateJob, keep: bool) -> tuple[dict[str, Any], list[LinksideWarning]]:
    """Estimate a log; gives its outcome without the job, which the client has, and its warnings."""
    recipe = _recipe(pickled)
    found, told = _heard(lambda: vars(run(recipe, job, lambda log, rows: None, keep=keep)))
    return {name: value for name, value in found.items() if name != "job"}, told


def _heard(work: Callable[[], Result]) -> tuple[Result, list[LinksideWarning]]:
    """Do some work; gives its result and its warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", LinksideWarning)
        found = work()
    return found, [one.message for one in caught if isinstance(one.message, LinksideWarning)]


@lru_cache(4)
def _recipe(pickled: bytes) -> Recipe:
    """Unpack a recipe once a worker."""
    recipe: Recipe = pickle.loads(pickled)
    _refuse_other(recipe.made_from.version)
    return recipe


def _refuse_other(version: str) -> None:
    if version != installed():
        raise EstimatorError(f"a worker has linkside {installed()}, expected {version}: results would not be the same")


@contextmanager
def map_on_dask(address: str, workers: int, note: Callable[[str], None]) -> Iterator[Map]:
    """Give a `Map` whose tasks run on a cluster, with parameters and errors as of `on_dask`."""
    distributed = _distributed()
    import dask

    large = {"distributed.admin.large-graph-warning-threshold": "1TB"}  # a log in a task is meant
    with dask.config.set(large), _client(distributed, address, workers, note) as client:

        def run(function: Callable[[Task], Result], tasks: Sequence[Task], /) -> Iterator[Result]:
            # In one piece, so that arrays are aligned in memory when they arrive. What all tasks have in common is a
            # result itself, which goes to each worker once and is made again if its worker is lost.
            packed, *sent = (distributed.protocol.pickle.dumps(own) for own in (function, *tasks))
            shared = client.submit(bytes, packed, pure=False)
            futures = [client.submit(_call, installed(), shared, task, pure=False) for task in sent]
            try:
                for future in futures:
                    yield pickle.loads(_result(distributed, future))
            except (CancelledError, OSError) as error:
                raise EstimatorError(f"the scheduler {address} was lost: {error}") from error
            finally:
                client.cancel([*futures, shared])

        yield run


def _call(version: str, function: bytes, task: bytes) -> tuple[bytes, list[LinksideWarning]]:
    _refuse_other(version)
    return _heard(lambda: pickle.dumps(pickle.loads(function)(pickle.loads(task))))


def _result(distributed: Any, future: Any) -> Any:
    """Give a task's result, and its warnings."""
    try:
        found, told = future.result()
    except distributed.scheduler.KilledWorker as error:
        raise _Died(f"{error.allowed_failures + 1} workers died of this log; out of memory?") from error
    for warning in told:
        warnings.warn(warning, stacklevel=2)
    return found


def _outcome(distributed: Any, future: Any, job: EstimateJob) -> Outcome:
    try:
        return Outcome(job, **_result(distributed, future))
    except _Died as error:
        return Outcome(job, error=EstimatorError(f"{job.log}: {error}"))
    except LinksideError as error:
        return Outcome(job, error=error)


@contextmanager
def _client(distributed: Any, address: str, workers: int, note: Callable[[str], None]) -> Iterator[Any]:
    """Connect to a scheduler; that of this machine lives as long as its client."""
    if address != HERE:
        try:
            client = distributed.Client(address, timeout=PATIENCE)
        except (OSError, ValueError) as error:
            raise EstimatorError(f"no scheduler of Dask at {address}: {error}") from error
        with client:
            _tell_dashboard(client, note)
            yield client
        return
    import dask

    settings = {"n_workers": workers, "threads_per_worker": 1, "dashboard_address": "127.0.0.1:0"}
    # A worker's profiler looks at its stack a hundred times a second, which costs a fifth of the time of a small log.
    # Dask's limit on freed memory would return that of every large array to the system, to be faulted in again.
    environment = "distributed.nanny.pre-spawn-environ"
    kept = {name: value for name, value in dask.config.get(environment).items() if "MALLOC" not in name}
    with dask.config.set({"distributed.worker.profile.enabled": False, environment: kept}):
        cluster = distributed.LocalCluster(**settings, silence_logs=logging.CRITICAL)
    with cluster, distributed.Client(cluster) as client:
        _tell_dashboard(client, note)
        yield client


def _tell_dashboard(client: Any, note: Callable[[str], None]) -> None:
    if client.dashboard_link and find_spec("bokeh"):
        note(f"dashboard: {client.dashboard_link}")


def clear_parts(jobs: Sequence[EstimateJob]) -> None:
    """Remove temporary files that killed workers have left beside their outputs."""
    for folder in {Path(job.output).resolve().parent for job in jobs if not is_url(job.output)}:
        clear(folder)


def _distributed() -> Any:
    try:
        import distributed
    except ImportError:
        raise EstimatorError("Dask is needed for this: pip install 'linkside[fleet]'") from None
    return distributed
