"""Many logs, estimated on threads, on processes of this machine, or on the workers of a Dask cluster.

Logs are named by paths, globs and URLs of object stores; results are written whole or not at all to the same kind of
place, with a manifest. Results are bit-identical in all of these, and a second run does only what is missing or
changed.
"""

from .estimating import estimate
from .manifest import Manifest
from .mapped import mapped
from .methods import METHODS, Options
from .task import EstimateJob, Outcome

__all__ = ["METHODS", "EstimateJob", "Manifest", "Options", "Outcome", "estimate", "mapped"]
