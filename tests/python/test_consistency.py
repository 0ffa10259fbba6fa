"""Consistency figures: right on series of known statistics and on runs drawn from the model, and in what they say."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from linkside import EstimatorError, ExtendedKalmanFilter, KalmanEstimate, Noise, RauchTungStriebelSmoother
from linkside.consistency import consistency
from linkside.statistics import autocovariance, long_run_variance

from .drawn import arm, draw

NOISE = Noise(jerk=20.0, torsion=0.0, transmission=2e-5, motor_bias=0.0, motor_bias_walk=0.0, velocity=0.02)
RIGHT = {"damping": False, "biases": ("acceleration",)}


def estimate_of(normalised, **more):
    """An estimate whose innovations are these, of standard deviation one."""
    rows = len(normalised)
    zero = np.zeros((rows, 1))
    fields = {
        "t": np.arange(rows) * 1e-3,
        **dict.fromkeys(("q", "dq", "theta", "dtheta"), zero),
        "status": np.zeros(rows, np.uint8),
        "names": ("a",),
        "nis": np.nansum(normalised**2, axis=1),
        "used": np.isfinite(normalised).sum(axis=1).astype(np.uint32),
        "log_likelihood": np.full(rows, -0.5),
        "innovation": normalised,
        "innovation_std": np.ones_like(normalised),
    }
    return KalmanEstimate(**(fields | more))


def noise_of(rows, channels, seed=0):
    return np.random.default_rng(seed).standard_normal((rows, channels))


@given(st.lists(st.floats(-10, 10), min_size=2, max_size=40), st.integers(0, 60))
def test_autocovariance_is_the_sum_of_products(values, lags):
    values = np.array(values)
    padded = np.concatenate((values, np.zeros(lags)))
    plain = [values @ padded[lag : lag + len(values)] / len(values) for lag in range(lags + 1)]
    np.testing.assert_allclose(autocovariance(values, lags), plain, rtol=0, atol=1e-9)


@given(st.lists(st.tuples(st.floats(-10, 10), st.booleans()), min_size=3, max_size=40))
def test_missing_values_equal_deleted_ones(pairs):
    values, missing = np.array([v for v, _ in pairs]), np.array([m for _, m in pairs])
    holes = np.where(missing, np.nan, values)
    np.testing.assert_array_equal(autocovariance(holes, 5), autocovariance(values[~missing], 5))
    assert long_run_variance(holes) == long_run_variance(values[~missing])


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.9, 0.98])
def test_long_run_variance_of_an_autoregression(memory):
    series, drive = np.zeros(200_000), np.random.default_rng(1).standard_normal(200_000)
    for row in range(1, len(series)):
        series[row] = memory * series[row - 1] + drive[row]
    assert long_run_variance(series) == pytest.approx(1 / (1 - memory) ** 2, rel=0.2)


@pytest.mark.parametrize("values", [[], [1.0], [np.nan, np.nan], [2.0, 2.0, 2.0]])
def test_long_run_variance_of_next_to_nothing_is_zero(values):
    assert long_run_variance(np.array(values)) == 0


@pytest.mark.parametrize(("scale", "verdict"), [(1.0, "consistent"), (1.5, "overconfident"), (0.7, "cautious")])
def test_nis_tells_size(scale, verdict):
    report = consistency(estimate_of(scale * noise_of(4000, 3)))
    assert report.innovations.verdict == verdict
    assert report.innovations.mean == pytest.approx(scale**2, rel=0.05)
    assert report.log_likelihood == -2000
    assert report.white.all()
    assert verdict in report.to_text().splitlines()[0]


def test_bounds_hold_as_often_as_they_say():
    reports = [consistency(estimate_of(noise_of(300, 2, seed)), level=0.9) for seed in range(400)]
    verdicts = [report.innovations.verdict == "consistent" for report in reports]
    white = [flag for report in reports for flag in report.white]
    inside = np.mean([report.innovations.inside for report in reports])
    assert abs(np.mean(verdicts) - 0.9) < 0.05
    assert abs(np.mean(white) - 0.9) < 0.05
    assert inside == pytest.approx(0.9, abs=0.01)


def test_bounds_are_those_of_chi_square():
    holes = noise_of(500, 3)
    holes[::3, 1] = np.nan
    holes[7] = np.nan
    report = consistency(estimate_of(holes))
    total = np.isfinite(holes).sum()
    assert (report.innovations.low, report.innovations.high) == pytest.approx(
        stats.chi2.ppf([0.005, 0.995], total) / total
    )
    assert np.isnan(report.nis[7])
    assert report.innovations.mean == pytest.approx(np.nansum(holes**2) / total)


def test_correlated_innovations_are_told_by_channel():
    innovations = noise_of(3000, 2)
    innovations[:, 1] = np.convolve(innovations[:, 1], np.ones(20) / np.sqrt(20), "same")
    report = consistency(estimate_of(innovations), channels=("theta_a", "acc_x"))
    assert report.white.tolist() == [True, False]
    assert report.autocorrelation[0, 1] == pytest.approx(0.95, abs=0.02)
    assert "acc_x: 0.9" in report.to_text()
    assert "theta_a:" not in report.to_text()


def test_a_filter_on_its_own_model_is_consistent():
    """NIS and NEES of fifty runs within their 99 % bounds."""
    robot = arm()
    runs = [draw(robot, NOISE, 150, seed) for seed in range(50)]
    logs, truths = zip(*runs, strict=True)
    estimates = ExtendedKalmanFilter(robot, NOISE, start="rest", tolerances=False, **RIGHT).run(
        logs, covariance=True, innovations=True
    )
    reports = [consistency(e, truth) for e, truth in zip(estimates, truths, strict=True)]
    nis, used = (sum(getattr(e, name)[5:].sum() for e in estimates) for name in ("nis", "used"))
    assert stats.chi2.ppf(0.005, used) < nis < stats.chi2.ppf(0.995, used)
    last = sum(2 * report.nees[-1] for report in reports)
    assert stats.chi2.ppf(0.005, 100) < last < stats.chi2.ppf(0.995, 100)
    assert np.mean([report.white.mean() for report in reports]) > 0.9
    assert np.mean([report.position.verdict == "consistent" for report in reports]) > 0.8
    assert np.mean([report.tool.mean for report in reports]) == pytest.approx(1, abs=0.25)


def test_a_constant_offset_is_told_apart():
    robot = arm()
    log, truth = draw(robot, NOISE, 800, seed=3, offset=2e-3)
    report = consistency(ExtendedKalmanFilter(robot, NOISE, **RIGHT).run(log, covariance=True), truth)
    assert report.position.verdict == "overconfident"
    assert report.position.varying < 0.1 * report.position.mean
    assert "calibrate" in report.to_text()
    assert "run with innovations=True" in report.to_text()


def test_joints_one_by_one_where_the_covariance_was_not_kept():
    robot = arm()
    log, truth = draw(robot, NOISE, 300, seed=4)
    kept = ExtendedKalmanFilter(robot, NOISE, **RIGHT).run(log, covariance=True)
    plain = consistency(replace(kept, covariance=None), truth)
    error = (kept.q - truth.q) / kept.q_std
    np.testing.assert_allclose(plain.nees, (error**2).mean(axis=1), rtol=1e-9)
    whole = consistency(kept, truth)
    block = kept.covariance[-1, :2, :2]
    last = (kept.q - truth.q)[-1]
    assert whole.nees[-1] == pytest.approx(last @ np.linalg.solve(block, last) / 2)


def test_a_truth_with_holes_counts_where_it_is_known():
    robot = arm()
    log, truth = draw(robot, NOISE, 300, seed=5)
    estimate = RauchTungStriebelSmoother(robot, NOISE, **RIGHT).run(log, covariance=True)
    q = truth.q.copy()
    q[100:200] = np.nan
    report = consistency(estimate, replace(truth, q=q))
    assert np.isnan(report.nees[100:200]).all()
    assert np.isfinite(report.nees[:100]).all()
    nothing = consistency(estimate, replace(truth, q=np.full_like(q, np.nan), tool_position=None))
    assert nothing.position is None
    assert nothing.tool is None


@pytest.mark.parametrize("with_truth", [False, True])
@pytest.mark.parametrize("innovations", [False, True])
def test_figure(tmp_path, with_truth, innovations):
    robot = arm()
    log, truth = draw(robot, NOISE, 120, seed=6)
    estimate = ExtendedKalmanFilter(robot, NOISE, **RIGHT).run(log, innovations=innovations)
    figure = consistency(estimate, truth if with_truth else None).figure()
    figure.savefig(tmp_path / "consistency.png")
    titles = " ".join(axes.get_title() for axes in figure.axes)
    assert "NIS" in titles
    assert ("NEES" in titles) == with_truth


def test_figure_of_a_single_sample():
    consistency(estimate_of(noise_of(1, 2))).figure().canvas.draw()


@pytest.mark.parametrize(
    ("estimate", "options", "words"),
    [
        (estimate_of(noise_of(9, 1), nis=None), {}, "no innovations"),
        (estimate_of(np.full((9, 1), np.nan)), {}, "no innovations"),
        (estimate_of(noise_of(9, 1)), {"level": 1.0}, "level is 1.0"),
        (estimate_of(noise_of(9, 1)), {"lags": 0}, "lags is 0"),
        (estimate_of(noise_of(9, 1)), {"channels": ("a", "b")}, "2 channels are named"),
        (estimate_of(noise_of(9, 1)), {"truth": estimate_of(noise_of(9, 1))}, "no standard deviations"),
    ],
)
def test_what_cannot_be_judged_is_refused(estimate, options, words):
    with pytest.raises(EstimatorError, match=words):
        consistency(estimate, **options)
