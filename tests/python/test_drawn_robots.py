"""Robots drawn from their tolerances are where estimates say, within the standard deviations that they state."""

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

STUDY = runpy.run_path(str(Path(__file__).parents[2] / "docs/drawn_robots.py"))


@pytest.mark.parametrize(("first", "count"), [(0, 10), pytest.param(0, 100, marks=pytest.mark.slow)])
def test_errors_are_as_large_as_said(first, count):
    """Medians in proportion, few rows off without a word or flagged without need, squares as large as they should be.

    A robot's errors are one draw, whatever the number of rows: its share of rows off is all or nothing.
    """
    verdicts = [STUDY["judged"](specimen) for specimen in STUDY["specimens"](count, first)]
    for method in STUDY["METHODS"]:
        ratio, off, silent, nees, good = (
            np.array([getattr(v[method], what) for v in verdicts])
            for what in ("ratio", "off", "silent", "nees", "good")
        )
        assert 0.2 < np.median(ratio) < 1.5, method
        assert ratio.max() < 3, method
        assert silent.mean() <= 0.02, method
        assert off.mean() <= 0.03, method
        assert 0.1 < np.median(nees) < 1.5, method
        assert nees.mean() < 1.5, method
        assert good.mean() > 0.9, method


@pytest.mark.parametrize("number", [267, 319, 327])
def test_nothing_is_wrong_after_a_gap(number):
    """Rows of 0.2 s are missing, and with them most of a motion: what one linearisation left looked like a fault."""
    specimen = next(STUDY["specimens"](1, number))
    log, rows = specimen.log, np.r_[:500, 600 : len(specimen.log)]
    signals = {name: getattr(log, name)[rows] for name in ("t", "theta", "dtheta", "tau", "acceleration")}
    estimate = STUDY["METHODS"]["ekf"](specimen.robot).run(replace(log, **signals))
    assert estimate.findings == ()
    assert (estimate.status == 0).all()
    assert (np.abs(estimate.q - specimen.q[rows]) < 3 * estimate.q_std).all()


def test_a_specimen_is_another_robot_than_its_yaml_says():
    specimen = next(STUDY["specimens"](1, 2))
    assert specimen.log.acceleration is not None
    estimate = STUDY["METHODS"]["ekf"](specimen.robot, tolerances=False).run(specimen.log)
    off = np.abs(estimate.q - specimen.q) > 3 * estimate.q_std
    assert off.any(axis=1).mean() > 0.5  # so that it is the tolerances that make them honest
