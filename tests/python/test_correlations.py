"""Correlations of what is known of a robot: from robot.yaml to standard deviations, from calibration to robot.yaml."""

import itertools
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st
from ruamel.yaml import YAML

from linkside import ConfigError, ExtendedKalmanFilter, Log, ParticleFilter, RauchTungStriebelSmoother, Robot
from linkside.calibration.tolerances import CLOSE, readable
from linkside.robot.considered import considered
from linkside.robot.correlations import matrix, refuse_impossible

from .robots import ARM, spring
from .test_tolerances import ENCODER, ESTIMATORS, JOINTS, UNTOLD, moving

WIDE = 0.02
TOGETHER = 0.999
NAMES = ("stiffness_elbow", "mass_scale_elbow")


def arm(elbow: Any = None, correlations: Any = None, wide: float = WIDE) -> Robot:
    """An arm whose elbow is known to `WIDE` in stiffness and mass, or one that truly differs."""
    known = {**UNTOLD, "calibrated": dict.fromkeys(NAMES, wide), "correlations": correlations or {}}
    joints = [JOINTS[0], {**JOINTS[1], **(elbow or {})}]
    return Robot.from_urdf(ARM, joints, encoder=ENCODER, torque={"noise_std": 0.01}, tolerances=known)


def counted(estimator: Any, log: Any, correlation: float) -> Any:
    """What the elbow's two tolerances add to standard deviations."""
    both = arm(correlations={NAMES[0]: {NAMES[1]: correlation}})
    wide, narrow = (estimator(robot).run(log).q_std for robot in (both, arm(wide=1e-9)))
    return np.sqrt(wide**2 - narrow**2)


def drawn(correlation: float, count: int) -> Any:
    """Logarithms of the elbow's stiffness and mass, drawn from what is known of them; each with its opposite."""
    root = scipy.linalg.sqrtm(WIDE**2 * np.array([[1, correlation], [correlation, 1]]))
    half = np.random.default_rng(3).standard_normal((count, 2)) @ root
    return np.concatenate([half, -half])


@pytest.mark.parametrize("correlation", [TOGETHER, 0.5, -0.9])
@pytest.mark.parametrize("estimator", [ExtendedKalmanFilter, RauchTungStriebelSmoother])
def test_a_product_that_is_known_better_than_its_factors(estimator: Any, correlation: float) -> None:
    """At rest the elbow gives way by its weight over its stiffness; the shoulder by the weight of both links."""
    robot, q = arm(), np.array([0.9, 0.6])
    held, stiffness = robot.gravity_torque(q), np.array([d.stiffness for d in robot.drives])
    rows = {"t": 1e-3 * np.arange(40)} | {f"tau_{name}": np.full(40, held[j]) for j, name in enumerate(robot.names)}
    rows |= {f"theta_{name}": np.full(40, (q + held / stiffness)[j]) for j, name in enumerate(robot.names)}
    found = counted(estimator, Log.from_table(rows, robot), correlation)
    ln_stiffness, ln_mass = drawn(correlation, 20_000).T
    elbow = np.std(held[1] / stiffness[1] * np.exp(ln_mass - ln_stiffness))
    shoulder = np.std(held[1] / stiffness[0] * np.exp(ln_mass))
    heavier = arm({"mass_scale": 2.0}).gravity_torque(q) - held
    np.testing.assert_allclose(found[:, 1], elbow, rtol=0.05)
    np.testing.assert_allclose(found[:, 0], shoulder * heavier[0] / heavier[1], rtol=0.05)


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_errors_that_go_together_count_as_drawn_robots_differ(estimator: Any) -> None:
    """Moving, the elbow's mass moves the elbow by way of the shoulder's vibration, too."""
    log = moving(arm()).log
    nominal = estimator(arm()).run(log).q
    off = []
    for ln_stiffness, ln_mass in drawn(TOGETHER, 8):
        elbow = {"stiffness": JOINTS[1]["stiffness"] * np.exp(ln_stiffness), "mass_scale": np.exp(ln_mass)}
        off.append(estimator(arm(elbow)).run(log).q - nominal)
    rows = slice(50, None)  # after the start
    together, independent = (counted(estimator, log, x)[rows] for x in (TOGETHER, 0.0))
    differ, together, independent = (
        np.sqrt(np.mean(x**2, axis=0)) for x in (np.array(off)[:, rows].reshape(-1, 2), together, independent)
    )
    assert np.all((together > 0.8 * differ) & (together < 2.2 * differ)), (together, differ)
    assert together[1] < 0.65 * independent[1]


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_a_correlation_of_zero_is_none(estimator: Any) -> None:
    log = moving(arm()).log
    zero, none = (arm(correlations=given) for given in ({NAMES[0]: {NAMES[1]: 0.0}}, {}))
    assert np.array_equal(estimator(zero).run(log).q_std, estimator(none).run(log).q_std)


def test_a_particle_filter_counts_them_too() -> None:
    log = moving(arm(), seconds=0.2).log
    stds = [
        ParticleFilter(arm(correlations={NAMES[0]: {NAMES[1]: x}}), particles=300, seed=1).run(log).q_std
        for x in (0.0, TOGETHER)
    ]
    assert np.all(stds[1][:20, 1] < 0.9 * stds[0][:20, 1])


A, B, C = "stiffness_shoulder", "stiffness_elbow", "damping_elbow"


@pytest.mark.parametrize(
    ("correlations", "message"),
    [
        ({"stifness_elbow": {A: 0.1}}, "expected a parameter with a tolerance; did you mean 'stiffness_elbow'"),
        ({A: {"lost_motion_elbow": 0.1}}, f"{A}.lost_motion_elbow: expected a parameter"),
        ({A: {A: 1.0}}, f"{A}.{A}: expected two parameters, got one twice"),
        ({A: {B: 0.5}, B: {A: 0.5}}, f"{B}.{A}: expected each pair once"),
        ({A: {B: -1.2}}, f"{A}.{B}: expected -1 to 1, got -1.2"),
        ({A: {B: 0.9, C: -0.9}, B: {C: 0.9}}, "tolerances.correlations: expected a positive semi-definite matrix"),
        ({A: {B: "much"}}, f"{A}.{B}: expected a number"),
    ],
)
def test_what_no_errors_have_is_refused(correlations: Any, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Robot.from_urdf(ARM, JOINTS, tolerances={"correlations": correlations})


def test_a_file_that_is_wrong_names_the_line(tmp_path: Any) -> None:
    (tmp_path / "robot.urdf").write_text(ARM)
    settings = {"urdf": "robot.urdf", "joints": [spring("shoulder"), spring("elbow")]}
    settings["tolerances"] = {"correlations": {A: {B: 2.0}}}
    with open(tmp_path / "robot.yaml", "w") as file:
        YAML().dump(settings, file)
    with pytest.raises(ConfigError, match=r"robot.yaml:\d+: tolerances.correlations"):
        Robot.load(tmp_path / "robot.yaml")


@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.floats(0, 5))
@settings(max_examples=60, deadline=None)
def test_few_digits_change_no_sum_of_errors(seed: int, count: int, apart: float) -> None:
    """However well some sum is known, such as a product of which neither factor is."""
    rng = np.random.default_rng(seed)
    directions = scipy.linalg.qr(rng.standard_normal((count, count)))[0]
    size = np.exp(rng.normal(0, 2, count))
    root = directions * 10 ** (-apart * rng.random(count))
    covariance = np.outer(size, size) * (root @ root.T)
    names = [f"p{i}" for i in range(count)]
    std, rows = readable(names, covariance)
    refuse_impossible(rows, names)
    scale = np.sqrt(np.diag(covariance))
    found = matrix(rows, names) * np.outer(std, std) / np.outer(scale, scale)
    exact = covariance / np.outer(scale, scale)
    values = scipy.linalg.eigvalsh(found, exact + 1e-12 * np.eye(count))
    assert np.abs(values - 1).max() < 1.2 * CLOSE
    if apart == 0 and count > 1:
        digits = {len(repr(x).partition(".")[2]) for x in itertools.chain(*(row.values() for row in rows.values()))}
        assert max(digits, default=0) <= 3


def test_only_what_counts_is_handed_on() -> None:
    robot = Robot.from_urdf(ARM, JOINTS, tolerances={"correlations": {A: {B: 0.5, "link_friction_elbow": 0.2}}})
    names = [one.name for one in considered(robot)]
    assert "link_friction_elbow" not in names  # there is none that could be wrong
    assert np.allclose(np.linalg.eigvalsh(matrix(robot.config.tolerances.correlations, names))[[0, -1]], [0.5, 1.5])
