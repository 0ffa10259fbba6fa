"""Gain design: the figures of the two-link arm, bounds that hold on random robots, and what is refused."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkside import EstimatorError, Robot
from linkside.velocity.gain_design import christoffel, coriolis_bound, design_gain, survey
from linkside.velocity.inertia import rigid_inertia

from . import two_rods
from .robots import robots, spring, states

RODS = two_rods.robot()


@pytest.fixture(scope="module")
def design():
    return design_gain(RODS, 1.5, 1.0)


def test_figures_of_the_two_link_arm(design):
    assert design.gain == pytest.approx(13.35799, abs=1e-4)
    assert abs(design.posture[1]) == pytest.approx(0.6426, abs=1e-3)
    assert design.conservative == pytest.approx(40.29, abs=0.01)
    assert design.coriolis == pytest.approx(24.66736, abs=1e-3)
    assert design.inertia == pytest.approx((1.52802, 81.80532), abs=1e-4)
    assert design.region == pytest.approx(0.13667, abs=1e-5)
    assert design.exact


def test_gains_of_the_levels(design):
    gain = design.hybrid(1.5, 4)
    assert gain.gains == pytest.approx((13.35799, 21.39453, 29.43109, 37.46764), abs=1e-4)
    assert gain.settings()["hysteresis"] == pytest.approx(0.15)


def test_rate_is_positive_inside_the_region_only(design):
    rates = [design.rate(share * design.region) for share in (0.0, 0.5, 0.99)]
    assert rates[0] > rates[1] > rates[2] > 0
    with pytest.raises(EstimatorError, match=r"less than the region's 0\.136"):
        design.rate(design.region)


def test_a_survey_is_kept_with_its_robot():
    assert survey(RODS) is survey(RODS)
    assert survey(RODS) is not survey(RODS, samples=64)


@settings(max_examples=30)
@given(robots(most=5), st.integers(0, 2**32 - 1))
def test_no_velocity_exceeds_the_bound(robot, seed):
    q, v, _ = states(robot, 4, seed)
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    symbols = christoffel(robot, q)
    np.testing.assert_allclose(symbols, symbols.swapaxes(2, 3), atol=1e-9 * np.abs(symbols).max())
    norms = np.linalg.norm(robot.coriolis_matrix(q, v), 2, axis=(1, 2))
    assert (norms <= coriolis_bound(symbols) * (1 + 1e-6) + 1e-9).all()


def test_inertia_with_motors():
    model = pin.buildSampleModelManipulator()
    names = list(model.names)[1:]
    robot = Robot.from_pinocchio(model, [spring(name) for name in names])
    q = pin.neutral(model)
    mass = pin.crba(model, model.createData(), q)
    expected = np.triu(mass) + np.triu(mass, 1).T
    np.testing.assert_allclose(rigid_inertia(robot, q, "links"), expected, atol=1e-9)
    np.testing.assert_allclose(rigid_inertia(robot, q), expected + 1.5 * np.eye(robot.n), atol=1e-9)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: design_gain(RODS, -1, 1), "speed is -1"),
        (lambda: design_gain(RODS, 1, np.nan), "margin is nan"),
        (lambda: design_gain(RODS, 1.5, 1).hybrid(0, 3), "bound 0 and levels 3"),
    ],
)
def test_refuses(call, words):
    with pytest.raises(EstimatorError, match=words):
        call()


def test_names_a_posture_with_singular_inertia():
    from .test_velocity import COAXIAL

    robot = Robot.from_urdf(COAXIAL, [spring("first"), spring("second")])
    with pytest.raises(EstimatorError, match="singular at the posture"):
        design_gain(robot, 1, 1, side="links")
