"""A robot and a recording to try things on: a six-axis arm, simulated, whose first joint moves five degrees."""

from pathlib import Path

FOLDER = Path(__file__).parent
"""Where the files are."""

ROBOT = FOLDER / "robot.yaml"
LOG = FOLDER / "log.parquet"
TRUTH = FOLDER / "truth.parquet"
