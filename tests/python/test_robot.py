"""The compiled robot against Pinocchio, and the one line that says why a robot is refused."""

import pickle
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robots import ARM, DATA, EXAMPLES, build_model, robots, spring, states

from linkside import sensors
from linkside.config import JointConfig
from linkside.errors import ConfigError, EstimatorError
from linkside.robot import Robot

SEEDS = st.integers(0, 2**32 - 1)
ARM_JOINTS = [spring("shoulder"), spring("elbow")]


def in_log_order(robot: Robot, matrix: np.ndarray) -> np.ndarray:
    return matrix[np.ix_(robot.velocity_index, robot.velocity_index)]


def pinocchio_state(robot: Robot, q: Any, *rates: Any) -> tuple[np.ndarray, ...]:
    return robot.to_pinocchio(q), *map(robot.velocity_to_pinocchio, rates)


@settings(max_examples=60, deadline=None)
@given(robot=robots(), seed=SEEDS)
def test_dynamics_are_those_of_pinocchio(robot: Robot, seed: int) -> None:
    q, dq, ddq = (rows[0] for rows in states(robot, 1, seed))
    data, (x, v, a) = robot.model.createData(), pinocchio_state(robot, q, dq, ddq)
    close = dict(rtol=1e-10, atol=1e-10)
    torque = pin.rnea(robot.model, data, x, v, a)[robot.velocity_index]
    np.testing.assert_allclose(robot.inverse_dynamics(q, dq, ddq), torque, **close)
    mass = in_log_order(robot, pin.crba(robot.model, data, x, pin.Convention.WORLD))
    np.testing.assert_allclose(np.triu(robot.mass_matrix(q)[np.ix_(*[np.argsort(robot.velocity_index)] * 2)]),
                               np.triu(data.M), **close)
    assert mass.shape == (robot.n, robot.n)
    gravity = pin.computeGeneralizedGravity(robot.model, data, x)[robot.velocity_index]
    np.testing.assert_allclose(robot.gravity_torque(q), gravity, **close)
    for ours, theirs in zip(
        robot.inverse_dynamics_derivatives(q, dq, ddq)[:2],
        pin.computeRNEADerivatives(robot.model, data, x, v, a)[:2],
        strict=True,
    ):
        np.testing.assert_allclose(ours, in_log_order(robot, theirs), **close)
