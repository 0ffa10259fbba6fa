"""The papers' experiments give what the pages say, and conclude what they say."""

import re
import sys
from importlib import import_module
from pathlib import Path

import pytest
from click.testing import CliRunner

from linkside.cli import main
from linkside.papers import axelsson2012, cristofaro2023, ulrich2011
from linkside.papers.names import PAPERS

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def found():
    """Each experiment once."""
    return {name: import_module(f"linkside.papers.{name}").reproduce() for name in PAPERS}


def cells(document, first):
    """Numbers of the rows of tables whose first cell begins so."""
    lines = re.findall(rf"^\| {re.escape(first)}.*\|$", (ROOT / "docs" / document).read_text(), re.MULTILINE)
    assert lines, first
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def close(stated, value):
    """Whether a number is the stated one, to the digits stated."""
    mantissa, _, power = stated.partition("e")
    unit = 10.0 ** (int(power or 0) - len(mantissa.partition(".")[2]))
    return abs(float(stated) - value) <= 1.5 * unit


@pytest.mark.parametrize("paper", ["ulrich2011", "cristofaro2023"])
def test_pages_say_what_was_found(found, paper):
    for comparison in found[paper].comparisons:
        quantity = comparison.quantity.replace(" diverges [", " diverges on the nonlinear robot [")
        [[_, _, here, conclusion]] = cells(f"papers/{paper}.md", quantity)
        assert close(here, comparison.here), comparison
        assert conclusion.partition(":")[0] == comparison.conclusion


def test_deluca(found):
    for what in ("overshoot, full state over motors only", "vibration, full state over motors only"):
        [[_, _, *stated]] = cells("papers/deluca2007.md", what)
        for angle, number in zip((5, 30), stated, strict=True):
            value = found["deluca2007"].here(f"{what}, {angle}°")
            assert close(number, value)
            assert value < 0.5
    [table] = found["deluca2007"].details
    for motion, *values in table.rows:
        [[_, *stated]] = cells("control.md", motion)
        assert all(map(close, stated, map(float, values[:2]))), motion
    assert {comparison.conclusion for comparison in found["deluca2007"].comparisons} == {"same"}


def test_axelsson(found):
    comparisons = found["axelsson2012"].comparisons
    stated = {"EKF over motors alone": 0.744, "particles over EKF": 0.667, "particles over motors alone": 0.496}
    for comparison in comparisons:
        what = comparison.quantity.removeprefix("tool error, ")
        row = what.replace("particles", "particle filter")
        [[_, paper, here, conclusion]] = cells("papers/axelsson2012.md", row)
        assert close(here, comparison.here), comparison
        assert conclusion.partition(":")[0] == comparison.conclusion
        if what in stated:
            assert comparison.paper == pytest.approx(stated[what], abs=5e-4)
            assert close(paper, comparison.paper)


def test_axelsson_on_a_recording_of_another_simulator():
    robot, log, truth = axelsson2012.read(ROOT / "tests/data/arm2_square_mismatch")
    errors = axelsson2012.compare(robot, log, axelsson2012.centres(truth), axelsson2012.Noise())
    motors = errors["motors alone"].norm
    ratio = {name: error.norm / motors for name, error in errors.items()}
    assert ratio["smoother"] < ratio["EKF, 2 kHz"] < 0.12
    assert ratio["EKF, 200 Hz"] < 1.1 * ratio["EKF, 2 kHz"]
    found = re.search(r"ratio of EKF to motors alone is ([\d.]+) with defaults", (ROOT / "docs/kalman.md").read_text())
    assert ratio["EKF, 2 kHz"] == pytest.approx(float(found.group(1)), abs=0.002)


@pytest.mark.slow
def test_axelsson_tuned():
    folder = ROOT / "tests/data/arm2_square_mismatch"
    tuned = axelsson2012.reproduce(folder, tuned=True).details[1]
    [ratio] = [float(row[3]) for row in tuned.rows if row[0] == "EKF, 2 kHz"]
    found = re.search(r"with defaults and ([\d.]+) tuned", (ROOT / "docs/kalman.md").read_text())
    assert ratio == pytest.approx(float(found.group(1)), abs=0.002)


def test_axelsson_moves_along_the_square():
    square = axelsson2012.rest_to_rest(axelsson2012.CORNERS, 0.4, 1e-3)
    q, dq, ddq = axelsson2012.joint_path(square.q, square.dq, square.ddq)
    robot = axelsson2012.arm()
    tool = robot.tool_position(q)[:, [0, 2]]
    assert abs(tool - square.q).max() < 1e-12
    for rising, rate in ((q, dq), (dq, ddq)):
        slope = (rising[2:] - rising[:-2]) / 2e-3
        assert abs(slope - rate[1:-1]).max() < 1e-4 * abs(rate).max()


def test_ulrich(found):
    """Tracking within 5 % of an independent implementation at 100 kHz, and its verdicts on the wrong model."""
    tracked, _, wrong = found["ulrich2011"].details
    expected = {"linear": (0.0898, 0.467), "nonlinear": (0.0893, 0.444)}
    for joints, _, *values in tracked.rows:
        assert [float(value) for value in values] == pytest.approx(expected[joints], rel=0.05)
    assert [row[1].split()[0] for row in wrong.rows] == ["diverges"] * 3 + ["stable"] * 2


def test_ulrich_states_of_other_rates_are_kept():
    run = ulrich2011.run(ulrich2011.space_robot("linear"), "truth", 4000.0, 1.0)
    assert len(run.truth["t"]) == 1001


def test_cristofaro(found):
    """Times of an independent implementation, in continuous time."""
    settling, jumps = found["cristofaro2023"].details
    assert [float(cell) for cell in settling.rows[0][1:]] == pytest.approx([0.209, 0.322, 0.491], abs=2e-3)
    assert jumps.rows[1][1] == "0.024 s to 2, 3.872 s to 1"
    document = (ROOT / "docs/velocity.md").read_text()
    for row in settling.rows[:5]:
        assert re.search(rf"\b{float(row[2]):.3g}0? s", document)


def test_cristofaro_arm_is_the_robot():
    """The closed form of the arm's motion is that of its URDF."""
    x, torque = (-2.0, 0.7, 0.4, -1.1), (3.0, -2.0)
    robot = cristofaro2023.arm()
    links, _ = robot.forward_dynamics(*([pair] for pair in (x[:2], x[2:], x[:2], x[2:], torque)))
    assert cristofaro2023.slope(x, torque)[2:] == pytest.approx(links[0].tolist(), rel=1e-6)


def test_command(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(main, ["paper", "deluca2007"], catch_exceptions=False)
    assert done.exit_code == 0
    assert "0.3168" in done.output
    for name in ("observed_short", "observed_long", "control_short", "control_long"):
        assert (tmp_path / f"deluca2007/{name}.svg").read_text().startswith("<?xml")


@pytest.mark.parametrize(
    "arguments",
    [["deluca2007", "--rate", "1000"], ["ulrich2011", "--tuned"], ["nobody2000"], ["ulrich2011", "--out", "x"]],
)
def test_command_refuses(tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    Path("x").touch()
    monkeypatch.setitem(sys.modules, "linkside.papers.ulrich2011", None)
    assert CliRunner().invoke(main, ["paper", *arguments]).exit_code == 2
