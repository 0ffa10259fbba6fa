"""Noise by expectation and maximisation against dense Gaussians, SciPy and chance; what it refuses."""

import re
from functools import cache

import numpy as np
import pytest
import scipy.optimize
from click.testing import CliRunner

from linkside import EstimatorError, Log, Noise, Robot
from linkside.cli import main
from linkside.tuning import tune
from linkside.tuning.noise_em import ExpectationMaximisation, with_times
from linkside.tuning.noise_search import NoiseSearch

from .drawn import PERIOD, arm, draw
from .robots import ARM, DATA, spring
from .test_kalman_filter import DRIVE, NOISE, SLIDE, drawn, slide, slide_matrices

WIDE = (1e-3, 1e3)
LINEAR = NOISE.updated(transmission=2e-4, acceleration_bias_walk=2.0, velocity=0.05)
FREE = ("transmission", "acceleration", "jerk", "acceleration_bias_walk")
START = [LINEAR.position, LINEAR.velocity, LINEAR.initial_acceleration, LINEAR.motor_bias, LINEAR.acceleration_bias]
TOLD = np.array([0.3, -0.6, 0.5, -0.4])
"""Logarithms of factors on the noise that the cart was drawn with."""


def search(columns, free=FREE, noise=LINEAR):
    """Of a recording of the cart, whose start is known."""
    settings = {"tolerances": False, "link_disturbance": False, "start": (np.zeros(5), np.diag(np.square(START)))}
    log = Log.from_table(columns, slide(), check=False)
    return NoiseSearch(slide(), [log], with_times(noise, free), free, settings, None)


@cache
def recorded(rows=80, seed=7):
    return drawn(LINEAR, np.random.default_rng(seed), rows)[0]


@cache
def dense(rows=80):
    """Covariance of the cart's readings, interleaved: what each free value gives at its start, and the rest."""
    f, q, h, _, r = slide_matrices(with_times(LINEAR, FREE), PERIOD)
    sources = [np.zeros((5, 5)), np.zeros((5, 5)), q.copy(), np.zeros((5, 5)), np.zeros((5, 5))]
    sources[2][3:] = 0
    sources[3][4, 4] = q[4, 4]
    sources[4][3, 3] = q[3, 3]
    powers = [np.linalg.matrix_power(f, k) for k in range(rows)]
    found = []
    for at, source in enumerate(sources):
        whole = np.zeros((2 * rows, 2 * rows))
        for born in range(rows):
            root = np.diag(np.square(START)) * (at == 4) if born == 0 else source
            path = np.vstack([np.zeros((2 * born, 5)), *(h @ powers[k] for k in range(rows - born))])
            whole += path @ root @ path.T
        found.append(whole)
    found[0] += np.kron(np.eye(rows), np.diag([LINEAR.transmission**2, 0]))
    found[1] += np.kron(np.eye(rows), np.diag([0, r[1, 1]]))
    found[4] += np.kron(np.eye(rows), np.diag([r[0, 0] - LINEAR.transmission**2, 0]))
    return found


def errors(columns):
    """Readings less what the cart reads at zero, interleaved."""
    offset = slide_matrices(LINEAR, PERIOD)[3]
    theta = columns["theta_x"] + DRIVE["damping"] / DRIVE["stiffness"] * columns["dtheta_x"]
    return (np.stack([theta, columns["acc_z"]], axis=1) - offset).ravel()


def textbook(x, y):
    """Log-likelihood, its derivatives by x, and each source's mean square given the readings over its variance."""
    *sources, rest = dense(len(y) // 2)
    scaled = [np.exp(2 * value) * source for value, source in zip(x, sources, strict=True)]
    inverse = np.linalg.inv(sum(scaled) + rest)
    whitened = inverse @ y
    log_likelihood = 0.5 * (np.linalg.slogdet(inverse)[1] - y @ whitened - len(y) * np.log(2 * np.pi))
    twice = np.array([whitened @ source @ whitened - np.trace(inverse @ source) for source in scaled])
    rows = len(y) // 2
    return log_likelihood, twice, 1 + twice / [rows, rows, 3 * (rows - 1), rows - 1]


def test_evidence_and_step_are_those_of_dense_gaussians():
    em = ExpectationMaximisation(search(recorded()), WIDE)
    found = em.evidence(TOLD)
    log_likelihood, score, ratios = textbook(TOLD, errors(recorded()))
    assert found.log_likelihood.sum() == pytest.approx(log_likelihood, rel=1e-9)
    assert found.score.sum(axis=0) == pytest.approx(score, rel=1e-6)
    assert np.exp(2 * em.step(found)) == pytest.approx(ratios, rel=1e-8)


def test_scores_are_slopes_of_the_likelihood_with_late_sensors_and_motor_velocities():
    """Of a linear model, against differences."""
    late = {"name": "acc", "link": "cart", "axes": "z", "noise_std": 0.05, "corner_frequency": 40.0, "delay": 2.5e-3}
    robot = Robot.from_urdf(SLIDE, joints=[DRIVE], accelerometers=[late], encoder={"resolution": 1e-6})
    log = Log.from_table(recorded(120), robot, check=False)
    settings = {"tolerances": False, "link_disturbance": False, "dtheta": True, "start": "rest"}
    noise = with_times(LINEAR.updated(motor_velocity=1e-2), FREE)
    found = NoiseSearch(robot, [log], noise, FREE, settings, None)
    em, step = ExpectationMaximisation(found, WIDE), 1e-4
    either = [[em.evidence(TOLD + sign * step * axis).log_likelihood.sum() for sign in (1, -1)] for axis in np.eye(4)]
    slopes = np.array(either) @ [1, -1] / (2 * step)
    assert em.evidence(TOLD).score.sum(axis=0) == pytest.approx(slopes, rel=1e-5, abs=1e-4)


def test_information_is_the_expected_curvature():
    """Its mean over recordings: ½ tr C⁻¹ C′ C⁻¹ C″."""
    *sources, rest = dense(40)
    inverse = np.linalg.inv(sum(sources) + rest)
    parts = [inverse @ source for source in sources]
    expected = 2 * np.array([[np.trace(a @ b) for b in parts] for a in parts])
    each = [ExpectationMaximisation(search(recorded(40, seed)), WIDE).evidence(np.zeros(4)) for seed in range(30)]
    found = np.array([one.information.sum(axis=0) for one in each])
    scatter = found.std(axis=0) / np.sqrt(len(found))
    assert np.abs((found.mean(axis=0) - expected) / scatter).max() < 3.5
    assert (scatter < 0.1 * np.sqrt(np.outer(np.diag(expected), np.diag(expected)))).all()


def test_no_step_of_expectation_and_maximisation_lowers_the_likelihood():
    em, x, values = ExpectationMaximisation(search(recorded(400)), WIDE), TOLD, []
    for _ in range(25):
        found = em.evidence(x)
        values.append(found.log_likelihood.sum())
        x = x + em.step(found)
    assert np.diff(values).min() > -1e-9 * abs(values[-1])
    assert values[-1] - values[0] > 50


def test_the_optimum_is_that_of_maximum_likelihood():
    free = ("transmission", "jerk", "acceleration_bias_walk")
    chosen = [FREE.index(name) for name in free]
    y = errors(recorded())

    def cost(values):
        x = np.zeros(4)
        x[chosen] = values
        log_likelihood, score, _ = textbook(x, y)
        return -log_likelihood, -score[chosen]

    best = scipy.optimize.minimize(cost, np.zeros(3), jac=True, method="BFGS", options={"gtol": 1e-7})
    fit = ExpectationMaximisation(search(recorded(), free), WIDE).fit()
    assert fit.refused == {}
    assert (fit.x - best.x) / fit.std == pytest.approx(np.zeros(3), abs=2e-3)


def test_intervals_hold_the_truth():
    """95 of 100, within what is likely of 40; and standard errors are what estimates scatter by."""
    free = ("transmission", "jerk")
    fits = [ExpectationMaximisation(search(recorded(250, seed), free), WIDE).fit() for seed in range(20)]
    away = np.array([fit.x / fit.std for fit in fits])
    assert np.mean(np.abs(away) < 1.96) > 0.88
    assert 0.75 < np.std(away) < 1.2


def test_finds_what_a_search_finds():
    robot = arm()
    true = Noise(jerk=20.0, torsion=0.0, transmission=3e-5, motor_bias=0.0, motor_bias_walk=0.0, velocity=0.02)
    logs = [draw(robot, true, rows, seed)[0] for rows, seed in ((300, 1), (200, 2))]
    settings = {"damping": False, "biases": ("acceleration",), "span": (0.1, 10)}
    start = true.updated(transmission=1e-4)
    found = [tune(robot, logs, start, method=method, **settings) for method in ("search", "em")]
    assert found[1].most_likely.transmission == pytest.approx(found[0].most_likely.transmission, rel=5e-3)
    assert found[1].log_likelihood_most > found[0].log_likelihood_most - 0.01
    assert found[1].evaluations < 0.3 * found[0].evaluations
    assert found[1].accepted
    assert found[0].std == ()
    assert found[0].accepted


def test_sensors_are_found_one_by_one():
    sensors = [
        {"name": name, "link": "hand", "xyz": [x, 0.05, 0.1], "noise_std": 0.05, "axes": axes}
        for name, x, axes in (("near", 0.02, "xz"), ("far", 0.4, "xyz"))
    ]
    robot = Robot.from_urdf(ARM, [spring("shoulder"), spring("elbow")], accelerometers=sensors, tool={"link": "hand"})
    still = dict.fromkeys(("motor_bias", "motor_bias_walk", "acceleration_bias", "acceleration_bias_walk"), 0.0)
    true = Noise(jerk=20.0, torsion=0.0, velocity=0.02, acceleration=(3.0, 0.5), **still)
    log = draw(robot, true, 600, 3)[0]
    start = true.updated(acceleration=(1.0, 1.0))
    found = tune(robot, log, start, ("acceleration",), method="em", damping=False, biases=(), widen=False)
    assert found.names == ("acceleration_near", "acceleration_far")
    assert found.after.acceleration == pytest.approx((3.0, 0.5), rel=0.06)
    widened = tune(robot, log, start, ("acceleration",), method="em", damping=False, biases=())
    assert max(widened.widening) < 1.4
    with pytest.raises(EstimatorError, match="acceleration has 3 entries, expected 1 or 2"):
        true.updated(acceleration=(1.0, 1.0, 1.0)).arrays(robot, ("motor", "acceleration"))


def test_what_recordings_do_not_tell_is_refused_by_name():
    robot = Robot.load(DATA / "arm2_square/robot.yaml")
    log = Log.read(DATA / "arm2_square/log.parquet", robot)[:300]
    free = ("acceleration", "position", "rate", "motor_bias_walk")
    found = tune(robot, log, free=free, method="em")
    first = "after the first sample nothing in the recordings has it"
    assert found.refused == {
        "position": first,
        "rate": first,
        "motor_bias_walk": "the recordings hardly depend on it",
    }
    assert found.after.motor_bias_walk == Noise().motor_bias_walk
    assert [std is None for std in found.std] == [False, True, True, True]
    text = found.to_text()
    assert re.search(r"^motor_bias_walk .* as before: the recordings hardly depend on it$", text, re.MULTILINE)
    assert re.search(r"^acceleration .* to [\d.]+$", text, re.MULTILINE)


def test_two_values_that_the_same_readings_have_are_not_told_apart():
    found = ExpectationMaximisation(
        search(
            recorded(300),
            ("transmission", "motor_velocity"),
            LINEAR.updated(motor_velocity=LINEAR.transmission * DRIVE["stiffness"] / DRIVE["damping"]),
        ),
        WIDE,
    ).fit()
    assert len(found.refused) == 1
    assert next(iter(found.refused.values())).startswith("it cannot be distinguished from")


def test_noise_that_predicts_no_better_is_not_accepted():
    """Of the noise that it was drawn with, a recording has nothing to correct."""
    columns = drawn(LINEAR, np.random.default_rng(2), 300)[0]
    log = Log.from_table(columns, slide(), check=False)
    found = tune(slide(), log, LINEAR, method="em", start=(np.zeros(5), np.diag(np.square(START))))
    assert found.held_back.gain < 0
    assert not found.accepted
    assert "does not predict better than the noise before" in found.objections[0]
    assert f"not accepted: {found.objections[0]}" in found.to_text()


def run(*arguments):
    return CliRunner().invoke(main, ["tune", *map(str, arguments)])


def test_command_writes_what_is_accepted_and_nothing_else(tmp_path):
    files, out = [DATA / "arm2_square" / name for name in ("robot.yaml", "log.parquet")], tmp_path / "tuning.yaml"
    report = tmp_path / "report.html"
    refused = run(*files, "--em", "--free", "position", "--out", out, "--report", report)
    assert refused.exit_code == 3
    assert f"not written: {out}" in refused.output
    assert "not accepted: the recordings tell none of the free values" in refused.output
    assert "The noise after tuning is not to be used" in report.read_text()
    assert not out.exists()
    accepted = run(*files, "--em", "--out", out)
    assert accepted.exit_code == 0
    assert re.search(r"readings held back: log-likelihood \+\d", accepted.output)
    assert Noise.read(out).transmission[0] < Noise().transmission


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"method": "guess"}, "method is 'guess', expected 'search' or 'em'"),
        ({"loss": "huber"}, "loss is 'huber', expected 'squares' for method='em'"),
        ({"linearisation": "unscented"}, "linearisation is 'unscented'"),
        ({"link_disturbance": True}, "link_disturbance is not for method='em'"),
    ],
)
def test_settings_that_are_not_for_it_are_refused(options, words):
    log = Log.from_table(recorded(), slide(), check=False)
    with pytest.raises(EstimatorError, match=re.escape(words)):
        tune(slide(), log, LINEAR, **{"method": "em"} | options)
