"""Reports as one HTML page: what came out first, then tables and figures, then what it was made from."""

from .inputs import Input, inputs
from .page import Page, Verdict, write_page

__all__ = ["Input", "Page", "Verdict", "inputs", "write_page"]
