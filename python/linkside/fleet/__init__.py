"""Many logs: estimated side by side, on the threads of a process, its processes, or a cluster of Dask.

Logs are named by paths, globs and URLs of object stores; results are written whole or not at all to the same kind of
place, with a manifest of them. Results are the same bits however they were worked out, and a second run does what is
missing or changed.
"""

from .estimating import estimate
from .manifest import Manifest
from .methods import METHODS, Options
from .task import EstimateJob, Outcome

__all__ = ["METHODS", "EstimateJob", "Manifest", "Options", "Outcome", "estimate"]
