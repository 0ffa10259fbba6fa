"""Pinocchio is for models that are built with it, and for tests: all else works where it cannot be imported."""

import subprocess
import sys

from .robots import DATA

FOLDER = DATA / "arm2_square"

BLOCKED = """
import sys

class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "pinocchio":
            raise ImportError("Pinocchio is not there")

sys.meta_path.insert(0, Blocked())
"""

ROBOT, LOG = str(FOLDER / "robot.yaml"), str(FOLDER / "log.parquet")

COMMANDS = [
    ["demo"],
    ["check", ROBOT],
    ["estimate", ROBOT, LOG, "--out", "estimate.parquet"],
    ["compile", ROBOT, "--rate", "2000", "--out", "robot.lsr"],
]

EACH = f"""
from linkside.cli import main

for command in {COMMANDS}:
    try:
        main(command)
    except SystemExit as end:
        assert not end.code, command
"""

LIBRARY = f"""
import numpy as np
import linkside
from linkside.calibration import calibrate

folder = {str(FOLDER)!r}
robot = linkside.Robot.load(folder + "/robot.yaml")
log = linkside.Log.read(folder + "/log.parquet", robot)[:2000]
[found] = calibrate(robot, log, free=["stiffness_axis2"]).estimates
assert abs(found.value / 4.5e5 - 1) < 0.1
moved = linkside.simulate(robot, lambda t, s: np.zeros(robot.n), 0.01, 1000.0)
assert np.isfinite(moved.log.theta).all()
path = linkside.trajectories.polyline(robot, [[1.2, 0.3]], 0.1, 0.01, start=[0.3, 0.4], axes="xz")
try:
    robot.model
except linkside.ConfigError as error:
    print(error)
"""


def run(code, folder):
    done = subprocess.run(
        [sys.executable, "-c", BLOCKED + code], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_commands_need_no_pinocchio(tmp_path):
    run(EACH, tmp_path)
    assert {file.name for file in tmp_path.iterdir()} == {"estimate.parquet", "linkside-demo.png", "robot.lsr"}


def test_calibration_simulation_and_paths_need_no_pinocchio(tmp_path):
    assert run(LIBRARY, tmp_path) == "the robot's Pinocchio model needs Pinocchio: pip install pin\n"


def test_importing_the_package_imports_no_pinocchio():
    done = subprocess.run(
        [sys.executable, "-c", "import linkside, sys; sys.exit('pinocchio' in sys.modules)"], check=False
    )
    assert done.returncode == 0
