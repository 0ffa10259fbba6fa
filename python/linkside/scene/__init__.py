"""A robot in motion, for other programs to show: Rerun's .rrd, and MCAP for PlotJuggler and Foxglove."""

from .files import SUFFIXES, write_scene

__all__ = ["SUFFIXES", "write_scene"]
