"""A robot.yaml begun from a URDF loads, with values in their ranges, and a calibration finds what is unknown."""

import re
import shutil

import numpy as np
import pytest
from click.testing import CliRunner

from linkside import ConfigError, EstimatorError, ExtendedKalmanFilter, Log, Robot, cli
from linkside.calibration import calibrate
from linkside.robot.starter import DRIVES, starter

from .robots import ARM, DATA, EXAMPLES

URDFS = {
    "ur10": ("ur_description/urdf/ur10_robot.urdf", 6),
    "panda": ("panda_description/urdf/panda.urdf", 7),
    "kinova": ("kinova_description/robots/kinova.urdf", 6),
    "z1": ("z1_description/urdf/z1.urdf", 7),
}


def linkside(*arguments):
    return CliRunner().invoke(cli.main, list(map(str, arguments)))


@pytest.mark.parametrize("name", URDFS)
@pytest.mark.parametrize("drive", DRIVES)
def test_it_loads_and_its_values_are_in_their_ranges(tmp_path, name, drive):
    path, joints = URDFS[name]
    text = starter(EXAMPLES / path, tmp_path / "robot.yaml", drive=drive)
    (tmp_path / "robot.yaml").write_text(text)
    robot = Robot.load(tmp_path / "robot.yaml")
    assert robot.n == joints
    found = re.findall(
        r"^  (?:stiffness|motor_inertia|damping): (\S+) +# .*typical, (\S+) … (\S+)$", text, re.MULTILINE
    )
    assert len(found) == 3 * sum(joint.stiffness_known for joint in robot.drives)
    assert all(float(low) < float(typical) < float(high) for typical, low, high in found)


def test_stiffness_follows_torque_and_drive():
    """A size 25 strain-wave gear, of 204 N m at most, has 5e4 N m/rad; an RV-20E, of 412 N m, 49 N m an arcmin."""
    urdf = ARM.replace('effort="1" velocity="1"', 'effort="204" velocity="2"')
    values = {}
    for drive in DRIVES:
        text = starter_of(urdf, drive)
        values[drive] = [float(v) for v in re.findall(r"^  stiffness: (\S+)", text, re.MULTILINE)]
    assert values["strain-wave"][0] == pytest.approx(5e4, rel=0.25)
    assert values["cycloidal"][0] == pytest.approx(204 / 412 * 49 * 60 * 180 / np.pi, rel=0.25)
    assert values["belt"][0] < values["planetary"][0] < values["cycloidal"][0]


def starter_of(urdf, drive="strain-wave", **settings):
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.urdf"
        path.write_text(urdf)
        return starter(path, Path(folder) / "robot.yaml", drive=drive, **settings)


def test_from_a_urdf_to_a_check(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copy(EXAMPLES / "ur_description/urdf/ur10_robot.urdf", "arm.urdf")
    made = linkside("init", "arm.urdf", "--gear-ratio", "elbow_joint=101")
    assert made.exit_code == 0, made.stderr
    text = (tmp_path / "robot.yaml").read_text()
    assert "ASKED" in text
    assert "gear_ratio: 101" in text
    assert "motor_side: true" in text
    assert "no accelerometer" in linkside("check", "robot.yaml").stdout
    sensors = [f"- {{name: acc{i}, link: wrist_{i}_link, xyz: [0.05, 0.04, 0.1]}}" for i in (1, 2, 3)]
    (tmp_path / "robot.yaml").write_text(text.replace("accelerometers: []", "\n".join(["accelerometers:", *sensors])))
    done = linkside("check", "robot.yaml")
    assert done.exit_code == 0, done.stderr
    assert "6 elastic joints" in done.stdout
    again = linkside("init", "arm.urdf")
    assert again.exit_code == 2
    assert "exists already" in again.stderr


def test_what_cannot_be_begun_is_refused():
    with pytest.raises(ConfigError, match="no such joint that moves, only shoulder, elbow"):
        starter_of(ARM, gear_ratios={"wrist": 100.0})
    with pytest.raises(ConfigError, match="expected a number other than 0"):
        starter_of(ARM, gear_ratios={"elbow": 0.0})
    with pytest.raises(ConfigError, match="no joint moves"):
        starter_of(ARM.replace("revolute", "fixed"))
    with pytest.raises(ConfigError, match="drive: 'gum' is not one of"):
        starter_of(ARM, "gum")


def test_limits_that_say_nothing_leave_the_stiffness_unknown():
    text = starter_of(ARM.replace('effort="1"', 'effort="0"'))
    assert text.count("stiffness: unknown  ") == 2


def unknown(tmp_path, name="arm2_square"):
    for file in ("robot.yaml", "robot.urdf"):
        shutil.copy(DATA / name / file, tmp_path)
    text = (tmp_path / "robot.yaml").read_text()
    (tmp_path / "robot.yaml").write_text(re.sub(r"stiffness: \S+", "stiffness: unknown", text))
    return tmp_path / "robot.yaml"


def test_a_calibration_finds_what_is_unknown(tmp_path):
    path = unknown(tmp_path)
    robot = Robot.load(path)
    assert [joint.stiffness for joint in robot.drives] == [6400 * 70.0, 6400 * 40.0]
    log = Log.read(DATA / "arm2_square/log.parquet", robot)
    with pytest.raises(EstimatorError, match=r"'axis2', 'axis3' stiffness: unknown.*calibrate first"):
        ExtendedKalmanFilter(robot)
    result = calibrate(robot, [log], ["stiffness", "damping"])
    for name, true in (("axis2", 4.5e5), ("axis3", 3e5)):
        assert result[f"stiffness_{name}"].value == pytest.approx(true, rel=0.05)
        assert result[f"stiffness_{name}"].parameter.tolerance == pytest.approx(np.log(3))
    result.write(path, tmp_path / "found.yaml")
    found = Robot.load(tmp_path / "found.yaml")
    assert all(joint.stiffness_known for joint in found.drives)
    ExtendedKalmanFilter(found)


def test_unknown_needs_somewhere_to_begin(tmp_path):
    path = unknown(tmp_path)
    path.write_text(path.read_text().replace("  motor_inertia: 70.0\n", ""))
    with pytest.raises(ConfigError, match="stiffness: expected motor_inertia beside it"):
        Robot.load(path)
