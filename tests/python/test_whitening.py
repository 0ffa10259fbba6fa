"""Residuals made white: against a process whose innovations are known."""

import numpy as np
import pytest
import scipy.signal

from linkside.calibration.whitening import ORDER, Whitening

RINGING = [1.0, -1.9, 0.95]


def test_what_rings_is_foretold_and_its_innovations_are_left():
    rng = np.random.default_rng(4)
    innovations = rng.standard_normal((20_000, 2)) * [0.5, 2.0]
    rung = np.stack([scipy.signal.lfilter([1.0], RINGING, innovations[:, 0]), innovations[:, 1]], axis=1)
    white = Whitening.of([rung[:9000], rung[9000:]], {})
    left = white(rung)
    assert white.weights[0, :3] == pytest.approx(RINGING, abs=0.06)
    assert np.all((left - innovations[ORDER:]).std(axis=0) < 0.2)
    assert left.std(axis=0) == pytest.approx([0.5, 2.0], rel=0.03)
    assert len(white.rows(len(rung))) == len(left)


def test_derivatives_pass_the_same_filter():
    rng = np.random.default_rng(5)
    white = Whitening.of([rng.standard_normal((500, 2)).cumsum(axis=0)], {})
    slopes = rng.standard_normal((300, 2, 3))
    assert np.allclose(white(slopes)[:, :, 1], white(slopes[:, :, 1]))


def test_what_was_missing_tells_nothing_nor_what_came_of_it():
    white = Whitening.of([np.random.default_rng(6).standard_normal((500, 1))], {})
    missing = np.zeros((100, 1), bool)
    missing[40:60] = True
    told = white.told(missing)[:, 0]
    first = int(white.rows(100)[0])
    assert not told[40 - first : 60 - first].any()
    assert not told[60 - first]
    assert told[: 40 - first].all()
    assert told[-1]


def test_short_recordings_are_taken_as_they_are():
    assert Whitening.of([np.ones((10, 3))], {}).weights.tolist() == [[1.0]] * 3
