"""Scenarios that Rust, Python and C read alike, here by way of the C interface; and bits that no processor changes."""

import json

import pytest

from .processors import outputs
from .scenarios import DATA, SCENARIOS, Estimator

PROGRAM = f"""
import hashlib, json
import numpy as np
import linkside
from linkside import Log, Noise, Robot
robot = Robot.load({str(DATA / "arm2_square/robot.yaml")!r})
log = Log.read({str(DATA / "arm2_square/log.parquet")!r}, robot)[:500]
noise = Noise(jerk=15.0)
methods = {{
    "observer": linkside.AccelerationObserver(robot),
    "reduced-order": linkside.ReducedOrderObserver(robot),
    "ekf": linkside.ExtendedKalmanFilter(robot, noise),
    "ckf": linkside.CubatureKalmanFilter(robot, noise),
    "smoother": linkside.RauchTungStriebelSmoother(robot, noise),
    "elastic-ekf": linkside.ElasticJointFilter(robot),
    "particle": linkside.ParticleFilter(robot, noise, particles=100),
}}
found = {{}}
for name, method in methods.items():
    estimate = method.run(log)
    arrays = [estimate.q, estimate.dq, estimate.theta, estimate.status]
    found[name] = hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes() for a in arrays)).hexdigest()[:16]
print(json.dumps(found))
"""


@pytest.mark.parametrize("path", sorted(SCENARIOS.glob("*.json")), ids=lambda path: path.stem)
def test_c_answers_to_the_last_bit(library, path):
    scenario = json.loads(path.read_text())
    with Estimator(library / "liblinkside.so", (DATA / "compiled" / scenario["estimator"]).read_bytes()) as estimator:
        for given, answer in zip(scenario["steps"], scenario["answers"], strict=True):
            assert estimator.step(given) == answer


def test_estimates_have_the_same_bits_on_every_processor():
    levels = [{"LINKSIDE_SIMD": level} for level in ("baseline", "avx2", "widest")]
    (found,) = outputs(PROGRAM, levels)
    assert len(json.loads(found)) == 7
