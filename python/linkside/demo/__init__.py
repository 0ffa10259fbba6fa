"""An example robot and recording: a simulated six-axis arm whose first joint moves by five degrees."""

from pathlib import Path

FOLDER = Path(__file__).parent
"""Where the files are."""

ROBOT = FOLDER / "robot.yaml"
LOG = FOLDER / "log.parquet"
TRUTH = FOLDER / "truth.parquet"
