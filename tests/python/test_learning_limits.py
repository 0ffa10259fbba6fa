"""Learning within limits: the program's optimum, what it knows of torques, and repeats that keep their limits."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls

from linkside import Estimate, EstimatorError, RauchTungStriebelSmoother, Robot, simulate
from linkside.cli import main
from linkside.control.controllers import JointPD
from linkside.control.trajectories import rest_to_rest
from linkside.learning import Belief, Limits, Margin, Motion, PathLearning, read, wanted_motion, write
from linkside.learning.belief import Seen
from linkside.learning.blocks import BlockProgram
from linkside.learning.loop import Loop
from linkside.learning.signals import Bounds, Signals

from .robots import DATA

SQUARE = Robot.load(DATA / "arm2_square/robot.yaml")
PERIOD = 1e-3
NONE = np.full(2, np.inf)
FREE = Limits(np.array([-NONE, NONE]), NONE, NONE, NONE)


def gains(q, bandwidth=30.0):
    inertia = np.diag(SQUARE.mass_matrix(q)) + [drive.motor_inertia or 0.0 for drive in SQUARE.drives]
    return bandwidth**2 * inertia, 1.4 * bandwidth * inertia


def moved(duration=0.4, reach=0.3):
    path = rest_to_rest([[0.3, -0.8], [0.3 + reach, -0.8 + reach], [0.3, -0.8]], duration, PERIOD, degree=7)
    path = path.held(0.1, 0.2)
    return Motion(path.t, path.q, path.dq, path.ddq)


def begun(motion, bandwidth=30.0, **settings):
    """Learning up to 20 Hz, whose margin is not looked for again in each test."""
    margin = Margin(0.5, 0.7, 1.0, 1.0)
    return PathLearning(SQUARE, motion, *gains(motion.q[0], bandwidth), bandwidth=20.0, margin=margin, **settings)


def still(count):
    q = np.tile([0.3, -0.8], (count, 1))
    return Motion(np.arange(count) * PERIOD, q, 0 * q, 0 * q)


def told(q, t):
    return Estimate(t, q, np.zeros_like(q), q, np.zeros_like(q), np.zeros(len(q), np.uint8), SQUARE.names)


def repeat(learning, seed=0, robot=SQUARE):
    motion = learning.motion
    reference, hold = motion.q + learning.correction, SQUARE.gravity_torque(motion.q[0])
    control = JointPD(learning.kp, learning.kd, motion.t, reference, tau=hold)
    rate = 1 / motion.period
    return simulate(robot, control, duration=motion.t[-1], rate=rate, q=motion.q[0], substeps=4, seed=seed)


@given(st.integers(3, 8), st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_the_program_s_solution_fulfils_the_conditions_of_karush_kuhn_and_tucker(blocks, seed):
    """Gradient and constraints by every sample of the loop's own response; SciPy finds the multipliers."""
    rng = np.random.default_rng(seed)
    bandwidth, rate = 25.0, 0.5
    count = blocks * int(1 / (10 * bandwidth * PERIOD))
    motion = still(count)
    loop = Loop(SQUARE, motion, *gains(motion.q[0]))
    weight = rng.uniform(0.1, 1.0, (count, 2))
    cost = (2 * np.pi * bandwidth) ** -4.0 / rate
    program = BlockProgram(loop, weight, cost, bandwidth)
    signals = Signals(SQUARE, loop, motion, FREE)
    inputs = np.eye(2 * blocks).reshape(2 * blocks, blocks, 2)
    held = [program.constant(w, count) for w in inputs]
    ends = np.stack([signals.deviation(v)[program.first] for v in held], axis=-1)  # (N, 4, 2, inputs)
    links = np.stack([loop.core.answer(np.ascontiguousarray(v)) for v in held], axis=-1)
    size = np.abs(ends).max(axis=(0, 3)) * 10
    aim = np.einsum("nkjw,w->nkj", ends, rng.standard_normal(2 * blocks) * 10)
    low, high = aim - size * rng.uniform(0, 0.3, aim.shape), aim + size * rng.uniform(0, 0.3, aim.shape)
    low[0, [0, 1, 3]], high[0, [0, 1, 3]] = -np.inf, np.inf
    free = rng.random(aim.shape) < 0.5
    low[free], high[free] = -np.inf, np.inf

    w = program.solve(low, high, float(np.abs(aim[:, 0]).max()))
    assert w is not None  # the aim is within
    found = np.einsum("nkjw,w->nkj", ends, w.ravel())
    assert (found < high + 1e-5 * size).all()
    assert (found > low - 1e-5 * size).all()
    gradient = cost * program.size * w.ravel() + np.einsum("tjw,tj,tj->w", links, weight, links @ w.ravel())
    normals = [
        sign * ends[at] / size[at[1:]]
        for sign, bound in ((1, high), (-1, low))
        for at in map(tuple, np.argwhere(np.abs(found - bound) < 1e-4 * size))
    ]
    scale = np.abs(gradient).max()
    if scale > 1e-6 * cost * program.size * 10:
        _, rest = nnls(np.array(normals).T, -gradient / scale, maxiter=10_000)
        assert rest < 1e-3


def test_torques_deviate_as_in_the_simulator():
    motion = moved()
    learning = begun(motion)
    rng = np.random.default_rng(0)
    wave = np.sin(2 * np.pi * np.outer(motion.t, [5.0, 11.0]) + rng.uniform(0, 6, 2))
    curvature = 2.0 * wave * np.sin(np.pi * motion.t / motion.t[-1])[:, None] ** 2
    signals = Signals(SQUARE, Loop(SQUARE, motion, learning.kp, learning.kd), motion, FREE)
    plus, minus = (repeat(learning.resumed(sign * curvature, ())).log.tau for sign in (1, -1))
    deviation = signals.deviation(curvature)
    torque = (plus - minus) / 2
    assert np.abs(torque - deviation[:, 3]).max() < 0.03 * np.abs(torque).max()
    np.testing.assert_allclose(deviation[:, 0], learning.resumed(curvature, ()).correction)
    np.testing.assert_allclose(
        np.diff(deviation[:, 0], axis=0) / PERIOD, deviation[:-1, 1] + PERIOD / 2 * curvature[:-1]
    )


@pytest.mark.parametrize("wrong", [False, True])
def test_repeats_come_within_a_torque_s_limit_and_near_their_path(wrong):
    robot = SQUARE.scaled(stiffness=0.92, damping=1.4, mass=1.05) if wrong else SQUARE
    motion = moved()
    free = begun(motion)
    for seed in range(3):
        run = repeat(free, seed, robot)
        free.learn(told(run.truth["q"], run.log.t))
    needed = np.abs(run.log.tau).max(axis=0)
    limits = replace(FREE, torque=0.93 * needed)
    learning = begun(motion, limits=limits)
    errors, peaks = [], []
    for seed in range(5):
        run = repeat(learning, seed, robot)
        trial = learning.learn(told(run.truth["q"], run.log.t), run.log)
        errors.append(trial.rms)
        peaks.append(np.abs(run.log.tau).max(axis=0))
    assert "torque of axis2" in trial.held
    assert (peaks[-1] < 1.005 * limits.torque).all(), (peaks, limits.torque)
    assert (peaks[-1] > 0.97 * limits.torque).any()  # it is used
    assert (np.array(errors[-1]) < 0.05 * np.array(errors[0])).all(), errors


def test_a_reference_keeps_its_limits_of_position_velocity_and_acceleration():
    motion = moved()
    soft = 8.0  # motors lag, and a reference that makes up for it moves more
    free = begun(motion, soft)
    run = repeat(free)
    free.learn(told(run.truth["q"], run.log.t))

    def signals(learning):
        reference = motion.q + learning.correction
        velocity, acceleration = np.gradient(reference, PERIOD, axis=0), motion.ddq + learning.curvature
        return -reference, np.abs(velocity), np.abs(acceleration)

    wanted, needed = ([s.max(axis=0) for s in signals(one)] for one in (begun(motion, soft), free))
    for kind in range(3):
        most = [NONE, NONE, NONE]
        most[kind] = np.where(needed[kind] > wanted[kind], (wanted[kind] + needed[kind]) / 2, np.inf)
        limits = Limits(np.array([-most[0], NONE]), most[1], most[2], NONE)
        learning = begun(motion, soft, limits=limits)
        assert learning.learn(told(run.truth["q"], run.log.t)).held
        assert all((signal <= limit).all() for signal, limit in zip(signals(learning), most, strict=True))
        assert np.abs(learning.correction).max() > 0.2 * np.abs(free.correction).max()


@given(st.integers(0, 2**32 - 1), st.integers(1, 30))
@settings(max_examples=60, deadline=None)
def test_the_share_of_a_step_stays_within_what_is_reachable(seed, count):
    rng = np.random.default_rng(seed)
    velocity, acceleration, torque = rng.uniform(0.5, 2, (3, 2))
    limits = Limits(np.array([[-1.0, -np.inf], [np.inf, 0.7]]), velocity, acceleration, torque)
    last = rng.uniform(-1.5, 1.5, (count, 4, 2))
    bounds = Bounds.of(limits, last).reachable()
    step = rng.standard_normal((count, 4, 2)) * 10.0 ** rng.integers(-6, 3)
    share = bounds.share(step)
    assert 0 < share <= 1
    assert not bounds.passed(0.999 * share * step).any()
    low, high = (
        np.stack([at, *(sign * x for x in (velocity, acceleration, torque))])
        for at, sign in zip(limits.position, (-1, 1), strict=True)
    )
    after = last + 0.999 * share * step
    slack = bounds.close + 1e-12
    assert (after <= np.maximum(high, last + slack)).all()
    assert (after >= np.minimum(low, last - slack)).all()


@given(st.lists(st.tuples(st.floats(-1, 1), st.floats(1e-3, 1), st.booleans()), min_size=1, max_size=8))
@settings(max_examples=60, deadline=None)
def test_what_is_believed_of_an_error_is_the_mean_by_precision(readings):
    belief, precision, total = Belief(np.zeros((1, 1)), np.full((1, 1), np.inf)), 0.0, 0.0
    for error, std, known in readings:
        seen = Seen(np.full((1, 1), error * known), np.full((1, 1), std * known), np.full((1, 1), known), None)
        belief = belief.told(seen)
        precision, total = precision + known / std**2, total + known * error / std**2
    if precision == 0:
        assert np.isinf(belief.variance)
        assert belief.weight(np.ones(1)) == 0
    else:
        assert belief.variance == pytest.approx(1 / precision)
        assert belief.error == pytest.approx(total / precision, abs=1e-9)
        later = belief.after(np.full((1, 1), 0.5))
        assert later.error == pytest.approx(total / precision - 0.5, abs=1e-9)
        assert later.variance == pytest.approx(1 / precision + 0.25)


def test_a_row_that_one_repeat_lacks_is_known_by_the_repeat_before():
    motion = moved()
    complete, gappy = begun(motion), begun(motion)
    for seed in range(2):
        for learning in (complete, gappy):
            run = repeat(learning, seed)
            estimate = told(run.truth["q"], run.log.t)
            if learning is gappy and seed == 1:
                q, status = estimate.q.copy(), estimate.status.copy()
                q[200:260], status[200:260] = np.nan, 64
                estimate = replace(estimate, q=q, status=status)
            learning.learn(estimate)
    assert np.abs(gappy.correction - complete.correction).max() < 0.02 * np.abs(complete.correction).max()


def test_what_limits_cannot_be_is_refused(monkeypatch):
    motion = moved()
    fast, heavy = np.abs(motion.dq).max(axis=0), np.abs(SQUARE.gravity_torque(motion.q)).max(axis=0)
    for message, changed in {
        "motion: velocity of axis3 is .* at .* s, beyond its limit of": {"velocity": fast * [2.0, 0.9]},
        "motion: position of axis2 is .*, beyond its limit of 0.4": {"position": np.array([[-9.0, -9], [0.4, 9]])},
        "motion: torque against gravity of axis2 is .*, beyond its limit of": {"torque": heavy * [0.9, 2.0]},
    }.items():
        with pytest.raises(EstimatorError, match=message):
            begun(motion, limits=replace(FREE, **changed))
    learning = begun(motion, limits=replace(FREE, torque=9 * heavy))
    run = repeat(learning)
    with pytest.raises(EstimatorError, match="the recording of the repeat is needed"):
        learning.learn(told(run.truth["q"], run.log.t))
    with pytest.raises(EstimatorError, match="a motor torque of the recording is missing"):
        learning.learn(told(run.truth["q"], run.log.t), replace(run.log, tau=np.full_like(run.log.tau, np.nan)))
    assert learning.trials == ()
    monkeypatch.setitem(sys.modules, "clarabel", None)
    with pytest.raises(EstimatorError, match=r"pip install 'linkside\[learning\]'"):
        begun(motion, limits=FREE)


def test_the_command_line_keeps_limits(tmp_path):
    folder = DATA / "arm2_square"
    motion = wanted_motion(folder / "log.parquet", SQUARE)
    kp, kd = (",".join(f"{gain:.1f}" for gain in of) for of in gains(motion.q[0]))
    state, robot, log = (
        str(path) for path in (tmp_path / "state.parquet", folder / "robot.yaml", folder / "log.parquet")
    )
    runner = CliRunner()
    args = [
        "learn",
        "start",
        robot,
        log,
        "--kp",
        kp,
        "--kd",
        kd,
        "--torque",
        "3500",
        "--velocity",
        "axis3=4",
        "--out",
        state,
    ]
    begun = runner.invoke(main, args)
    assert begun.exit_code == 0, begun.output
    learning = read(state, SQUARE)
    assert learning.limits.torque.tolist() == [3500.0, 3500.0]
    assert learning.limits.velocity[1] == 4.0
    write(learning, tmp_path / "again.parquet")
    assert vars(read(tmp_path / "again.parquet", SQUARE).limits).keys() == vars(learning.limits).keys()
    run = repeat(learning)
    run.write(tmp_path)
    RauchTungStriebelSmoother(SQUARE).run(run.log).write(tmp_path / "estimate.parquet")
    args = ["learn", "next", robot, state, str(tmp_path / "estimate.parquet"), "--out", state]
    missing = runner.invoke(main, args)
    assert missing.exit_code == 2
    assert "recording of the repeat is needed" in missing.stderr
    done = runner.invoke(main, [*args, "--log", str(tmp_path / "log.parquet")])
    assert done.exit_code == 0, done.output
    assert len(read(state, SQUARE).trials) == 1
