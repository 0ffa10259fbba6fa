"""Habits: everything says what it is, help has examples, shells complete, files are whole or not there."""

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import linkside
from linkside import (
    AccelerationObserver,
    ElasticJointFilter,
    ElasticJointSmoother,
    Estimate,
    EstimatorError,
    ExtendedKalmanFilter,
    FixedLagSmoother,
    Log,
    LogError,
    MarginalizedParticleFilter,
    NicosiaTomeiObserver,
    OutputError,
    ParticleFilter,
    RauchTungStriebelSmoother,
    ReducedOrderObserver,
    cli,
    simulate,
)
from linkside.recording import writer

from .gallery import robot

ROOT = Path(__file__).parents[2]
ESTIMATORS = {
    AccelerationObserver: "poles='250 rad/s'",
    ExtendedKalmanFilter: "gate=None",
    RauchTungStriebelSmoother: "start='auto'",
    ElasticJointFilter: "biases=",
    ElasticJointSmoother: "biases=",
    ParticleFilter: "particles=1000",
    MarginalizedParticleFilter: "seed=0",
    ReducedOrderObserver: "gain=100",
    NicosiaTomeiObserver: "gain=100",
}


@pytest.mark.parametrize("kind", ESTIMATORS, ids=lambda kind: kind.__name__)
def test_estimators_say_what_they_are(kind):
    text = repr(kind(robot("two joints")))
    assert text.startswith(f"{kind.__name__}(<Robot arm2: axis2 axis3; sensors: tool_acc>")
    assert ESTIMATORS[kind] in text
    assert "\n" not in text
    assert len(text) < 300


def test_a_fixed_lag_and_its_states_say_what_they_are():
    smoother = FixedLagSmoother(robot("two joints"), lag=1)
    assert "lag=1" in repr(smoother)
    for _ in range(2):
        state = smoother.step(dt=1e-3, theta=[0.0, 0.0], acceleration=[0.0, 0.0, 9.81])
    assert repr(state).startswith("State(t=0.0")


def test_errors_are_short_and_name_their_unit():
    truth = Estimate.read(linkside.demo.TRUTH)
    error = truth.error_against(truth)
    assert error.tool_rms_mm == error.tool_rms == 0.0
    assert repr(error).startswith("EstimateError(tool_rms_mm=0, ")
    assert not re.search(r"\d{6}", repr(error))


@pytest.mark.parametrize("command", cli.main.commands)
def test_help_has_an_example_that_the_command_takes(command):
    text = CliRunner().invoke(cli.main, [command, "--help"]).stdout
    example = text.partition("Example:")[2].split()
    assert example[:2] == ["linkside", command]
    subcommand = cli.main.commands[command]
    with subcommand.make_context(command, example[2:]) as context:
        assert all(value is not None for name, value in context.params.items() if f"--{name}" in example)


def test_shells_complete():
    environment = {
        **os.environ,
        "_LINKSIDE_COMPLETE": "bash_complete",
        "COMP_WORDS": "linkside compa",
        "COMP_CWORD": "1",
    }
    program = "from linkside import cli; cli.main()"
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["plain,compare"]


def test_the_first_session_is_that_of_the_documents():
    """What type checkers see is what users read: all of README.md, and the beginning of docs/kalman.md."""
    readme, kalman = (
        re.findall(r"^```python\n(.*?)^```", (ROOT / name).read_text(), re.MULTILINE | re.DOTALL)
        for name in ("README.md", "docs/kalman.md")
    )
    blocks = [*readme, kalman[0]]
    session = ast.parse((ROOT / "examples/first_session.py").read_text())
    assert ast.dump(ast.Module(session.body[1:], [])) == ast.dump(ast.parse("\n".join(blocks)))


def test_what_is_required_is_given():
    machine = robot("six joints, three of them elastic")
    log = Log.read(linkside.demo.LOG, machine)
    theta, tau = log.require("theta", "tau")
    assert theta is log.theta
    assert tau is log.tau
    with pytest.raises(LogError, match="'q_a1' is missing"):
        log.require("q")
    truth = Estimate.read(linkside.demo.TRUTH)
    (tool,) = truth.require("tool_position")
    assert tool is truth.tool_position
    for name in ("tool_std", "names", "colour"):
        with pytest.raises(EstimatorError, match=f"the estimate has no {name}, only t, q"):
            truth.require(name)


def simulation():
    return simulate(robot("two joints"), lambda t, state: np.array([0.0, 0.0]), 0.01, 1000.0, substeps=4)


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_simulations_are_written_whole(tmp_path, suffix):
    run = simulation()
    run.write(tmp_path / "run", suffix=suffix)
    log = Log.read(tmp_path / f"run/log{suffix}", run.robot, check=False)
    np.testing.assert_array_equal(log.theta, run.log.theta)
    np.testing.assert_array_equal(Estimate.read(tmp_path / f"run/truth{suffix}").q, run.truth["q"])
    assert repr(run).startswith("Simulation(<Robot arm2")


def test_or_not_at_all(tmp_path, monkeypatch):
    run = simulation()
    run.write(tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    calls = []

    def full(*arguments):
        calls.append(arguments)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(writer, "_sink", full)
    with pytest.raises(OutputError, match="No space left on device"):
        run.write(tmp_path)
    assert calls
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="file"):
        run.write(tmp_path / "file")
