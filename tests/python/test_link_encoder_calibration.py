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
LATE = 3e-3
SMOOTH = np.polynomial.Polynomial([0, 0, 0, 10, -15, 6])
SETTINGS = {"tool": {"link": "hand"}, "encoder": {"resolution": 1e-7}, "tolerances": {"time_constant": 4e-3}}


def arm(factor=1.0, **settings):
    joints = [spring("shoulder", stiffness=factor * 1e4), spring("elbow", stiffness=factor * 4e3)]
    return Robot.from_urdf(ARM, joints, **SETTINGS, **settings)


@pytest.fixture(scope="module")
def recorded():
    """Two seconds of an arm whose link encoders have a filter; what is known of it is wrong by a fifth."""
    return moved(arm(link_encoder={"resolution": 1e-7, "corner_frequency": CORNER}))


def moved(true, substeps=4):
    """Two seconds of it, there and back."""
    start = np.array([0.3, 0.5])
    times = np.arange(0.0, 2.0, 0.01)
    there, back = (np.clip((times[:, None] - begin) / 0.5, 0, 1) for begin in (0.1, 1.1))
    theta = start + [0.5, -0.7] * (SMOOTH(there) - SMOOTH(back))
    torsion = true.gravity_torque(start) / [d.stiffness for d in true.drives]
    inertia = np.diag(true.mass_matrix(start)) + [d.motor_inertia for d in true.drives]
    hold = true.gravity_torque(start)
    control = JointPD(kp=900 * inertia, kd=42 * inertia, times=times, theta=theta + torsion, tau=hold)
    return simulate(true, control, 2.0, 1000.0, substeps=substeps, q=start, seed=1).log


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


@pytest.mark.parametrize("free", [[], ["link_time_constant"]])
def test_link_encoders_that_are_late_are_found_to_be(free):
    """By a delay that starts at zero, which is its bound, where robot.yaml says nothing of one."""
    log = moved(arm(link_encoder={"resolution": 1e-7, "delay": LATE}))
    found = calibrate(arm(0.8), log, ["stiffness", "damping", "link_delay", *free], torque=False)
    lag = found["link_delay"].value + (found["link_time_constant"].value if free else 0.0)
    assert lag == pytest.approx(LATE, abs=2e-5)
    assert found["link_delay"].value > 0.9 * LATE
    assert found["stiffness_elbow"].value == pytest.approx(4e3, rel=1e-3)


@pytest.mark.parametrize("free", [[], ["time_constant"]])
def test_an_accelerometer_that_is_late_is_found_to_be(free):
    sensor = {"name": "acc", "link": "hand", "noise_std": 0.05}
    log = moved(arm(accelerometers=[{**sensor, "delay": LATE}]))
    found = calibrate(arm(0.8, accelerometers=[sensor]), log, ["stiffness", "damping", "bias", "delay", *free])
    told = [found[f"{kind}_acc"] for kind in ("delay", *free) if f"{kind}_acc" not in found.refused]
    assert sum(e.value for e in told) == pytest.approx(LATE, abs=1.5e-4)
    assert abs(found["stiffness_elbow"].value - 4e3) < 3 * found["stiffness_elbow"].std


def test_a_filter_of_encoders_that_are_not_there_is_refused():
    robot, log = load(MISMATCH)
    with pytest.raises(EstimatorError, match="'link_time_constant' shows in link encoders only"):
        calibrate(robot, log[:100], ["stiffness", "link_time_constant"])


@pytest.mark.parametrize(
    ("kind", "law", "nominal", "truth"),
    [
        ("half_gap", {"backlash": {"half_gap": 3e-4, "rounding": 1e-4}}, {"backlash": {"half_gap": 2e-4}}, 3e-4),
        ("link_coulomb", {"bearing_friction": {"coulomb": 3.0}}, {}, 3.0),
        ("link_friction", {"link_friction": [0, 1, 1, 0, 1, 6]}, {"link_friction": [0, 1, 1, 0, 1, 3]}, 2.0),
    ],
)
def test_play_and_friction_of_links_are_found(kind, law, nominal, truth):
    def robot(**more):
        more.setdefault("backlash", {})
        if more["backlash"]:
            more["backlash"] = {"rounding": 1e-4, **more["backlash"]}
        joints = [spring("shoulder", stiffness=1e4), spring("elbow", stiffness=4e3, **more)]
        return Robot.from_urdf(ARM, joints, **SETTINGS, link_encoder={"resolution": 1e-7})

    found = calibrate(robot(**nominal), moved(robot(**law), 8), ["stiffness", "damping", kind], torque=False)
    assert found[f"{kind}_elbow"].value == pytest.approx(truth, rel=0.05)
    assert found["stiffness_elbow"].value == pytest.approx(4e3, rel=0.02)
