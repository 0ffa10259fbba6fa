"""Comparing motions: what is measured, by closed forms; alignment in time; segments, repeats; files and the command."""

import csv
import io
import json
import re
from itertools import combinations

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import permutation_test

from linkside import Estimate, EstimatorError, LogError, Robot, cli, demo
from linkside.comparison import Segment, between_rests, compare, find_shift, read_motion, read_segments
from linkside.comparison.outliers import apart, distances, outlying

RATE = 1000.0


def motion(t, phase=0.0, offset=0.0, names=("a", "b"), tool=True):
    """Two joints that swing, and a tool that follows them."""
    t = np.asarray(t, float)
    q = np.stack([np.sin(3 * t + phase) + offset, 0.5 * np.cos(2 * t + phase)], axis=1)
    dq = np.stack([3 * np.cos(3 * t + phase), -np.sin(2 * t + phase)], axis=1)
    position = np.column_stack([q, q.sum(axis=1)]) if tool else None
    return Estimate(t, q, dq, q, dq, np.zeros(len(t), np.uint8), names, tool_position=position)


def table(comparison, **wanted):
    return [m for m in comparison.measures if all(getattr(m, name) == value for name, value in wanted.items())]


def only(comparison, **wanted):
    (found,) = table(comparison, **wanted)
    return found


T = np.arange(2000) / RATE


def test_a_constant_offset_is_all_there_is():
    found = only(compare(motion(T), {"e": motion(T, offset=1e-3)}), signal="q_a")
    for value in (found.mean, found.rms, found.max, found.p50, found.p95):
        assert value == pytest.approx(1e-3, rel=1e-9)
    assert found.rms_centred < 1e-15
    assert found.samples == len(T)
    tool = only(compare(motion(T), {"e": motion(T, offset=1e-3)}), signal="tool")
    assert tool.rms == pytest.approx(np.sqrt(2) * 1e-3, rel=1e-9)  # in x and in z


def test_measures_of_a_sine():
    truth, estimate = motion(T), motion(T)
    error = 2e-3 * np.sin(2 * np.pi * 5 * T)  # ten whole periods
    estimate.q[:, 0] += error + 1e-3
    found = only(compare(truth, {"e": estimate}), signal="q_a")
    assert found.mean == pytest.approx(1e-3, rel=1e-9)
    assert found.rms_centred == pytest.approx(2e-3 / np.sqrt(2), rel=1e-9)
    assert found.rms == pytest.approx(np.hypot(1e-3, 2e-3 / np.sqrt(2)), rel=1e-9)
    assert found.max == pytest.approx(3e-3, rel=1e-9)


@settings(max_examples=6)
@given(late=st.floats(-0.2, 0.2), rate=st.sampled_from([200.0, 333.0, 1000.0]))
def test_a_shift_is_found(late, rate):
    t = np.arange(int(2 * rate)) / rate
    estimate = motion(t - late)
    estimate = Estimate(t, estimate.q, estimate.dq, estimate.theta, estimate.dtheta, estimate.status, estimate.names)
    assert find_shift(motion(T), estimate) == pytest.approx(late, abs=2e-6)
    found = only(compare(motion(T), {"e": estimate}, shift="auto"), signal="q_a")
    assert found.rms < 1e-5


def test_the_reference_is_interpolated_but_not_over_gaps():
    coarse = np.arange(0, 2, 0.02)
    truth = motion(np.delete(coarse, slice(40, 60)))
    found = compare(truth, {"e": motion(T, tool=False)})
    assert only(found, signal="q_a").rms < 2e-7  # cubic: (0.02)⁴ 3⁴ / 384
    error = found.differences[0].signals["q_a"][:, 0]
    inside = (coarse[39] + 1e-9 < T) & (coarse[60] - 1e-9 > T)
    assert np.isnan(error[inside]).all()
    assert np.isfinite(error[~inside & (coarse[-1] >= T)]).all()


def test_rows_at_the_same_time_are_taken_as_they_are():
    truth, estimate = motion(T), motion(T)
    truth.q[500] = np.nan
    error = compare(truth, {"e": estimate}).differences[0].signals["q_a"]
    assert (error[np.isfinite(error)] == 0).all()
    assert np.flatnonzero(np.isnan(error)).tolist() == [500]


def test_segments_are_measured_apart():
    estimate = motion(T)
    estimate.q[T >= 1, 0] += 1e-3
    parts = (Segment("before", 0.0, 0.9995), Segment("after", 1.0, 2.0))
    found = compare(motion(T), {"e": estimate}, segments=parts)
    assert only(found, signal="q_a", segment="before").max == 0
    assert only(found, signal="q_a", segment="after").rms == pytest.approx(1e-3)
    assert only(found, signal="q_a", segment="all").samples == len(T)


def test_parts_between_rests():
    t = np.arange(3000) / RATE
    moves = ((t > 0.5) & (t < 1.0)) | ((t > 2.0) & (t < 2.5))
    dq = np.where(moves, 0.3, 0.0)[:, None]
    q = np.cumsum(dq, axis=0) / RATE
    rest = Estimate(t, q, dq, q, dq, np.zeros(len(t), np.uint8), ("a",))
    first, second = between_rests(rest)
    assert (first.start, first.end) == pytest.approx((0.501, 0.999))
    assert (second.start, second.end) == pytest.approx((2.001, 2.499))


def test_repeats_have_a_mean_and_a_spread():
    errors = (-1e-3, 0.0, 1e-3)
    repeats = {f"run {i}": motion(T + 100 * i, offset=e) for i, e in enumerate(errors)}
    later = {n: Estimate(T + 7, m.q, m.dq, m.theta, m.dtheta, m.status, m.names) for n, m in repeats.items()}
    for i, name in enumerate(later):
        later[name].q[:] = motion(T, offset=errors[i]).q
    found = compare(motion(T), later, align="start", repeats=True)
    assert only(found, estimate="mean of repeats", signal="q_a").rms < 1e-12
    assert found.spread["q_a"] == pytest.approx(1e-3)
    assert found.spread["q_b"] < 1e-12


def test_of_many_repeats_joints_are_told_of_the_worst_and_the_mean():
    repeats = {f"run {i}": motion(T, offset=1e-4 * (i == 7) + 1e-5) for i in range(20)}
    text = compare(motion(T), repeats, repeats=True).to_text()
    assert re.findall(r"^(.*), joints", text, re.MULTILINE) == ["run 7", "mean of repeats"]
    assert "The joints of 19 more estimates" in text


def drifting(count, drift=0.0, odd=None, seed=0):
    """Repeats with some noise and an offset of their own, 0.1 mm each; one of them is 3 mm off."""
    rng = np.random.default_rng(seed)
    found = {}
    for i in range(count):
        one = motion(T)
        one.tool_position[:] += rng.normal(0, 1e-4, (len(T), 3)) + rng.normal(0, 1e-4, 3)
        one.tool_position[:, 0] += drift * i + (3e-3 if i == odd else 0.0)
        found[f"run {i}"] = one
    return found


def test_an_outlier_among_repeats_is_named_and_left_out():
    with_it, without = drifting(8, odd=3), drifting(8)
    del without["run 3"]
    found = compare(motion(T), with_it, repeats=True)
    assert found.repeats.outliers == ("run 3",)
    assert not found.repeats.has_trend
    assert found.repeats.distances["run 3"] == pytest.approx(3e-3, rel=0.1)
    alone = compare(motion(T), without, repeats=True)
    assert found.spread == pytest.approx(alone.spread)
    assert only(found, estimate="mean of repeats", signal="tool").rms == pytest.approx(
        only(alone, estimate="mean of repeats", signal="tool").rms
    )
    assert "outlier, left out" in found.to_text()


def scatter(rng, tails, dimensions, count=50):
    """Deviations of repeats, (R, k), in so many directions; each repeat is as large as ``tails`` has it."""
    sizes = {
        "normal": np.ones(count),
        "Laplace": np.sqrt(rng.exponential(size=count)),
        "Student": np.sqrt(5 / rng.chisquare(5, size=count)),
    }
    return rng.normal(size=(count, dimensions)) * sizes[tails][:, None]


@pytest.mark.parametrize("tails", ["normal", "Laplace", "Student"])
@pytest.mark.parametrize("dimensions", [1, 3, 100])
@pytest.mark.parametrize("drift", [0.0, 1.0])
def test_no_outlier_is_named_among_fifty_clean_repeats(tails, dimensions, drift):
    """In one set of a hundred at most, within what chance makes of 150 sets."""
    rng = np.random.default_rng(dimensions)
    order = np.arange(50.0)
    alarms = 0
    for _ in range(150):
        repeats = scatter(rng, tails, dimensions) + drift * order[:, None]
        alarms += outlying(apart(repeats @ repeats.T, order if drift else None)).any()
    assert alarms <= 4  # of 1 % of 150, more: 2 %


@pytest.mark.parametrize(
    ("tails", "size", "found"), [("normal", 12, 0.9), ("Laplace", 25, 0.75), ("Student", 40, 0.75)]
)
def test_an_outlier_among_fifty_is_named_alone(tails, size, found):
    rng = np.random.default_rng(1)
    named = []
    for _ in range(60):
        repeats = scatter(rng, tails, 3)
        direction = rng.normal(size=3)
        repeats[7] = size * np.sqrt(3) * direction / np.linalg.norm(direction)
        named.append(np.flatnonzero(outlying(apart(repeats @ repeats.T))).tolist())
    assert named.count([7]) >= found * len(named)


def test_of_springs_that_scatter_only_the_wrong_one_is_named():
    """Three springs that scatter by 2 %, each with a path of its own; in one repeat they are 30 % too soft."""
    rng = np.random.default_rng(2)
    shapes = 1e-3 * np.stack([np.sin(3 * T), np.cos(5 * T), np.sin(7 * T)])
    repeats = {}
    for i in range(50):
        springs = rng.normal(0, 0.02, 3) - 0.3 * (i == 20)
        one = motion(T)
        one.tool_position[:, 2] += springs @ shapes + rng.normal(0, 1e-6, len(T))
        repeats[f"run {i}"] = one
    assert compare(motion(T), repeats, repeats=True).repeats.outliers == ("run 20",)


def test_the_median_path_is_the_median():
    """Of paths of one number the spatial median is the median; with a drift, the line of least absolute deviations."""
    values = np.random.default_rng(3).normal(size=7)
    for order, center in ((None, np.median(values)), (np.arange(7.0), _least_absolute_line(values))):
        sizes = distances(apart(np.outer(values, values), order))
        assert sizes == pytest.approx(np.abs(values - center), abs=2e-3)


def _least_absolute_line(values):
    """It goes through two of the points: try all pairs."""
    at = np.arange(len(values))
    lines = [np.polyval(np.polyfit(at[[i, j]], values[[i, j]], 1), at) for i, j in combinations(at, 2)]
    return min(lines, key=lambda line: np.abs(values - line).sum())


def test_a_trend_of_repeats_is_measured_though_one_is_an_outlier():
    found = compare(motion(T), drifting(9, drift=1e-3, odd=4), repeats=True).repeats
    assert found.outliers == ("run 4",)
    assert found.has_trend
    assert found.trend["tool"] == pytest.approx(1e-3, rel=0.05)
    assert "drift" in compare(motion(T), drifting(9, drift=1e-3), repeats=True).to_text()


def test_trends_and_outliers_by_chance_are_rare():
    runs = [compare(motion(T), drifting(6, seed=seed), repeats=True).repeats for seed in range(20)]
    assert sum(run.has_trend for run in runs) <= 2
    assert sum(bool(run.outliers) for run in runs) <= 3


def test_the_chance_of_a_trend_is_that_of_scipy():
    """For paths of one number the test is SciPy's permutation test of a correlation."""
    values = np.array([0.1, 0.3, 0.2, 0.5, 0.4, 0.6])
    repeats = {f"{i}": motion(T[:1] + 0.0, tool=False) for i in range(6)}
    for one, value in zip(repeats.values(), values, strict=True):
        one.q[:, 0] += value
    found = compare(motion(T), repeats, repeats=True).repeats
    steps = np.arange(6.0)
    scipys = permutation_test(
        (values,), lambda x: np.abs(x @ (steps - 2.5)), permutation_type="pairings", alternative="greater"
    )
    assert found.p_value == pytest.approx(scipys.pvalue)


@pytest.mark.parametrize(
    ("estimate", "options", "words"),
    [
        (motion(T + 100), {}, "no time in common"),
        (motion(T, names=("c", "d"), tool=False), {}, "no signal in common"),
        (motion(T, names=("c", "d"), tool=False), {"shift": "auto"}, "no joint in common"),
        (motion(T), {"shift": np.nan}, "finite time"),
        (motion(T), {"align": "end"}, "expected one of time, start"),
    ],
)
def test_what_cannot_be_compared(estimate, options, words):
    with pytest.raises(EstimatorError, match=words):
        compare(motion(T), {"e": estimate}, **options)


def run(*arguments):
    return CliRunner().invoke(cli.main, ["compare", *map(str, arguments)])


@pytest.fixture(scope="module")
def estimates(tmp_path_factory):
    """The demo's truth, and two files that differ from it by known amounts."""
    folder = tmp_path_factory.mktemp("estimates")
    truth = Estimate.read(demo.TRUTH)
    for name, off in (("one", 1e-3), ("two", 2e-3)):
        truth.tool_position[:, 0] += off
        truth.write(folder / f"{name}.parquet")
        truth.tool_position[:, 0] -= off
    return folder


def test_command_and_files(estimates, tmp_path):
    one, two = estimates / "one.parquet", estimates / "two.parquet"
    result = run(
        demo.TRUTH, one, two, "--segments", "rests", "--figure", tmp_path / "f.svg", "--out", tmp_path / "c.json"
    )
    assert result.exit_code == 0, result.output
    assert "tool, distance from" in result.output
    told = json.loads((tmp_path / "c.json").read_text())
    tool = {m["estimate"]: m for m in told["measures"] if m["signal"] == "tool" and m["segment"] == "all"}
    assert tool["one"]["rms"] == pytest.approx(1e-3)
    assert tool["two"]["rms"] == pytest.approx(2e-3)
    assert tool["two"]["rms_centred"] < 1e-12
    assert (tmp_path / "f.svg").stat().st_size > 1000
    for suffix in (".csv", ".tex", ".txt"):
        assert run(demo.TRUTH, one, "--out", tmp_path / f"c{suffix}").exit_code == 0
    rows = list(csv.DictReader(io.StringIO((tmp_path / "c.csv").read_text())))
    assert {row["signal"] for row in rows} >= {"tool", "q_a1", "dq_a1"}
    assert r"one & all & 1.0000" in (tmp_path / "c.tex").read_text()


def test_a_log_is_compared_by_its_command(estimates):
    robot = Robot.load(demo.ROBOT)
    commanded = read_motion(demo.LOG, robot)
    assert commanded.tool_position == pytest.approx(robot.tool_position(commanded.q))
    result = run(demo.LOG, estimates / "one.parquet", "--robot", demo.ROBOT, "--names", "tried")
    assert result.exit_code == 0, result.output
    assert "tried" in result.output


@pytest.mark.parametrize(
    ("text", "words"),
    [("start,stop\n0,1\n", "column 'end' is missing"), ("start,end\n0,1\n2,2\n", "row 1 goes from 2.0 to 2.0")],
)
def test_segments_that_cannot_be_read(tmp_path, text, words):
    file = tmp_path / "sides.csv"
    file.write_text(text)
    with pytest.raises(LogError, match=words):
        read_segments(file)
    assert run(demo.TRUTH, demo.TRUTH, "--segments", file).exit_code == 2


def test_named_segments(tmp_path):
    (tmp_path / "sides.csv").write_text("name,start,end\nup,0,0.5\n,0.5,0.9\n")
    assert read_segments(tmp_path / "sides.csv") == (Segment("up", 0.0, 0.5), Segment("part 2", 0.5, 0.9))


def test_outputs_are_not_inputs(estimates):
    one = estimates / "one.parquet"
    before = one.read_bytes()
    assert run(demo.TRUTH, one, "--out", one).exit_code == 2
    assert one.read_bytes() == before
    assert run(demo.TRUTH, one, "--shift", "soon").exit_code == 2
