"""Learning from repeat to repeat: the step, its convergence, and robots that get better by their estimates alone."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from linkside import (
    Estimate,
    EstimatorError,
    ExtendedKalmanFilter,
    LogError,
    RauchTungStriebelSmoother,
    Robot,
    _core,
    simulate,
)
from linkside.cli import main
from linkside.control.controllers import JointPD
from linkside.control.trajectories import rest_to_rest
from linkside.learning import Motion, PathLearning, read, wanted_motion, write

from .robots import ARM, DATA, spring

SQUARE = Robot.load(DATA / "arm2_square/robot.yaml")
PERIOD = 1e-3


def gains(robot, q):
    """Motors that follow at 30 rad/s, well damped."""
    inertia = np.diag(robot.mass_matrix(q)) + [drive.motor_inertia or 0.0 for drive in robot.drives]
    return 900 * inertia, 42 * inertia


def there_and_back(robot, reach=0.4, duration=0.3, pause=0.1):
    start = np.full(robot.n, 0.3)
    path = rest_to_rest([start, start + reach, start], duration, PERIOD, degree=7).held(pause, pause)
    return Motion(path.t, path.q, path.dq, path.ddq)


def repeat(robot, motion, correction, seed=0):
    """One repeat by a robot whose motors are told the motion and what was learnt."""
    kp, kd = gains(SQUARE if robot.n == 2 and robot.tool else robot, motion.q[0])
    control = JointPD(kp=kp, kd=kd, times=motion.t, theta=motion.q + correction, tau=robot.gravity_torque(motion.q[0]))
    rate = 1 / motion.period
    return simulate(robot, control, duration=motion.t[-1], rate=rate, q=motion.q[0], substeps=4, seed=seed)


def told(q, t, names):
    """Positions as an estimate."""
    return Estimate(t, q, np.zeros_like(q), q, np.zeros_like(q), np.zeros(len(q), np.uint8), names)


def random_loop(rng, count, n, s, postures):
    """A stable model of few samples, and its lifted matrix, a column for each input."""
    a = rng.standard_normal((postures, s, s))
    a *= 0.9 / np.abs(np.linalg.eigvals(a)).max(axis=1)[:, None, None]
    posture = rng.integers(0, postures, count)
    b, c = rng.standard_normal((s, n)), rng.standard_normal((n, s))
    lifted = np.zeros((count, n, count, n))
    for i in range(count):
        x = b
        for k in range(i + 1, count):
            lifted[k, :, i] = c @ x
            x = a[posture[k]] @ x
    return _core.LearningLoop(a, posture.tolist(), b, c), lifted.reshape(count * n, count * n)


@given(st.integers(2, 30), st.integers(1, 3), st.integers(1, 7), st.integers(1, 4), st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_the_step_is_that_of_the_lifted_matrices(count, n, s, postures, seed):
    rng = np.random.default_rng(seed)
    loop, g = random_loop(rng, count, n, s, postures)
    e, v = rng.standard_normal((2, count, n))
    np.testing.assert_allclose(loop.answer(v).ravel(), g @ v.ravel(), atol=1e-9 * np.abs(g).max())
    np.testing.assert_allclose(loop.adjoint(e).ravel(), g.T @ e.ravel(), atol=1e-9 * np.abs(g).max())

    weight = rng.uniform(0.1, 2, (count, n)) * (rng.random((count, n)) > 0.2)
    rough, change = rng.uniform(0.05, 1, (2, n))
    step = _core.LearningStep(loop, weight, rough.tolist(), change.tolist())
    w, rho, both = np.diag(weight.ravel()), np.tile(rough, count), np.tile(rough + change, count)
    h = g.T @ w @ g
    # Gunnarsson and Norrlöf (2001): u₊ = (GᵀWG + W_u + λ)⁻¹ ((GᵀWG + λ) u + GᵀW e).
    expected = np.linalg.solve(h + np.diag(both), (h + np.diag(both - rho)) @ v.ravel() + g.T @ w @ e.ravel())
    found = v + step.solve(e, -rough / (rough + change) * v)
    np.testing.assert_allclose(found.ravel(), expected, atol=1e-8 * np.abs(expected).max())

    other, g0 = random_loop(rng, count, n, s, postures)
    m = np.linalg.solve(h + np.diag(both), np.diag(both - rho) + g.T @ w @ (g - g0))
    norm = np.linalg.norm(np.sqrt(both)[:, None] * m / np.sqrt(both), 2)
    factor = step.contraction(other, rng.standard_normal(count * n))
    assert 0.999 * norm < factor < 1.001 * norm


def test_the_links_answer_as_the_simulator_says():
    robot = Robot.from_urdf(ARM, joints=[spring("shoulder"), spring("elbow", stiffness=6e3)])
    motion = there_and_back(robot)
    learning = PathLearning(robot, motion, *gains(robot, motion.q[0]))
    rng = np.random.default_rng(0)
    wave = np.sin(2 * np.pi * np.outer(motion.t, [5.0, 11.0]) + rng.uniform(0, 6, 2))
    curvature = 0.05 * wave * np.sin(np.pi * motion.t / motion.t[-1])[:, None] ** 2
    learning.resumed(curvature, ())
    plus, minus = (repeat(robot, motion, sign * learning.correction).truth["q"] for sign in (1, -1))
    measured = (plus - minus) / 2
    assert np.abs(measured - learning.answer(curvature)).max() < 0.03 * np.abs(measured).max()


@pytest.mark.parametrize("specimen", ["known", "wrong"])
def test_a_robot_comes_to_its_path_by_estimates_alone(specimen):
    """The wrong one: springs 8 % softer, damping 40 % more, links 5 % heavier, none of it in robot.yaml."""
    robot = SQUARE if specimen == "known" else SQUARE.scaled(stiffness=0.92, damping=1.4, mass=1.05)
    path = rest_to_rest([[0.3, -0.8], [0.6, -0.5], [0.3, -0.8]], 0.4, PERIOD, degree=7).held(0.1, 0.2)
    motion = Motion(path.t, path.q, path.dq, path.ddq)
    wanted = robot.tool_position(motion.q)
    errors = {}
    for method in ("smoother", "filter", "motors", "links"):
        learning = PathLearning(SQUARE, motion, *gains(SQUARE, motion.q[0]))
        assert learning.margin.monotone
        assert learning.margin.contraction < 0.51
        errors[method] = []
        for number in range(5):
            run = repeat(robot, motion, learning.correction, seed=number)
            errors[method].append(np.sqrt(np.mean(np.sum((run.truth["tool"] - wanted) ** 2, axis=1))))
            if method in ("motors", "links"):
                q = run.log.theta if method == "motors" else run.truth["q"]
                estimate = told(q, run.log.t, robot.names)
            else:
                estimator = {"smoother": RauchTungStriebelSmoother, "filter": ExtendedKalmanFilter}[method]
                estimate = estimator(SQUARE).run(run.log)
            if learning.learn(estimate).reached:
                break
    most = 0.1 if specimen == "known" else 0.2
    for method in ("smoother", "filter", "links"):
        assert errors[method][-1] < most * errors[method][0], errors
        assert (np.diff(errors[method]) < 0).all(), errors
    assert errors["motors"][-1] > 0.2 * errors["motors"][0], errors  # motors follow, and links are elsewhere
    assert errors["links"][-1] < errors["smoother"][-1]


def test_what_is_expected_of_the_next_repeat_comes():
    motion = there_and_back(SQUARE, reach=0.2)
    learning = PathLearning(SQUARE, motion, *gains(SQUARE, motion.q[0]))
    trials = []
    for seed in range(2):
        run = repeat(SQUARE, motion, learning.correction, seed)
        trials.append(learning.learn(told(run.truth["q"], run.log.t, SQUARE.names)))
    assert [trial.number for trial in learning.trials] == [0, 1]
    first, expected, second = (np.array(x) for x in (trials[0].rms, trials[0].expected, trials[1].rms))
    assert (second < 0.2 * first).all()
    assert (np.abs(second - expected) < 0.05 * first).all()


def test_rows_that_are_not_good_teach_nothing():
    motion = there_and_back(SQUARE)
    kp, kd = gains(SQUARE, motion.q[0])
    run = repeat(SQUARE, motion, np.zeros_like(motion.q))
    clean, spoilt = PathLearning(SQUARE, motion, kp, kd), PathLearning(SQUARE, motion, kp, kd)
    estimate = told(run.truth["q"], run.log.t, SQUARE.names)
    clean.learn(estimate)
    q, status = estimate.q.copy(), estimate.status.copy()
    q[200:260], status[200:260] = 1.0, 64
    trial = spoilt.learn(Estimate(**{**vars(estimate), "q": q, "status": status}))
    assert trial.used == pytest.approx(1 - 60 / len(motion.t))
    assert np.abs(spoilt.correction - clean.correction).max() < 0.3 * np.abs(clean.correction).max()


def test_an_uncertain_row_counts_for_less():
    motion = there_and_back(SQUARE)
    kp, kd = gains(SQUARE, motion.q[0])
    run = repeat(SQUARE, motion, np.zeros_like(motion.q))
    std = np.full_like(motion.q, 1e-5)
    std[300:340] = 0.3
    q = run.truth["q"].copy()
    q[300:340] += 0.15
    fields = vars(told(q, run.log.t, SQUARE.names))
    off = {}
    for name, said in (("weighed", std), ("believed", np.full_like(std, 1e-5))):
        learning = PathLearning(SQUARE, motion, kp, kd)
        learning.learn(Estimate(**{**fields, "q_std": said}))
        truth = PathLearning(SQUARE, motion, kp, kd)
        truth.learn(told(run.truth["q"], run.log.t, SQUARE.names))
        off[name] = np.abs(learning.correction - truth.correction).max()
    assert off["weighed"] < 0.05 * off["believed"]


def test_one_file_holds_the_iteration(tmp_path):
    motion = there_and_back(SQUARE)
    learning = PathLearning(SQUARE, motion, *gains(SQUARE, motion.q[0]), bandwidth=12.0, rate=0.7)
    run = repeat(SQUARE, motion, learning.correction)
    learning.learn(told(run.truth["q"], run.log.t, SQUARE.names))
    write(learning, tmp_path / "state.parquet")
    again = read(tmp_path / "state.parquet", SQUARE)
    assert again.trials == learning.trials
    for name in ("curvature", "correction", "kp", "kd"):
        assert np.array_equal(getattr(again, name), getattr(learning, name))
    run = repeat(SQUARE, motion, learning.correction)
    estimate = told(run.truth["q"], run.log.t, SQUARE.names)
    assert again.learn(estimate) == learning.learn(estimate)
    assert np.array_equal(again.correction, learning.correction)


def test_the_command_line_goes_from_a_recording_to_the_next_command(tmp_path):
    folder = DATA / "arm2_square"
    motion = wanted_motion(folder / "log.parquet", SQUARE)
    kp, kd = (",".join(f"{gain:.1f}" for gain in of) for of in gains(SQUARE, motion.q[0]))
    state, robot = tmp_path / "state.parquet", str(folder / "robot.yaml")
    runner = CliRunner()
    begun = runner.invoke(
        main, ["learn", "start", robot, str(folder / "log.parquet"), "--kp", kp, "--kd", kd, "--out", str(state)]
    )
    assert begun.exit_code == 0, begun.output
    assert "learns up to 20 Hz" in begun.output
    learning = read(state, SQUARE)
    errors = []
    for seed in range(3):
        run = repeat(SQUARE, learning.motion, learning.correction, seed)
        errors.append(np.abs(run.truth["q"] - learning.motion.q).max())
        run.write(tmp_path / "run")
        RauchTungStriebelSmoother(SQUARE).run(run.log).write(tmp_path / "estimate.parquet")
        args = ["learn", "next", robot, str(state), str(tmp_path / "estimate.parquet"), "--out", str(state)]
        done = runner.invoke(main, args)
        assert done.exit_code in (0, 3), done.output
        assert "the next command" in done.output
        learning = read(state, SQUARE)
    assert len(learning.trials) == 3
    assert errors[-1] < 0.1 * errors[0]


def test_what_cannot_be_learnt_is_refused(tmp_path):
    motion = there_and_back(SQUARE)
    kp, kd = gains(SQUARE, motion.q[0])
    for message, changed in {
        "kp is -1": {"kp": -1.0},
        "not stable": {"kd": 1e9},
        "bandwidth is 0": {"bandwidth": 0.0},
        "bandwidth is 600": {"bandwidth": 600.0},
        "rate is 2": {"rate": 2.0},
        "deviations is -1": {"deviations": -1.0},
        "would not converge on a robot of": {"bandwidth": 200.0, "rate": 1.0, "deviations": 3.0},
    }.items():
        with pytest.raises(EstimatorError, match=message):
            PathLearning(SQUARE, motion, **{"kp": kp, "kd": kd, **changed})
    with pytest.raises(EstimatorError, match="evenly spaced"):
        Motion(np.r_[motion.t[:-1], 9.0], motion.q, motion.dq, motion.ddq)
    with pytest.raises(EstimatorError, match="not finite"):
        Motion.through(motion.t, np.where(motion.t[:, None] > 0.3, np.nan, motion.q))
    learning = PathLearning(SQUARE, motion, kp, kd)
    good = told(motion.q, motion.t, SQUARE.names)
    for message, estimate in {
        "the estimate is of a, b": told(motion.q, motion.t, ("a", "b")),
        "has no counterpart": told(motion.q[:50], motion.t[:50], SQUARE.names),
        "no good row": Estimate(**{**vars(good), "status": np.full(len(motion.t), 64, np.uint8)}),
    }.items():
        with pytest.raises(EstimatorError, match=message):
            learning.learn(estimate)
    assert learning.trials == ()
    assert not learning.curvature.any()
    good.write(tmp_path / "estimate.parquet")
    with pytest.raises(LogError, match="no state of learning"):
        read(tmp_path / "estimate.parquet", SQUARE)
    write(learning, tmp_path / "state.parquet")
    other = Robot.from_urdf(ARM, joints=[spring("shoulder"), spring("elbow")])
    with pytest.raises(LogError, match="another robot"):
        read(tmp_path / "state.parquet", other)
    assert json.dumps([t.number for t in learning.trials]) == "[]"
