"""The command line.

Whatever a user can get wrong is one line on standard error and exit status 2, and leaves no file behind.
"""

from . import compiling, estimating, exciting, fitting, learn, looking, paper, recordings, viewing
from .group import main

__all__ = [
    "compiling",
    "estimating",
    "exciting",
    "fitting",
    "learn",
    "looking",
    "main",
    "paper",
    "recordings",
    "viewing",
]
