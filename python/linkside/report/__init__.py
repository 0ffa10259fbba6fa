"""Reports as one HTML page: the verdict, tables and figures, and the inputs."""

from .inputs import Input, inputs
from .page import Page, Verdict, write_page

__all__ = ["Input", "Page", "Verdict", "inputs", "write_page"]
