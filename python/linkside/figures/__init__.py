"""Figures: their colours, their axes, and files of them."""

from .style import COLOURS, check_writable, finish, save

__all__ = ["COLOURS", "check_writable", "finish", "save"]
