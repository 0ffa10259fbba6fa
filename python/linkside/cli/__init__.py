"""The command line."""

from . import learn as _learn  # noqa: F401 — registers its commands
from .commands import main

__all__ = ["main"]
