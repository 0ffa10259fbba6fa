"""Figures: their colours, their axes, and files of them."""

from .style import COLOURS, check_writable, finish, legend_below, legend_beside, line_style, plain_log, save

__all__ = [
    "COLOURS",
    "check_writable",
    "finish",
    "legend_below",
    "legend_beside",
    "line_style",
    "plain_log",
    "save",
]
