"""Calibration with encoders behind the gears: their filter is found along with the springs."""

import numpy as np
import pytest
from ruamel.yaml import YAML

from linkside import Robot
from linkside.calibration import calibrate
from linkside.control.controllers import JointPD
from linkside.errors import EstimatorError
from linkside.simulation import simulate

from .robots import ARM, spring
from .test_calibration import MISMATCH, load

CORNER = 40.0
SMOOTH = np.polynomial.Polynomial([0, 0, 0, 10, -15, 6])
SETTINGS = {"tool": {"link": "hand"}, "encoder": {"resolution": 1e-7}, "tolerances": {"time_constant": 4e-3}}


def arm(factor=1.0, **settings):
    joints = [spring("shoulder", stiffness=factor * 1e4), spring("elbow", stiffness=factor * 4e3)]
    return Robot.from_urdf(ARM, joints, **SETTINGS, **settings)


@pytest.fixture(scope="module")
def recorded():
    """Two seconds of an arm whose link encoders have a filter; what is known of it is wrong by a fifth."""
    true = arm(link_encoder={"resolution": 1e-7, "corner_frequency": CORNER})
    start = np.array([0.3, 0.5])
    times = np.arange(0.0, 2.0, 0.01)
    there, back = (np.clip((times[:, None] - begin) / 0.5, 0, 1) for begin in (0.1, 1.1))
    theta = start + [0.5, -0.7] * (SMOOTH(there) - SMOOTH(back))
    torsion = true.gravity_torque(start) / [d.stiffness for d in true.drives]
    inertia = np.diag(true.mass_matrix(start)) + [d.motor_inertia for d in true.drives]
    hold = true.gravity_torque(start)
    control = JointPD(kp=900 * inertia, kd=42 * inertia, times=times, theta=theta + torsion, tau=hold)
    return simulate(true, control, 2.0, 1000.0, substeps=4, q=start, seed=1).log


def test_their_filter_is_found_with_the_springs(recorded, tmp_path):
    found = calibrate(arm(0.8), recorded, ["stiffness", "damping", "link_time_constant"], torque=False)
    assert found["link_time_constant"].value == pytest.approx(1 / (2 * np.pi * CORNER), rel=0.02)
    for name, stiffness in (("shoulder", 1e4), ("elbow", 4e3)):
        assert found[f"stiffness_{name}"].value == pytest.approx(stiffness, rel=0.02)
    (tmp_path / "robot.urdf").write_text(ARM)
    joints = [d.model_dump(exclude_unset=True, mode="json") for d in arm(0.8).drives]
    with open(tmp_path / "robot.yaml", "w") as file:
        YAML().dump({"urdf": "robot.urdf", "joints": joints, **SETTINGS}, file)
    found.write(tmp_path / "robot.yaml", tmp_path / "new.yaml")
    written = Robot.load(tmp_path / "new.yaml")
    assert written.config.link_encoder.corner_frequency == pytest.approx(CORNER, rel=0.02)
    # What robot.yaml says of a filter is taken from there.
    again = calibrate(written, recorded, ["stiffness", "damping"], torque=False)
    assert again["stiffness_elbow"].value == pytest.approx(4e3, rel=0.02)


def test_a_filter_of_encoders_that_are_not_there_is_refused():
    robot, log = load(MISMATCH)
    with pytest.raises(EstimatorError, match="'link_time_constant' shows in link encoders only"):
        calibrate(robot, log[:100], ["stiffness", "link_time_constant"])
