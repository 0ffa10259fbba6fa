"""The momentum residual finds a torque that was put there, and none where none was."""

import numpy as np
import pytest

from linkside import EstimatorError, Log, ReducedOrderObserver
from linkside.velocity.residual import momentum_residual

from . import two_rods

PERIOD = 1e-3
PUSH = np.array([3.0, -2.0])


@pytest.fixture(scope="module")
def pushed():
    """Two seconds of motion; from 1.2 to 1.4 s something pushes."""
    robot, t = two_rods.robot(), PERIOD * np.arange(2001)
    tau = np.stack([np.cos(t / 2), -np.cos(t)], axis=1)
    x, rows = two_rods.START, []
    for time, torque in zip(t, tau, strict=True):
        rows.append(x)
        total = torque + PUSH * (1.2 <= time < 1.4)
        x = two_rods.rk4(
            lambda _, x, total=total: np.concatenate([x[2:], two_rods.forward(x[:2], x[2:], total)]), time, x, PERIOD
        )
    q = np.array(rows)[:, :2] + 2e-7 * np.random.default_rng(0).standard_normal((len(t), 2))
    columns = {"t": t, "theta_j1": q[:, 0], "theta_j2": q[:, 1], "tau_j1": tau[:, 0], "tau_j2": tau[:, 1]}
    log = Log.from_table(columns, robot)
    return robot, log, ReducedOrderObserver(robot, 200).run(log)


def test_finds_the_push(pushed):
    robot, log, estimate = pushed
    residual = momentum_residual(robot, log, estimate, quiet=(0.5, 1.1))
    np.testing.assert_allclose(residual.torque[1390], PUSH, atol=0.3)
    assert residual.collision[1250:1400].all()
    assert not residual.collision[500:1200].any()


@pytest.mark.parametrize(
    ("settings", "words"),
    [({"bandwidth": 0}, "bandwidth is 0"), ({"deviations": -1}, "deviations is -1"), ({"quiet": (8, 9)}, "quiet is")],
)
def test_refuses(pushed, settings, words):
    with pytest.raises(EstimatorError, match=words):
        momentum_residual(*pushed, **settings)


def test_refuses_an_estimate_of_other_rows(pushed):
    robot, log, estimate = pushed
    with pytest.raises(EstimatorError, match="rows"):
        momentum_residual(robot, log, estimate[:10])
