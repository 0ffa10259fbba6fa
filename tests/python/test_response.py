"""Links' response to their motors: against motions made up beforehand, and against differences."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import scipy.interpolate
import scipy.signal
from hypothesis import given, settings
from hypothesis import strategies as st

from linkside import Log, Noise, Robot
from linkside._core import Response
from linkside.calibration import calibrate
from linkside.calibration.acceptance import filters_gain, objections
from linkside.calibration.band import Band
from linkside.calibration.box import within
from linkside.calibration.lag import Lag
from linkside.calibration.motors import motors, quietest
from linkside.calibration.parameters import by_unit, choose
from linkside.calibration.prepared import recordings
from linkside.calibration.products import products
from linkside.calibration.response import ResponseProblem
from linkside.calibration.search import GAIN, Search

from .robots import build_model, spring
from .test_calibration import DATA, INERTIA, MISMATCH, load, misjudged, one_joint

PERIOD = 1e-3
SENSORS = [{"name": "acc", "link": "link2", "xyz": [0.1, 0.2, -0.1], "rpy": [0.3, 0.1, 0.2], "noise_std": 0.05}]


def tree(seed, rigid=(), **more):
    """A random tree of three joints, the springs far below what would be stiff, and the same for Pinocchio."""
    model = build_model([0, 1, 1], [0, 3, 4], np.random.default_rng(seed))
    joints = [
        spring(name, stiffness=3e3, damping=4.0, cubic_stiffness=2e5, elastic=name not in rigid, **more)
        for name in list(model.names)[1:]
    ]
    tool = {"link": "link2", "xyz": [0.0, 0.1, 0.0]}
    return Robot.from_pinocchio(model, joints, accelerometers=SENSORS, gyroscopes=SENSORS, tool=tool), model


def made_up(robot, model, rows=400):
    """Links along sines, and where motors then are, by Pinocchio's inverse dynamics and the spring's inverse."""
    t = PERIOD * np.arange(rows)
    rate, size = np.array([5.0, 7.0, 9.0]), np.array([0.3, 0.2, 0.4])
    q, dq, ddq = size * np.sin(rate * t[:, None]), size * rate * np.cos(rate * t[:, None]), 0.0
    ddq = -(rate**2) * q
    data = model.createData()
    load = np.array([pin.rnea(model, data, *row) for row in zip(q, dq, ddq, strict=True)])
    torsion = load / 3e3
    for _ in range(50):
        torsion -= (3e3 * torsion + 2e5 * torsion**3 - load) / (3e3 + 6e5 * torsion**2)
    elastic = robot.elastic
    theta = np.where(elastic, q + torsion, q)
    # With damping, D(θ̇ − q̇) is a part of the load: a filter of the torsion, by its exact step.
    return t, q, dq, ddq, theta


def smooth_motion(t, theta):
    spline = scipy.interpolate.CubicSpline(t, theta)
    arrays = {"t": t, "theta": spline(t), "dtheta": spline(t, 1), "ddtheta": spline(t, 2)}
    return {name: np.ascontiguousarray(array) for name, array in arrays.items()}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("rigid", [(), ("joint1",)])
def test_links_move_as_they_were_made_up_to(seed, rigid):
    robot, model = tree(seed, rigid, motor_inertia=0.2, motor_friction={"viscous": 2.0, "coulomb": 1.5})
    t, q, dq, ddq, theta = made_up(robot, model)
    fixed = [(("damping", j, 0), 0.0) for j in range(robot.n)]
    kinds = ["acceleration", "rate", "q", "torque", "dq", "tau"]
    motion = smooth_motion(t, theta)
    response = Response(robot.core, motion, kinds=kinds, fixed=fixed)
    resting, _ = response.evaluate([], [], [0.0] * 6)
    offset = np.concatenate([q[0] - resting[0, 6:9], dq[0] - resting[0, 12:15]]) * np.tile(robot.elastic, 2)
    found, _ = response.evaluate([], [], offset.tolist())
    load = robot.inverse_dynamics(q, dq, ddq)
    v = motion["dtheta"]
    given = load + 0.2 * motion["ddtheta"] + 2.0 * v + 1.5 * v / np.hypot(v, 2e-3)
    truth = np.hstack([robot.specific_force(q, dq, ddq), robot.angular_rate(q, dq), q, load, dq, given])
    assert np.abs(found - truth)[5:-5].max() < 2e-4 * np.abs(truth).max()
    assert np.abs(found - truth)[5:-5, 6:9].max() < 1e-7


FREE = [
    *(("stiffness", j, 0) for j in range(3)),
    *(("cubic_stiffness", 1, 0), ("damping", 2, 0), ("mass_scale", 1, 0), ("coupling", 0, 1)),
    *(("payload_mass", 0, 0), ("payload_xyz", 0, 1), ("translation", 0, 2), ("rotation", 0, 0), ("rotation", 0, 1)),
    *(("bias", 0, 0), ("scale", 0, 1), ("link_friction", 1, 0), ("link_coulomb", 2, 0), ("half_gap", 0, 0)),
    *(("motor_inertia", 0, 0), ("viscous", 1, 0), ("coulomb", 1, 0), ("torque_constant", 2, 0)),
]


def test_derivatives_are_those_of_the_solution():
    law = {
        "link_friction": (0.3, 5.0, 2.0, 0.2, 3.0, 0.5),
        "ripple": [{"amplitude": 2e-3, "order": 3, "phase": 0.2, "of": "output"}],
    }
    play = {"half_gap": 2e-3, "slope": 0.1, "rounding": 2e-3}
    robot, model = tree(5, **law, backlash=play)
    t, *_, theta = made_up(robot, model, rows=60)
    kinds = ["acceleration", "rate", "q", "torque", "dq", "tau"]
    response = Response(robot.core, smooth_motion(t, theta), kinds=kinds, fixed=[])
    values = np.array([3e3, 2.5e3, 3.5e3, 3e5, 5.0, 1.1, 0.02, 0.4, 0.1, 0.02, 0.05, -0.04, 0.1, 1.02, 1.3, 0.4, 3e-3])
    values = np.append(values, [0.3, 2.0, 1.5, 1.1])
    at = np.concatenate([values, 1e-3 * np.arange(6)])

    def evaluate(x):
        return response.evaluate(FREE, x[: len(FREE)].tolist(), x[len(FREE) :].tolist())

    slopes = evaluate(at)[1]
    for i in range(len(at)):
        step = np.zeros(len(at))
        step[i] = 1e-3 * max(abs(at[i]), 1e-2)
        near, far = (evaluate(at + k * step)[0] - evaluate(at - k * step)[0] for k in (1, 2))
        expected = (8 * near - far) / (12 * step[i])
        assert np.abs(slopes[:, :, i] - expected).max() < 1e-6 * np.abs(expected).max() + 1e-12


def test_a_stiff_joint_is_stable_and_follows_its_motor():
    robot, model = tree(1)
    t, *_, theta = made_up(robot, model, rows=300)
    fixed = [(("stiffness", j, 0), 1e12) for j in range(3)]
    found, _ = Response(robot.core, smooth_motion(t, theta), kinds=["q"], fixed=fixed).evaluate([], [], [0.0] * 6)
    assert np.abs(found - theta).max() < 1e-5


@settings(deadline=None, max_examples=20)
@given(st.floats(0.3, 6.0), st.floats(0.0, 5.0))
def test_a_lag_is_that_of_the_sampled_filter(time_constant, delay):
    lag = Lag(time_constant, delay)
    t = np.arange(300.0)
    wave = np.sin(0.05 * t)
    # The steady answer of y = α y₋ + (1 − α) f to a sine that comes T − α/(1 − α) + delay later.
    alpha = np.exp(-1 / time_constant)
    gain = (1 - alpha) / (1 - alpha * np.exp(-0.05j))
    expected = np.imag(gain * np.exp(0.05j * (t - lag.shift)))
    assert np.abs((lag(wave[:, None])[:, 0] - expected)[150:-3]).max() < 1e-5
    by_time, by_delay = lag.slopes(wave[:, None])
    for k, slope in enumerate((by_time, by_delay)):
        step = 1e-5 * np.eye(2)[k]
        near = [Lag(time_constant + s * step[0], delay + s * step[1]) for s in (-1, 1)]
        if len({int(np.floor(x.shift)) for x in near}) == 1:  # else between two cubics
            difference = (near[1](wave[:, None]) - near[0](wave[:, None])) / 2e-5
            assert np.abs(slope - difference)[10:].max() < 1e-6


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1), st.integers(1, 12))
def test_a_step_within_bounds_is_the_best(seed, size):
    """By the conditions of Karush, Kuhn and Tucker; directions count differently by many powers of ten."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((size + 3, size)) * 10 ** rng.uniform(-3, 3, size)
    curvature = root.T @ root + np.eye(size)
    gradient = 3 * rng.standard_normal(size) * np.sqrt(np.diag(curvature))
    low, high = -rng.uniform(0, 1, size) * (rng.random(size) < 0.7), rng.uniform(0.01, 1, size)
    x = within(gradient, curvature, low, high)
    assert np.all((low <= x) & (x <= high))
    slope = (gradient - curvature @ x) / np.sqrt(np.diag(curvature))
    assert np.all(np.where(x == low, slope, np.where(x == high, -slope, np.abs(slope))) < 1e-4)


def test_a_band_keeps_what_is_slow_and_drops_what_is_fast():
    band = Band.below(12.0, 1e-3, 4000)
    t = 1e-3 * np.arange(4000)
    rows = band.rows(4000)
    slow, fast = np.sin(2 * np.pi * 3 * t), np.sin(2 * np.pi * 40 * t)
    assert band(slow) == pytest.approx(slow[rows], abs=0.01)
    assert np.abs(band(fast)).max() < 0.01
    window = np.convolve(fast + slow, band.weights[::-1], mode="valid")
    assert band(fast + slow) == pytest.approx(
        window[rows - rows[0]][::1] if band.every == 1 else window[rows - len(band.weights) // 2]
    )


def test_motors_are_smoothed_by_what_their_encoders_allow():
    robot = one_joint(6000.0, encoder=1e-4)
    rng = np.random.default_rng(3)
    t = PERIOD * np.arange(4000)
    true = 0.5 * np.sin(4 * t)
    log = Log.from_table(
        {"t": t, "theta_j": true + 1e-4 * rng.standard_normal(4000), "a_x": 0 * t, "a_y": 0 * t}, robot, check=False
    )
    found = motors(robot, log, quietest(robot, log))
    inner = slice(200, -200)
    assert np.std((found["theta"][:, 0] - true)[inner]) < 3e-5
    assert np.std((found["dtheta"][:, 0] - 2 * np.cos(4 * t))[inner]) < 0.01


@pytest.mark.parametrize("factor", [1 / 3, 3.0])
def test_from_far_starts_the_same_robot_is_found(factor):
    robot, log = load(MISMATCH)
    found = calibrate(misjudged(robot, factor), log)
    # Of what the recording is of; see docs/calibration.md.
    assert found["stiffness_axis2"].value == pytest.approx(0.92 * 4.5e5 / 1.05, rel=0.01)
    assert found["stiffness_axis3"].value == pytest.approx(0.92 * 3e5 / 1.05, rel=0.01)
    assert not found.accepted  # robot.yaml's tolerance does not allow for it


def test_products_are_those_of_all_columns():
    columns = np.random.default_rng(2).standard_normal((5003, 37))
    np.testing.assert_allclose(products(columns), columns.T @ columns, atol=1e-10)
    np.testing.assert_allclose(products(columns[:5]), columns[:5].T @ columns[:5], atol=1e-12)


def test_few_samples_tell_of_a_low_band_what_all_do():
    """In the band below 5 Hz: residuals to a part of what is left of noise there, and what they say of springs."""
    robot, log = load(MISMATCH)
    free = choose(robot, ["stiffness", "damping", "bias"], False, {})
    prepared = recordings(robot, [log])
    few = ResponseProblem(robot, prepared, free, corner=5.0)
    (coarse,) = few._seen
    assert coarse.every == 10
    assert len(coarse.readings) == len(log) // 10
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("linkside.calibration.prepared.LEAST_RATE", np.inf)
        every = ResponseProblem(robot, prepared, free, corner=5.0)
    assert every._seen[0] is prepared[0]
    z = np.linspace(-1, 1, len(free))
    fits = [Search(problem.settled(z), gain=GAIN).maximise(z) for problem in (few, every)]
    std = 1 / np.sqrt(np.diag(every.settled(fits[1]).evidence(fits[1]).information + np.eye(len(free))))
    assert np.abs((fits[0] - fits[1]) / std).max() < 1.0


def test_a_likelihood_without_derivatives_is_that_with_them():
    robot, log = load(MISMATCH)
    free = choose(robot, ["stiffness", "damping", "bias", "delay", "time_constant"], False, {})
    problem = ResponseProblem(robot, recordings(robot, [log[:900]]), free)
    z = np.linspace(-0.5, 0.5, len(free)) ** 2
    problem = problem.settled(z)
    assert problem.log_likelihood(z) == pytest.approx(problem.evidence(z).log_likelihood, abs=1e-9)


def test_a_motor_alone_tells_nothing_of_a_spring():
    robot, log = load(DATA / "arm2_square")
    silent = replace(log, acceleration=np.where(np.arange(len(log))[:, None] == 0, log.acceleration, np.nan))
    problem = ResponseProblem(robot, recordings(robot, [silent]), choose(robot, ["stiffness"], False, {}))
    values = [problem.evidence(np.array([z, z])) for z in (-2.0, 0.0, 3.0)]
    assert all(e.used <= 3 for e in values)


def test_information_is_the_curvature_at_the_truth():
    robot, log = load(DATA / "arm2_square")
    free = choose(robot, ["stiffness", "damping", "bias"], False, {})
    problem = ResponseProblem(robot, recordings(robot, [log[:1500]]), free).settled(np.zeros(len(free)))
    z = Search(problem, gain=GAIN).maximise(np.zeros(len(free)))
    evidence = problem.evidence(z)
    for i in range(len(free)):
        step = 1e-3 * np.eye(len(free))[i]
        gradients = [problem.evidence(z + s * step).gradient[i] for s in (-1, 1)]
        assert (gradients[0] - gradients[1]) / 2e-3 == pytest.approx(evidence.information[i, i], rel=0.05)


def test_a_filter_that_foretells_less_well_objects():
    robot, log = load(DATA / "arm2_square")
    free = choose(robot, ["stiffness"], False, {})
    worse = filters_gain(robot, [log[:800]], Noise(), free, np.array([1.5, -1.5]))
    assert worse < 0
    assert filters_gain(robot, [log[:800]], Noise(), free, np.zeros(2)) == 0
    (reason,) = objections(free, np.zeros(2), np.zeros(2), np.zeros(2), None, worse)
    assert "a Kalman filter predicts less well" in reason


def test_three_tolerances_are_of_a_spring_over_the_mass_that_it_is_measured_by():
    """A tolerance of 0.2 of the spring, and 0.1 of that mass, are 0.224 of their ratio."""
    robot, _ = load(DATA / "arm2_square")
    free = choose(robot, ["stiffness"], False, {})
    unit = by_unit(robot, free, np.zeros(2))
    np.testing.assert_allclose(unit, 0.1 / 0.2)
    np.testing.assert_array_equal(by_unit(robot, choose(robot, ["stiffness", "mass_scale"], False, {}), np.zeros(4)), 0)
    z = np.array([3.3, 3.4])
    (reason,) = objections(free, z, np.zeros(2), unit, None, None)
    assert "stiffness_axis3" in reason
    assert len(objections(free, z, np.zeros(2), np.zeros(2), None, None)) == 2


def wandering(seed, rows=2500):
    """One joint, links moved by noise below 8 Hz, its motor where the spring then needs it; nominal spring 10 % off."""
    rng = np.random.default_rng(seed)
    sections = scipy.signal.butter(6, 8.0, fs=1 / PERIOD, output="sos")
    raw = scipy.signal.sosfiltfilt(sections, rng.standard_normal(rows + 2000))
    raw *= 0.1 / np.std(raw)
    # Of seventh order: the second derivative of a cubic one would be wrong by more than what is told.
    spline = scipy.interpolate.make_interp_spline(PERIOD * np.arange(rows + 2000), raw, k=7)
    t = PERIOD * np.arange(1000, rows + 1000)
    q, dq, ddq = spline(t), spline(t, 1), spline(t, 2)
    robot = one_joint(6600.0, encoder=1e-6)
    noise = rng.normal(0, 0.05, (2, rows))
    theta = np.round((q + INERTIA * ddq / 6000.0) / 1e-6) * 1e-6
    columns = {"t": t - t[0], "theta_j": theta, "a_x": noise[0] - 0.5 * dq**2, "a_y": noise[1] + 0.5 * ddq}
    return robot, Log.from_table(columns, robot, check=False)


def intervals(repeats):
    """Estimates less truth in standard errors."""
    found = (calibrate(*wandering(seed), ["stiffness", "bias"])["stiffness_j"] for seed in range(repeats))
    return np.array([(x.value - 6000.0) / x.std for x in found])


def test_estimates_are_within_their_standard_errors():
    scores = intervals(6)
    assert np.abs(scores).max() < 4
    assert np.abs(scores.mean()) < 4 / np.sqrt(6)


@pytest.mark.slow
def test_intervals_of_95_percent_cover():
    scores = intervals(100)
    assert np.abs(scores.mean()) < 0.3
    assert 0.90 <= np.mean(np.abs(scores) < 1.96) <= 0.99
