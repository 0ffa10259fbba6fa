"""Everything that writes: commands and programs, what they read, and what of their outputs is the same in every run."""

import hashlib
import io
import pkgutil
import re
import shutil
import tempfile
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from rerun.chunk import RrdReader

import linkside
from linkside import Estimate, ExtendedKalmanFilter, Log, Noise, Robot
from linkside.control.trajectories import rest_to_rest
from linkside.learning import Motion, PathLearning
from linkside.learning import write as write_learning

from . import bags
from .robots import DATA

ROWS = 400

COMMANDS = {
    "init": "init {in}/robot.urdf --out out.yaml",
    "compile": "compile {arm} --with ekf --out out.lsr",
    "estimate": "estimate {arm} {in}/log.csv --out out.csv",
    "convert": "convert {in}/bag --joints /joints --out out.parquet",
    "report": "estimate {arm} {in}/log.parquet --with ekf --out out.parquet --report out.html",
    "batch": "estimate {arm} {in}/log.parquet {in}/other.csv --out outs -j 1 --manifest manifest.parquet",
    "merge": "merge {arm} {in}/log.parquet --rate 1000 --out out.parquet",
    "calibrate": "calibrate {arm} {in}/log.parquet --free stiffness --out out.yaml --report out.html --force",
    "tune": "tune {arm} {in}/log.parquet --out out.yaml --report out.html",
    "tune observer": "tune {arm} {in}/log.parquet --with observer --out out.yaml --figure out.png --evaluations 4",
    "excite": "excite {arm} --acceleration 9 --evaluations 2 --out out.csv --figure out.png --report out.html",
    "check": "check {arm} {in}/log.parquet --figure out.png --report out.html",
    "place": "place {arm} --link upper --link fore --steps 1 --out out.yaml --figure out.png --report out.html",
    "compare": "compare {in}/truth.parquet {in}/estimate.parquet --out out.json --figure out.png --report out.html",
    "learn": "learn next {arm} {in}/learning.parquet {in}/repeated.parquet --out out.parquet",
    "view mcap": "view {arm} {in}/log.parquet {in}/estimate.parquet --out out.mcap",
    "view rerun": "view {arm} {in}/log.parquet {in}/estimate.parquet --out out.rrd",
    "demo": "demo --figure out.png",
}
"""Every command that writes."""

PROGRAMS = {
    "simulate": """
from linkside import Robot, simulate
from linkside.control.controllers import JointPD
robot = Robot.load("{arm}")
control = JointPD(kp=[1e5, 1e5], kd=[1e3, 1e3], times=[0.0, 1.0], theta=[[0.0, 0.5], [0.1, 0.6]], tau=[0.0, 0.0])
simulate(robot, control, 0.3, 1000.0, q=[0.0, 0.5]).write("outs")
""",
    "smooth": """
from linkside import Noise, RauchTungStriebelSmoother, Robot
from linkside.kalman.stretches import smooth_file
robot = Robot.load("{arm}")
smooth_file(RauchTungStriebelSmoother(robot, Noise(jerk=15.0)), "{in}/log.parquet", robot, "out.parquet", rows=150)
""",
}
"""What Python writes and no command does."""

MODULES = tuple(
    module.name
    for module in pkgutil.walk_packages(linkside.__path__, "linkside.")
    if not module.name.endswith(("__main__", ".cluster"))
)
"""What all of these import."""

MANIFEST = "manifest.parquet"
TIMELESS = ["log", "output", "verdict", "error", "rows", "log_digest", "made_from", "digest"]
"""Columns of a manifest that are the same in every run."""


def make_inputs(folder):
    """Put there what the commands read."""
    for name in ("robot.yaml", "robot.urdf"):
        shutil.copy(DATA / "arm2_square" / name, folder)
    robot = Robot.load(folder / "robot.yaml")
    for name in ("log", "truth"):
        pq.write_table(pq.read_table(DATA / f"arm2_square/{name}.parquet").slice(0, ROWS), folder / f"{name}.parquet")
    log = Log.read(folder / "log.parquet", robot)
    for name in ("log", "other"):
        log.write(folder / f"{name}.csv")
    ExtendedKalmanFilter(robot, Noise(jerk=15.0)).run(log).write(folder / "estimate.parquet")
    states = zip((1e9 * log.t).round().astype(int).tolist(), log.theta, strict=True)
    bags.write(folder / "bag", [(t, "/joints", bags.joint_state(t, robot.names, theta)) for t, theta in states])
    path = rest_to_rest([[0.3, 0.3], [0.5, 0.4]], 0.2, 1e-3, degree=7).held(0.05, 0.05)
    inertia = np.diag(robot.mass_matrix(path.q[0])) + [drive.motor_inertia for drive in robot.drives]
    learning = PathLearning(robot, Motion(path.t, path.q, path.dq, path.ddq), 900 * inertia, 42 * inertia)
    write_learning(learning, folder / "learning.parquet")
    rest, good = np.zeros_like(path.q), np.zeros(len(path.t), np.uint8)
    repeated = Estimate(path.t, path.q + 1e-3, rest, path.q, rest, good, robot.names)
    repeated.write(folder / "repeated.parquet")
    return folder


def words(name, inputs):
    """The command's words, or the program."""
    named = {"in": str(inputs), "arm": str(inputs / "robot.yaml")}
    if name in PROGRAMS:
        return PROGRAMS[name].format(**named)
    return [word.format(**named) for word in COMMANDS[name].split()]


def lasting(name, content):
    """What of a file is the same in every run: a digest; as a word, so that a failure is short."""
    if name == MANIFEST:
        content = str(pq.read_table(io.BytesIO(content), columns=TIMELESS).to_pylist()).encode()
    if name.endswith(".html"):
        content = re.sub(r"\d{4}-\d\d-\d\d \d\d:\d\d UTC|[\d.]+ µs", "", content.decode()).encode()
    if name.endswith(".rrd") and content.startswith(b"RRF"):
        content = str(chunks(content)).encode()
    return f"{len(content)} bytes {hashlib.sha256(content).hexdigest()[:16]}"


def chunks(content):
    """What is in a recording of Rerun, which has the time of day in it."""
    with tempfile.NamedTemporaryFile(suffix=".rrd") as file:
        Path(file.name).write_bytes(content)
        found = [(chunk.entity_path, chunk.to_record_batch().num_rows) for chunk in RrdReader(file.name).stream()]
    return sorted(found)
