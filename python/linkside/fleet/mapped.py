"""Work for each of several logs, wherever it runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from linkside.arguments import whole
from linkside.mapping import Map, here

from .cluster import map_on_dask
from .threads import cores, map_on_threads


@contextmanager
def mapped(
    on: str | None = None,
    workers: int | None = None,
    count: int | None = None,
    note: Callable[[str], None] = lambda text: None,
) -> Iterator[Map]:
    """Give what `calibrate`, `calibrate_together` and `compare_files` take as ``run``: logs are worked on at a time.

    Results are bit-identical in all cases.

    Parameters
    ----------
    on
        None for threads of this process, ``"dask"`` for processes of this machine, or the address of a scheduler of
        Dask.
    workers
        Logs at a time, on this machine; one a core by default.
    count
        Of logs, if it is known: there are no more workers than these.
    note
        Called with the address of the cluster's dashboard.

    Raises
    ------
    EstimatorError
        Dask is not installed, there is no scheduler at the address, or it was lost.
    """
    workers = cores() if workers is None else whole("workers", workers, 1)
    workers = workers if count is None else max(1, min(workers, count))
    if on is not None:
        with map_on_dask(on, workers, note) as run:
            yield run
    elif workers == 1:
        yield here
    else:
        with map_on_threads(workers) as run:
            yield run
