"""How Hypothesis runs here: no clock decides, and on CI the same examples every time."""

import os

from hypothesis import HealthCheck, settings

settings.register_profile(
    "linkside",
    deadline=None,
    derandomize="CI" in os.environ,
    # Random robots are often beside the point of a test; that is no fault of theirs, nor is a slow machine.
    suppress_health_check=[HealthCheck.filter_too_much, HealthCheck.too_slow, HealthCheck.data_too_large],
)
settings.load_profile("linkside")
