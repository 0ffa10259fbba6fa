"""Compiled estimators: what a controller gets from a file are the bits that `step` gives here."""

import platform
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import linkside
from linkside import (
    AccelerationObserver,
    ElasticJointFilter,
    EstimatorError,
    ExtendedKalmanFilter,
    HybridGain,
    OutputError,
    ReducedOrderObserver,
)
from linkside.cli import main

ROOT = Path(__file__).parents[2]
SAMPLES = 300

UNWATCHED = 3
"""What the program ends with where it could not let the kernel watch it."""


@pytest.fixture(scope="module")
def robot():
    return linkside.Robot.load(linkside.demo.ROBOT)


@pytest.fixture(scope="module")
def log(robot):
    return linkside.Log.read(linkside.demo.LOG, robot)[:SAMPLES]


@pytest.fixture(scope="module")
def build(library, tmp_path_factory):
    """Compile a C++ program with the library."""
    compiler = shutil.which("c++") or pytest.skip("no C++ compiler")
    folder = tmp_path_factory.mktemp("cpp")

    def build(source):
        program = folder / source.stem
        flags = ["-std=c++17", "-O1", "-Wall", "-Wextra", "-Werror", f"-I{ROOT / 'rust/capi/include'}"]
        link = [f"-L{library}", "-llinkside", f"-Wl,-rpath,{library}"]
        subprocess.run([compiler, *flags, source, "-o", program, *link], check=True)
        return program

    return build


def given(robot, log):
    """Each method with its settings for a controller, and what its `step` takes of a sample."""
    period, n = log.period, robot.n
    state = np.full(3 * n, 0.01), np.diag(np.full(3 * n, 1e-4))
    filters = ("dt", "theta", "acceleration")
    slow = [sensor.model_copy(update={"delay": 1.2e-3, "corner_frequency": 200.0}) for sensor in robot.accelerometers]
    late = linkside.Robot(robot.config.model_copy(update={"accelerometers": tuple(slow)}), robot.tree)
    return {
        "observer": (AccelerationObserver(robot, bias=True, period=period), ("theta", "tau", "acceleration")),
        "ekf": (ExtendedKalmanFilter(robot, start="rest"), filters),
        "ekf from a state": (ExtendedKalmanFilter(robot, start=state, link_disturbance=True, gate=8.0), filters),
        "ekf with late sensors": (ExtendedKalmanFilter(late, start="rest"), filters),
        "elastic-ekf": (ElasticJointFilter(robot, start="rest"), ("dt", "theta", "acceleration", "tau")),
        "velocity": (ReducedOrderObserver(robot, HybridGain((50.0, 80.0), 2.0, 0.5), period=period), ("q", "tau")),
    }


METHODS = ("observer", "ekf", "ekf from a state", "ekf with late sensors", "elastic-ekf", "velocity")


def stepped(estimator, takes, log):
    """The states that `step` gives."""
    signals = {"dt": np.full(len(log), log.period), "q": log.theta, "theta": log.theta}
    signals |= {"tau": log.tau, "acceleration": log.acceleration}
    return [estimator.step(**{name: signals[name][i] for name in takes}) for i in range(len(log))]


def in_loop(program, path, signals, log, folder):
    """Run the program that counts; give positions and status, the last covariance, and whether it was watched."""
    n = log.theta.shape[1]
    parts = {"theta": log.theta, "tau": log.tau, "acceleration": log.acceleration}
    order = [name for name in ("theta", "dtheta", "tau", "acceleration", "ddqref") if name in signals]
    missing = np.full((len(log), n), np.nan)
    samples = np.hstack([np.full((len(log), 1), log.period), *(parts.get(name, missing) for name in order)])
    (folder / "samples").write_bytes(np.ascontiguousarray(samples).tobytes())
    done = subprocess.run([program, path, folder / "samples", folder / "out"], capture_output=True, text=True)
    assert done.returncode in (0, UNWATCHED), f"{done.returncode}: {done.stderr}"
    out = np.frombuffer((folder / "out").read_bytes())
    rows = len(log) * (n + 1)
    return out[:rows].reshape(len(log), n + 1), out[rows:], done.returncode != UNWATCHED


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="counts allocations by what glibc calls them")
@pytest.mark.parametrize("method", METHODS)
def test_a_loop_in_c_gives_the_same_bits_and_neither_allocates_nor_asks_the_system(build, robot, log, method, tmp_path):
    estimator, takes = given(robot, log)[method]
    signals = estimator.compile(tmp_path / "robot.lsr")
    # Commanded accelerations and motor velocities are missing, as in `step` without them.
    program = build(ROOT / "tests/cpp/loop.cpp")
    rows, covariance, watched = in_loop(program, tmp_path / "robot.lsr", signals, log, tmp_path)
    states = stepped(estimator, takes, log)
    assert (rows[:, :-1] == np.array([state.q for state in states])).all()
    assert (rows[:, -1] == [state.status for state in states]).all()
    if covariance.size:
        assert (covariance == states[-1].covariance.ravel()).all()
    if not watched:
        pytest.skip("system calls were not watched: this kernel has no strict seccomp mode")


def test_the_example_in_cpp_writes_what_step_gives(build, robot, log, tmp_path):
    program = build(ROOT / "examples/controller.cpp")
    observer, takes = given(robot, log)["observer"]
    observer.compile(tmp_path / "robot.lsr")
    log.write(tmp_path / "log.csv")
    subprocess.run([program, tmp_path / "robot.lsr", tmp_path / "log.csv", tmp_path / "out.csv"], check=True)
    found = np.loadtxt(tmp_path / "out.csv", delimiter=",")
    states = stepped(observer, takes, log)
    assert (found == [[*state.q, *state.dq, state.status] for state in states]).all()
    (tmp_path / "robot.lsr").write_bytes((tmp_path / "robot.lsr").read_bytes()[:-1])
    done = subprocess.run([program, tmp_path / "robot.lsr", "log", "out"], capture_output=True, text=True)
    assert done.returncode == 1
    assert "the file is not whole" in done.stderr


@pytest.mark.parametrize("method", METHODS)
def test_a_file_says_what_a_sample_has(robot, log, method, tmp_path):
    estimator, takes = given(robot, log)[method]
    signals = estimator.compile(tmp_path / "robot.lsr")
    names = {"q": "theta"} if "q" in takes else {}
    assert {names.get(name, name) for name in takes} - {"dt"} <= signals.keys()
    assert signals["theta"] == robot.n
    assert (tmp_path / "robot.lsr").read_bytes().startswith(b"linkside\1\0\0\0")


def test_what_a_controller_cannot_know_is_refused(robot, tmp_path):
    with pytest.raises(EstimatorError, match="start='rest', or a state"):
        ExtendedKalmanFilter(robot).compile(tmp_path / "robot.lsr")
    with pytest.raises(OutputError, match=r"ends in \.lsr"):
        ExtendedKalmanFilter(robot, start="rest").compile(tmp_path / "robot.bin")
    nameless = linkside.Robot(robot.config.model_copy(update={"rate_hz": None}), robot.tree)
    with pytest.raises(EstimatorError, match="compile needs the sampling period"):
        AccelerationObserver(nameless).compile(tmp_path / "robot.lsr")
    with pytest.raises(EstimatorError, match="expected a positive, finite time"):
        AccelerationObserver(nameless).compile(tmp_path / "robot.lsr", period=-1.0)
    assert not list(tmp_path.iterdir())
    AccelerationObserver(nameless).compile(tmp_path / "robot.lsr", period=1e-3)
    assert list(tmp_path.iterdir())


@pytest.mark.parametrize("method", ["observer", "ekf", "elastic-ekf", "reduced-order", "nicosia-tomei"])
def test_the_command_compiles_each_method(method, tmp_path):
    out = tmp_path / "robot.lsr"
    arguments = ["compile", linkside.demo.ROBOT, "--with", method, "--out", out]
    result = CliRunner().invoke(main, [*map(str, arguments)])
    assert result.exit_code == 0, result.output
    assert f"robot.lsr: {method}; a sample has " in result.output
    assert "theta (6)" in result.output
    assert out.read_bytes().startswith(b"linkside")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--out", "robot.bin"], "ends in .lsr"),
        (["--out", "robot.lsr", "--rate", "0"], "--rate is 0.0"),
        (["--out", "robot.lsr", "--with", "reduced-order", "--tuning", "t.yaml"], "--tuning is not for"),
        (["--out", "robot.lsr", "--with", "observer", "--rate", "100"], "joint 'a1' has a pole of 250 rad/s, too fast"),
    ],
)
def test_the_command_says_what_is_wrong_and_writes_nothing(arguments, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(main, ["compile", str(linkside.demo.ROBOT), *arguments])
    assert result.exit_code == 2
    assert message in result.output
    assert not list(tmp_path.iterdir())
