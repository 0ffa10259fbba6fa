"""Tuning: finds the noise that a recording was drawn with, helps where the model is wrong, refuses the rest."""

import re
from functools import cache

import numpy as np
import pytest

import linkside
from linkside import (
    Estimate,
    EstimatorError,
    ExtendedKalmanFilter,
    Log,
    LogError,
    Noise,
    RauchTungStriebelSmoother,
    Robot,
)
from linkside.tuning import tune

from .drawn import arm, draw
from .robots import DATA

EXACT = {"damping": False, "biases": ("acceleration",)}
TRUE = Noise(jerk=20.0, torsion=0.0, transmission=3e-5, motor_bias=0.0, motor_bias_walk=0.0, velocity=0.02)


def recording(name):
    folder = linkside.demo.FOLDER if name == "kr15_short" else DATA / name
    robot = Robot.load(folder / "robot.yaml")
    return robot, Log.read(folder / "log.parquet", robot), Estimate.read(folder / "truth.parquet")


@cache
def tuned(name):
    """Found by expectation and maximisation, which finds what the search does in a tenth of the time."""
    robot, log, _ = recording(name)
    return tune(robot, log, method="em")


def tool_errors(robot, log, truth, noise):
    """Of filter and smoother [mm]."""
    methods = ExtendedKalmanFilter, RauchTungStriebelSmoother
    return [method(robot, noise).run(log).error_against(truth).tool_rms_centred for method in methods]


@pytest.mark.parametrize("factor", [0.2, 3.0])
def test_finds_the_noise_that_logs_were_drawn_with(factor):
    robot = arm()
    logs = [draw(robot, TRUE, 1500, seed)[0] for seed in (1, 2)]
    start = TRUE.updated(transmission=factor * TRUE.transmission)
    tuning = tune(robot, logs, start, span=(0.1, 100), **EXACT)
    assert tuning.names == ("transmission_shoulder", "transmission_elbow")
    assert tuning.most_likely.transmission == pytest.approx((3e-5, 3e-5), rel=0.1)
    assert tuning.log_likelihood_most > tuning.log_likelihood_before
    assert tuning.nis_most == pytest.approx(1, abs=0.06)
    assert max(tuning.widening) < 1.3  # innovations are white: nothing to widen for
    assert tuning.at_bound == ()


def test_finds_several_kinds_of_noise_at_once():
    robot = arm()
    logs = [draw(robot, TRUE, 1500, seed)[0] for seed in (3, 4)]
    start = TRUE.updated(transmission=1e-4, acceleration=3.0, jerk=60.0)
    free = "transmission", "acceleration", "jerk"
    tuning = tune(robot, logs, start, free, span=(0.05, 20), widen=False, method="em", **EXACT)
    assert tuning.after == tuning.most_likely
    assert tuning.after.acceleration == pytest.approx(1, rel=0.05)
    assert tuning.after.transmission == pytest.approx((3e-5, 3e-5), rel=0.1)
    assert tuning.after.jerk == pytest.approx((20, 20), rel=0.15)


def test_likelihood_of_several_logs_is_their_sum():
    robot = arm()
    logs = [draw(robot, TRUE, 200, seed)[0] for seed in (5, 6)]
    tuning = tune(robot, logs, TRUE, ("acceleration",), **EXACT)
    for noise, total in (
        (tuning.before, tuning.log_likelihood_before),
        (tuning.most_likely, tuning.log_likelihood_most),
        (tuning.after, tuning.log_likelihood_after),
    ):
        estimates = ExtendedKalmanFilter(robot, noise, **EXACT).run(logs)
        assert sum(e.log_likelihood.sum() for e in estimates) == pytest.approx(total, rel=1e-12)


def test_a_model_that_is_wrong():
    """White jerk, exactly integrated, leaves the filter nothing to gain by tuning; the smoother gains a sixth."""
    robot, log, truth = recording("arm2_square_mismatch")
    tuning = tuned("arm2_square_mismatch")
    before = tool_errors(robot, log, truth, Noise())
    kalman, smoother = tool_errors(robot, log, truth, tuning.after)
    assert kalman < 1.01 * before[0]
    assert smoother < 0.85 * before[1]
    most_likely = tool_errors(robot, log, truth, tuning.most_likely)
    assert kalman < most_likely[0] < 0.265
    assert smoother < most_likely[1]
    assert max(tuning.log_likelihood_before, tuning.log_likelihood_after) < tuning.log_likelihood_most
    assert tuning.nis_before > 1.2
    assert tuning.nis_most == pytest.approx(1, abs=0.1)
    assert max(tuning.widening) > 4
    assert "correlated in time" in tuning.to_text()


NEARLY_RIGHT = ("arm2_square", "kr15_long", "kr15_short", "kr15_six_axes")


@pytest.mark.parametrize("name", NEARLY_RIGHT)
def test_a_model_that_is_nearly_right_is_not_made_worse(name):
    robot, log, truth = recording(name)
    before = tool_errors(robot, log, truth, Noise())
    after = tool_errors(robot, log, truth, tuned(name).after)
    assert all(b < 1.15 * a for a, b in zip(before, after, strict=True))


def stated():
    """The table of docs/kalman.md: recording, then errors with defaults, most likely, and widened."""
    text = (DATA.parents[1] / "docs/kalman.md").read_text()
    cell = r" ([\d.]+) / ([\d.]+) \|"
    return re.findall(rf"^\| (\w+)[^|]*\|{cell}{cell}{cell}$", text, re.MULTILINE)


def test_the_table_has_every_recording():
    assert sorted(name for name, *_ in stated()) == sorted(["arm2_square_mismatch", *NEARLY_RIGHT])


@pytest.mark.parametrize("name", ["arm2_square_mismatch", *NEARLY_RIGHT])
def test_table_of_tool_errors_is_true(name):
    [cells] = [cells for row, *cells in stated() if row == name]
    robot, log, truth = recording(name)
    tuning = tuned(name)
    noises = Noise(), tuning.most_likely, tuning.after
    found = [error for noise in noises for error in tool_errors(robot, log, truth, noise)]
    for text, error in zip(cells, found, strict=True):
        last_digit = 10.0 ** -len(text.partition(".")[2])
        assert error == pytest.approx(float(text), abs=1.01 * last_digit)


def test_joints_that_rest_stay_as_declared():
    robot, log, _ = recording("kr15_short")
    tuning = tune(robot, log, Noise(transmission=2e-5), method="em")
    assert tuning.names == ("transmission_a1",)
    assert tuning.after.transmission[1:] == (2e-5,) * 5
    assert tuning.after.jerk is None  # still read off each log


def test_a_tuning_file_holds_what_was_found(tmp_path):
    robot, log, _ = recording("arm2_square")
    tuning = tune(robot, log, free=("acceleration",))
    tuning.after.write(tmp_path / "tuning.yaml")
    assert Noise.read(tmp_path / "tuning.yaml") == tuning.after


def test_progress_counts_evaluations_and_never_goes_back():
    robot, log, _ = recording("arm2_square")
    seen = []
    tuning = tune(robot, log[:500], free=("acceleration",), progress=lambda *state: seen.append(state))
    counts, best = zip(*seen, strict=True)
    assert counts == tuple(range(1, tuning.evaluations + 1))
    assert list(best) == sorted(best)
    assert best[-1] == tuning.log_likelihood_most


def test_results_are_the_same_every_time():
    robot, log, _ = recording("arm2_square")
    assert tune(robot, log[:800]) == tune(robot, log[:800])


def test_a_value_at_its_bound_is_marked():
    robot, log, _ = recording("arm2_square")
    tuning = tune(robot, log[:800], free=("acceleration",), span=(0.99, 1.5))
    assert tuning.at_bound == ("acceleration",)
    assert "at its bound" in tuning.to_text()


def test_correlated_errors_widen_even_what_is_not_joint_by_joint():
    robot, log, _ = recording("arm2_square_mismatch")
    tuning = tune(robot, log, free=("torsion", "position"))
    assert tuning.widening[0] > 2
    assert tuning.widening[1] == 1  # describes no reading


def resting(log):
    columns = {"t": log.t} | {f"theta_{name}": np.full(len(log), 0.3) for name in ("shoulder", "elbow")}
    return columns | {f"acc_{axis}": np.zeros(len(log)) for axis in "xz"}


def test_a_log_without_motion_is_refused():
    robot = arm()
    still = Log.from_table(resting(draw(robot, TRUE, 50, 0)[0]), robot, "still.parquet")
    with pytest.raises(LogError, match=r"still\.parquet: no motor moves"):
        tune(robot, still)


def test_walks_of_links_are_found_joint_by_joint():
    robot, log, _ = recording("arm2_square")
    tuning = tune(robot, log[:300], Noise(jerk=15.0, velocity_walk=1e-3), free=("velocity_walk",))
    assert tuning.names == ("velocity_walk_axis2", "velocity_walk_axis3")
    assert tuning.log_likelihood_most >= tuning.log_likelihood_before
    assert len(tuning.after.velocity_walk) == 2


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"free": ("stiffness",)}, "'stiffness' is not one of transmission, motor_velocity"),
        ({"free": ()}, "expected a sequence of attributes"),
        ({"free": "jerk"}, "expected a sequence of attributes"),
        ({"free": ("transmission",), "noise": Noise(transmission=0.0)}, "transmission starts at 0"),
        ({"free": ("position_walk",)}, "position_walk starts at 0"),
        ({"span": (2.0, 3.0)}, "span is"),
        ({"span": (0.5, np.inf)}, "span is"),
        ({"gate": 5.0}, "gate"),
        ({"noise": Noise(transmission=(1e-5,) * 3)}, "transmission has 3 entries, expected 1 or 2"),
    ],
)
def test_settings_that_cannot_be_used_are_refused(options, words):
    robot, log, _ = recording("arm2_square")
    with pytest.raises(EstimatorError, match=words):
        tune(robot, log[:300], **options)


def test_no_log_is_refused():
    with pytest.raises(EstimatorError, match="no log"):
        tune(arm(), [])
