"""Consistency figures: right on series of known statistics, on runs drawn from the model, and in what they say."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robots_by_path import DATA, drawn_run, drawing_robot

from linkside import Estimate, EstimatorError, ExtendedKalmanFilter, KalmanEstimate, Log, Noise, Robot
from linkside.consistency import autocovariance, consistency, long_run_variance


def estimate_of(normalised, **more):
    """An estimate whose innovations are these, of standard deviation one."""
    rows, zero = len(normalised), np.zeros((len(normalised), 1))
    return KalmanEstimate(
        t=np.arange(rows) * 1e-3,
        q=zero,
        dq=zero,
        theta=zero,
        dtheta=zero,
        status=np.zeros(rows, np.uint8),
        names=("a",),
        nis=np.nansum(normalised**2, axis=1),
        used=np.isfinite(normalised).sum(axis=1).astype(np.uint32),
        log_likelihood=np.zeros(rows),
        innovation=normalised,
        innovation_std=np.ones_like(normalised),
        **more,
    )
