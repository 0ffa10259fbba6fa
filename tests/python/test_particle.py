"""Particle filters: towards the Kalman filter as N grows, on recordings, and with what only particles can do."""

from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from linkside import (
    Estimate,
    EstimatorError,
    ExtendedKalmanFilter,
    Log,
    MarginalizedParticleFilter,
    Mixture,
    Noise,
    NumericalError,
    ParticleFilter,
    RauchTungStriebelSmoother,
    Robot,
    Status,
)

from .processors import outputs

DATA = Path(__file__).parents[1] / "data"
SLIDE = """<robot name="slide"><link name="base"/>
  <link name="cart"><inertial><mass value="3"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
  <joint name="x" type="prismatic"><parent link="base"/><child link="cart"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
LINEAR = Noise(jerk=300.0, torsion=0.0, transmission=1e-3, acceleration_bias=0.3, position=1e-3, motor_bias=1e-3)


@cache
def slide():
    """A mass on a spring along a line: linear in everything, so that the EKF is the Kalman filter."""
    drive = {"name": "x", "stiffness": 3e3, "damping": 1.0, "motor_inertia": 1.0}
    sensor = {"name": "a", "link": "cart", "xyz": [0, 0, 0], "noise_std": 0.3, "axes": "x"}
    robot = Robot.from_urdf(SLIDE, joints=[drive], accelerometers=[sensor], encoder={"resolution": 1e-6})
    t = 1e-3 * np.arange(40)
    rng = np.random.default_rng(3)
    columns = {"theta_x": 1e-3 * rng.standard_normal(40), "a_x": 0.5 + 0.3 * rng.standard_normal(40)}
    return robot, Log.from_table({"t": t, **columns}, robot)


@cache
def recording(name="arm2_square"):
    robot = Robot.load(DATA / name / "robot.yaml")
    return robot, Log.read(DATA / name / "log.parquet", robot)


def errors(method, count, seeds, run="run", noise=LINEAR, **settings):
    """Deviations from the Kalman filter, in its standard deviations: of the mean, the deviation, the likelihood.

    Of the cloud alone: nothing puts it back.
    """
    settings = {"collapse": "flag", "tolerances": False} | settings
    robot, log = slide()
    reference = {"run": ExtendedKalmanFilter, "smooth": RauchTungStriebelSmoother}[run]
    exact = reference(robot, noise, tolerances=False).run(log, covariance=True)
    out = []
    for seed in range(seeds):
        filter_ = method(robot, noise, particles=count, seed=seed, **settings)
        ours = getattr(filter_, run)(log, covariance=True)
        std = np.sqrt(np.diagonal(exact.covariance, axis1=1, axis2=2))
        ours_std = np.sqrt(np.diagonal(ours.covariance, axis1=1, axis2=2))
        mean = np.sqrt(np.mean(((ours.state - exact.state) / std) ** 2))
        spread = np.sqrt(np.mean((ours_std / std - 1) ** 2))
        out.append((mean, spread, ours.log_likelihood.sum() - exact.log_likelihood.sum()))
    return np.sqrt(np.mean(np.square(out), axis=0))


@pytest.mark.parametrize("method", [ParticleFilter, MarginalizedParticleFilter])
@pytest.mark.parametrize("settings", [{"kernel": None}, {"kernel": 0.5}])
def test_on_a_linear_model_errors_shrink_with_the_root_of_n(method, settings):
    few, many = errors(method, 200, 12, **settings), errors(method, 200 * 64, 12, **settings)
    # A factor of 64 in N is one of 8; 12 seeds know a root mean square to within some 20 %.
    assert (few / many > 4).all(), (few, many)
    # At 200 the likelihood has a bias besides, which falls with N itself.
    assert (few / many < (16, 16, 32)).all(), (few, many)
    assert many[0] < 0.1
    assert many[1] < 0.1


@pytest.mark.parametrize("method", [ParticleFilter, MarginalizedParticleFilter])
def test_on_a_linear_model_smoothing_tends_to_rauch_tung_and_striebels(method):
    few, many = errors(method, 200, 12, "smooth"), errors(method, 200 * 64, 12, "smooth")
    assert (few[:2] / many[:2] > 4).all(), (few, many)
    assert (many[:2] < 0.1).all(), many


def test_smoothing_knows_more_than_filtering():
    """Over several clouds: of one with 300 particles the width is right to a factor of two, by chance."""
    robot, log = recording()
    # A cloud that is spread anew between the two passes would be another one.
    settings = {"particles": 300, "quantiles": (0.5,), "collapse": "flag", "start": "rest", "tolerances": False}
    truth = Estimate.read(DATA / "arm2_square/truth.parquet")
    log, truth = log[:2000], truth[:2000]
    errors, ratios = [], []
    for seed in range(4):
        method = MarginalizedParticleFilter(robot, seed=seed, **settings)
        filtered, smoothed = method.run(log), method.smooth(log)
        errors.append([e.error_against(truth).tool_rms_centred for e in (smoothed, filtered)])
        ratios.append(smoothed.q_std[:-1] / filtered.q_std[:-1])
        assert (smoothed.effective == filtered.effective).all()
    ours, before = np.mean(errors, axis=0)
    assert ours < before
    assert np.median(ratios) < 0.9
    assert np.allclose(smoothed.theta, filtered.theta, atol=1e-4)
    assert smoothed.best is None
    assert smoothed.quantiles is None


@pytest.mark.parametrize(("run", "reference"), [("run", ExtendedKalmanFilter), ("smooth", RauchTungStriebelSmoother)])
def test_tolerances_add_what_they_add_to_a_kalman_filter(run, reference):
    robot, log = recording("arm2_square_mismatch")
    log = log[:400]
    ours, without = (
        getattr(MarginalizedParticleFilter(robot, particles=200, tolerances=on), run)(log, covariance=True)
        for on in (True, False)
    )
    kalman, plain = (reference(robot, tolerances=on).run(log, covariance=True) for on in (True, False))
    assert (ours.q == without.q).all()
    added, expected = (a.covariance - b.covariance for a, b in ((ours, without), (kalman, plain)))
    scale = np.sqrt(np.einsum("tii->ti", kalman.covariance))
    assert np.allclose(added / scale[:, :, None], expected / scale[:, :, None], atol=1e-6 * scale.max())
    for name in ("q_std", "tool_std"):
        added, expected = (getattr(a, name) ** 2 - getattr(b, name) ** 2 for a, b in ((ours, without), (kalman, plain)))
        if name == "q_std":
            assert np.allclose(added, expected, rtol=1e-6, atol=1e-14)
        else:  # the tool moves with the links by the Jacobian at the estimate, which is another one
            assert np.allclose(added, expected, rtol=1e-2, atol=1e-12)
        assert (added > 0).any()


@pytest.mark.parametrize("method", [ParticleFilter, MarginalizedParticleFilter])
def test_a_wrong_model_is_within_its_standard_deviations(method):
    """Springs, masses and payload are not robot.yaml's: what is off by more than three deviations is not good."""
    robot, log = recording("arm2_square_mismatch")
    truth = Estimate.read(DATA / "arm2_square_mismatch/truth.parquet")[:1500]
    estimate = method(robot, particles=300).run(log[:1500])
    off = (np.abs(estimate.q - truth.q) > 3 * estimate.q_std).any(axis=1)
    assert (off & (estimate.status == Status.GOOD)).mean() < 0.02
    assert estimate.reseeded.mean() < 0.1


def test_with_outliers_few_particles_stay_beside_the_kalman_filter():
    """500 of them; without leaning on it they were off by 5 to 16 mm by chance."""
    robot, log = recording()
    log, truth = log[:1500], Estimate.read(DATA / "arm2_square/truth.parquet")[:1500]
    kalman = ExtendedKalmanFilter(robot).run(log).error_against(truth).tool_rms_centred
    for seed in range(2):
        method = ParticleFilter(robot, particles=500, seed=seed, outliers={"acceleration": 4.0})
        assert method.run(log).error_against(truth).tool_rms_centred < 1.5 * kalman


def test_marginalising_biases_makes_the_likelihood_less_random():
    plain = errors(ParticleFilter, 200, 20, kernel=None)
    closed = errors(MarginalizedParticleFilter, 200, 20, kernel=None)
    assert closed[2] < 0.7 * plain[2]


@pytest.mark.parametrize("resampling", ["systematic", "stratified", "residual", "multinomial"])
def test_every_way_of_resampling_finds_the_same(resampling):
    assert errors(MarginalizedParticleFilter, 2000, 3, kernel=None, resampling=resampling)[0] < 0.3


def tool_error(name, method=MarginalizedParticleFilter, **settings):
    robot, log = recording(name)
    estimate = method(robot, particles=500, **settings).run(log)
    return estimate.error_against(DATA / name / "truth.parquet").tool_rms_centred


def test_tool_error_on_recordings():
    for name in ("arm2_square", "arm2_square_mismatch"):
        assert tool_error(name, seed=1) < 1.2 * kalman_error(name)


def kalman_error(name):
    robot, log = recording(name)
    return ExtendedKalmanFilter(robot).run(log).error_against(DATA / name / "truth.parquet").tool_rms_centred


@pytest.mark.slow
@pytest.mark.parametrize("method", [ParticleFilter, MarginalizedParticleFilter])
@pytest.mark.parametrize("name", ["arm2_square", "arm2_square_mismatch", "kr15_six_axes"])
def test_never_worse_than_the_kalman_filter_by_more_than_a_fifth(name, method):
    for seed in range(20):
        assert tool_error(name, method, seed=seed) < 1.2 * kalman_error(name), seed


def spoiled(log, column=0, share=0.02, size=50, std=0.05):
    """Outliers of 50 σ in one axis."""
    rng = np.random.default_rng(5)
    acceleration = log.acceleration.copy()
    hit = rng.random(len(log)) < share
    acceleration[hit, column] += size * std * rng.choice([-1, 1], hit.sum())
    return replace(log, acceleration=acceleration)


@pytest.mark.slow
@pytest.mark.parametrize("outliers", [4.0, Mixture(share=0.02, scale=50.0)])
def test_noise_that_expects_outliers_withstands_them(outliers):
    """A cloud of 500, alone, is off by 5 to 10 mm by chance; one misled by the outliers by 36 mm, whatever the seed."""
    robot, log = recording()
    truth = Estimate.read(DATA / "arm2_square/truth.parquet")[:2000]

    def error(log, seeds, **settings):
        method = partial(ParticleFilter, robot, particles=500, kernel=1.0, collapse="flag", **settings)
        run = [method(seed=seed).run(log).error_against(truth).tool_rms_centred for seed in range(seeds)]
        return np.median(run)

    expecting = {"outliers": {"acceleration": outliers}}
    clean, misled = error(log[:2000], 7, **expecting), error(spoiled(log)[:2000], 1)
    robust = error(spoiled(log)[:2000], 7, **expecting)
    assert robust < 2 * clean, (clean, robust)
    assert robust < misled / 2, (misled, robust)


@pytest.mark.parametrize("outliers", [4.0, Mixture(share=0.1, scale=20.0)])
def test_densities_are_scipys(outliers):
    robot, log = slide()
    acceleration = log.acceleration.copy()
    acceleration[5::7] += 9.0
    log = replace(log, acceleration=acceleration)
    settings = {"particles": 1, "proposal": "bootstrap", "biases": (), "collapse": "flag"}  # one path, in any case
    normal = ParticleFilter(robot, LINEAR, **settings).run(log)
    ours = ParticleFilter(robot, LINEAR, outliers={"acceleration": outliers}, **settings).run(log)
    assert (ours.q == normal.q).all()
    error, std = log.acceleration[:, 0] - normal.ddq[:, 0], 0.3
    density = stats.norm.pdf(error, scale=std)
    if isinstance(outliers, Mixture):
        wide = stats.norm.pdf(error, scale=outliers.scale * std)
        expected = (1 - outliers.share) * density + outliers.share * wide
    else:
        expected = stats.t.pdf(error, outliers, scale=std)
    difference = np.log(expected) - stats.norm.logpdf(error, scale=std)
    assert np.allclose(ours.log_likelihood - normal.log_likelihood, difference, rtol=1e-10, atol=1e-9)


def test_a_belief_of_two_peaks_is_resolved():
    robot, log = recording()
    start = ExtendedKalmanFilter(robot).run(log[:1]).q[0]
    starts = [start + 0.02, start]
    estimate = ParticleFilter(robot, particles=2000, initial=starts, kernel=None).run(log[:200])
    assert np.abs(estimate.q[-1] - ExtendedKalmanFilter(robot).run(log[:200]).q[-1]).max() < 1e-4


def test_quantiles_enclose_the_mean():
    robot, log = recording()
    free = MarginalizedParticleFilter(robot, particles=300, quantiles=(0.05, 0.95)).run(log[:300])
    low, up = free.quantiles[:, 0], free.quantiles[:, 1]
    assert ((low <= free.q + 1e-6) & (free.q <= up + 1e-6)).mean() > 0.99


@pytest.mark.parametrize(
    ("method", "settings"),
    [
        (ParticleFilter, {}),
        (MarginalizedParticleFilter, {}),
        (MarginalizedParticleFilter, {"accelerations": True}),
    ],
)
def test_steps_and_pieces_are_the_run(method, settings):
    robot, log = recording()
    log, noise = log[:60], Noise(jerk=15.0, position_walk=1e-6, velocity_walk=1e-4)
    settings = {"particles": 40, "seed": 3, **settings}
    for start in ("auto", "rest"):
        whole = method(robot, noise, start=start, **settings).run(log)
        pieces = list(method(robot, noise, start=start, **settings).run_pieces([log[:17], log[17:]]))
        assert (np.concatenate([p.q for p in pieces]) == whole.q).all()
    live = method(robot, noise, start="rest", **settings)
    for i in range(len(log)):
        dt = log.t[i] - log.t[i - 1] if i else log.period
        ddqref = None if log.ddqref is None else log.ddqref[i]
        signals = {"acceleration": log.acceleration[i], "dtheta": log.dtheta[i], "ddqref": ddqref}
        state = live.step(dt=dt, theta=log.theta[i], **signals)
        for name in ("q", "dq", "theta", "q_std", "tool_position", "tool_std", "effective", "log_likelihood"):
            assert np.array_equal(getattr(state, name), getattr(whole, name)[i]), name
    assert live.covariance.shape == (len(state.state), len(state.state))
    assert live.status == Status.GOOD
    live.reset()
    assert np.allclose(live.step(dt=1e-3, theta=log.theta[0]).q, whole.q[0], atol=1e-3)


SCRIPT = """
from linkside import Log, MarginalizedParticleFilter, Noise, Robot
robot = Robot.load("tests/data/arm2_square/robot.yaml")
log = Log.read("tests/data/arm2_square/log.parquet", robot)
wandering = Noise(position_walk=1e-6, velocity_walk=1e-4)
for noise, accelerations in ((None, False), (wandering, True)):
    method = MarginalizedParticleFilter(robot, noise, particles=2500, seed=2, accelerations=accelerations)
    estimate = method.run(log[:50], covariance=True)
    print(estimate.state.tobytes().hex()[-4000:], estimate.covariance.sum().hex())
"""


def test_processors_and_threads_do_not_change_a_bit():
    root = DATA.parents[1]
    choices = [("baseline", "1"), ("avx2", "2"), ("widest", "2")]
    environments = [{"LINKSIDE_SIMD": level, "RAYON_NUM_THREADS": threads} for level, threads in choices]
    assert len(outputs(SCRIPT, environments, cwd=root)) == 1


def test_a_sample_that_no_particle_explains():
    """The arm starts beyond what are said to be its limits, where no particle may be."""
    robot, log = recording()
    settings = {"particles": 50, "limits": {robot.names[1]: (1.0, 2.0)}, "start": "rest"}
    with pytest.raises(NumericalError, match=r"no particle .* sample 0"):
        ParticleFilter(robot, Noise(jerk=15.0), collapse="raise", **settings).run(log[:20])
    for collapse in ("flag", "reseed"):
        estimate = MarginalizedParticleFilter(robot, Noise(jerk=15.0), collapse=collapse, **settings).run(log[:20])
        assert (estimate.status & Status.PREDICTED).all()
        assert (estimate.status & Status.CONTRADICTED).all()
        assert np.isfinite(estimate.q).all()


def wrapped(theta, acceleration):
    theta[300:, 0] += 2 * np.pi


def sentinel(theta, acceleration):
    acceleration[300:303, 0] = -999.0


def shaft(theta, acceleration):
    theta[:, 0] *= 160


def huge(theta, acceleration):
    acceleration[300, 0] = 1e30


@pytest.mark.parametrize("method", [ParticleFilter, MarginalizedParticleFilter])
@pytest.mark.parametrize("collapse", ["reseed", "flag", "raise"])
@pytest.mark.parametrize("spoil", [wrapped, sentinel, shaft, huge])
def test_what_no_particle_explains_is_an_error_or_flagged(spoil, collapse, method):
    """Wrong rows are not good: neither those where the fault is nor those that it leads astray."""
    robot, log = recording()
    theta, acceleration = log.theta[:400].copy(), log.acceleration[:400].copy()
    spoil(theta, acceleration)
    truth = Estimate.read(DATA / "arm2_square/truth.parquet")[:400]
    try:
        estimate = method(robot, particles=100, collapse=collapse).run(
            replace(log[:400], theta=theta, acceleration=acceleration)
        )
    except NumericalError:
        return
    wrong = (np.abs(estimate.q - truth.q) > 1e-3).any(axis=1)
    flagged = (estimate.status & Status.CONTRADICTED) > 0
    assert flagged.any()
    assert flagged[wrong].mean() > 0.98 if wrong.any() else True
    narrow = ~(estimate.q_std > 0).all(axis=1)
    assert flagged[narrow].all()
    assert collapse == "flag" or not narrow.any()


@pytest.mark.parametrize("method", [ParticleFilter, MarginalizedParticleFilter])
def test_a_cloud_that_has_collapsed_is_flagged_or_spread_anew(method):
    """Twenty particles without moves lose their spread in a second; the demo's robot has forty states."""
    robot, log = recording("arm2_square_mismatch")
    log = log[:1500]
    settings = {"particles": 20, "kernel": None, "tolerances": False}
    kalman = ExtendedKalmanFilter(robot, tolerances=False).run(log)
    alone = method(robot, collapse="flag", **settings).run(log)
    narrow = (alone.q_std < 0.05 * kalman.q_std).any(axis=1)
    assert narrow.any()
    assert (alone.status[narrow] & Status.CONTRADICTED).all()
    guarded = method(robot, collapse="reseed", **settings).run(log)
    assert guarded.reseeded.any()
    assert not (guarded.q_std < 0.05 * kalman.q_std).any()


def test_smoothed_covariances_are_some_after_a_dropout():
    """Two hundred rows without a reading: P grows by a factor that leaves a difference no digits."""
    robot, log = recording()
    theta, acceleration = log.theta[:400].copy(), log.acceleration[:400].copy()
    theta[100:300], acceleration[100:300] = np.nan, np.nan
    gap = replace(log[:400], theta=theta, acceleration=acceleration)
    ours = MarginalizedParticleFilter(robot, particles=300).smooth(gap, covariance=True)
    scale = np.sqrt(np.einsum("tii->ti", ours.covariance))
    assert (scale > 0).all()
    correlation = ours.covariance / scale[:, :, None] / scale[:, None, :]
    assert np.linalg.eigvalsh(correlation).min() > -1e-9
    assert (ours.q_std > 1e-8).all()


def test_particles_out_of_the_numbers_lose_their_weight_and_no_more():
    robot, log = recording()
    start = ExtendedKalmanFilter(robot).run(log[:1]).q[0]
    lost = [start, [1e200, 0.0]]
    estimate = ParticleFilter(robot, particles=200, initial=lost).run(log[:50], covariance=True)
    assert np.isfinite(estimate.covariance).all()
    assert np.abs(estimate.q - ExtendedKalmanFilter(robot).run(log[:50]).q).max() < 1e-3


def test_one_particle_is_enough_to_run():
    robot, log = recording()
    assert np.isfinite(ParticleFilter(robot, particles=1).run(log[:50]).q).all()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"particles": 0}, "particles"),
        ({"particles": 10_000_000}, "particles"),
        ({"particles": 1.5}, "whole number"),
        ({"proposal": "magic"}, "proposal"),
        ({"resampling": "magic"}, "resampling"),
        ({"threshold": 2}, "threshold"),
        ({"collapse": "magic"}, "collapse"),
        ({"outliers": {"magic": 4}}, "magic"),
        ({"outliers": {"acceleration": 0.5}}, "degree of freedom"),
        ({"outliers": {"acceleration": Mixture(share=1.5, scale=50)}}, "share between 0 and 1"),
        ({"outliers": {"acceleration": Mixture(share=0.1, scale=0.5)}}, "scale above 1"),
        ({"limits": {"magic": (0, 1)}}, "magic"),
        ({"limits": {"axis2": (1, 0)}}, "limits"),
        ({"initial": [[1.0]]}, "initial"),
        ({"quantiles": (0.0,)}, "quantiles"),
    ],
)
def test_bad_settings_are_named(settings, message):
    with pytest.raises(EstimatorError, match=message):
        ParticleFilter(recording()[0], **settings)


def test_outliers_are_not_for_marginalised_biases():
    with pytest.raises(EstimatorError, match="outliers"):
        MarginalizedParticleFilter(recording()[0], outliers={"acceleration": 4})


def test_command_line(tmp_path):
    from linkside.cli import main

    for method in ("particle", "marginalized"):
        out = tmp_path / f"{method}.parquet"
        folder = DATA / "arm2_square"
        arguments = ["estimate", str(folder / "robot.yaml"), str(folder / "log.parquet"), "--with", method]
        with pytest.raises(SystemExit) as end:
            main([*arguments, "--particles", "100", "--seed", "1", "--out", str(out)])
        assert end.value.code == 0
        assert len(Estimate.read(out)) == 3960
