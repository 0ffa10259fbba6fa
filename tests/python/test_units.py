"""A recording in other units, in any format, is the same recording."""

import shutil
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import constants as si
from scipy.io import savemat

from linkside import Log, LogError, Robot, cli, inspect, simulate
from linkside.comparison.reading import read_motion
from linkside.errors import ConfigError
from linkside.robot.units import SI, TABLE

from . import bags

FOLDER = Path(__file__).parents[1] / "data/arm2_square"
WHOLE = pd.read_parquet(FOLDER / "log.parquet")
PLAIN = Robot.load(FOLDER / "robot.yaml")
SIGNALS = ("t", "theta", "tau", "acceleration")

UNITS = {"t": "ms", "theta": "deg", "tau": "N mm", "acceleration": "g", "theta_axis3": "arcsec"}
SIZES = {"t": si.milli, "theta": si.degree, "tau": si.milli, "tool_acc": si.g, "theta_axis3": si.arcsec}


def size(column):
    return SIZES.get(column) or SIZES.get(column.rpartition("_")[0], 1.0)


def other_units(table):
    """The same readings in `UNITS`."""
    return pd.DataFrame({column: values / size(column) for column, values in table.items()})


def robot(folder, **sections):
    shutil.copy(FOLDER / "robot.urdf", folder)
    text = (FOLDER / "robot.yaml").read_text() + "".join(f"{key}: {value}\n" for key, value in sections.items())
    (folder / "robot.yaml").write_text(text.replace("'", ""))
    return folder / "robot.yaml"


def write_hdf5(table, path):
    with h5py.File(path, "w") as file:
        for column, values in table.items():
            file[column] = values.to_numpy()


WRITERS = {
    "parquet": lambda table, path: table.to_parquet(path),
    "csv": lambda table, path: table.to_csv(path, index=False),
    "mat": lambda table, path: savemat(path, {name: values.to_numpy() for name, values in table.items()}),
    "h5": write_hdf5,
}


def close(log, whole, signals=SIGNALS):
    for signal in signals:
        want = getattr(whole, signal)
        np.testing.assert_allclose(getattr(log, signal), want, rtol=1e-13, atol=1e-13 * np.nanmax(np.abs(want)))


def test_table_agrees_with_scipy():
    """The units that SciPy has under a name."""
    known = {
        "angle": {"deg": si.degree, "arcmin": si.arcmin, "arcsec": si.arcsec, "rev": 2 * si.pi},
        "angular velocity": {"rpm": 2 * si.pi / si.minute, "deg/s": si.degree},
        "length": {"in": si.inch, "mm": si.milli, "um": si.micron},
        "acceleration": {"g": si.g},
        "torque": {"lbfin": si.lbf * si.inch, "lbfft": si.lbf * si.foot, "kgfm": si.kgf, "Nmm": si.milli},
        "force": {"lbf": si.lbf, "kgf": si.kgf},
        "velocity": {"mm/min": si.milli / si.minute},
        "time": {"min": si.minute, "us": si.micro, "ns": si.nano},
    }
    for dimension, units in known.items():
        for name, value in units.items():
            assert TABLE[dimension][name] == pytest.approx(value, rel=1e-15), name
    assert SI.keys() == TABLE.keys()
    names = [name for units in TABLE.values() for name in units]
    assert len(names) == len(set(names)), "a name of two units"


@pytest.mark.parametrize("suffix", WRITERS)
def test_every_format(tmp_path, suffix):
    path = tmp_path / f"log.{suffix}"
    WRITERS[suffix](other_units(WHOLE), path)
    whole, arm = Log.from_table(WHOLE, PLAIN), Robot.load(robot(tmp_path, units=UNITS))
    log = Log.read(path, arm)
    close(log, whole)
    assert log.period == pytest.approx(whole.period, rel=1e-9)
    assert log.conversions == (
        "t: ms to s, times 0.001",
        "theta_axis2: deg to rad, times 0.0174533",
        "theta_axis3: arcsec to rad, times 4.84814e-06",
        "tau_axis2, tau_axis3: N mm to N m, times 0.001",
        "tool_acc_x, tool_acc_y, tool_acc_z: g to m/s², times 9.80665",
    )
    pieces = list(Log.stream(path, arm, rows=777))
    for signal in SIGNALS:
        assert np.array_equal(np.concatenate([getattr(piece, signal) for piece in pieces]), getattr(log, signal))


def test_bag_converted_but_its_time(tmp_path):
    """Stamps of messages are what they are; a log converted for the robot is read back in its unit of time."""
    head = WHOLE.head(300)
    degrees = np.degrees(head[["theta_axis2", "theta_axis3"]].to_numpy())
    stamps = [round(1e9 * t) + 10**18 for t in head.t]
    states = [bags.joint_state(t, ["axis2", "axis3"], q.copy()) for t, q in zip(stamps, degrees, strict=True)]
    bags.write(tmp_path / "bag", [(t, "/js", state) for t, state in zip(stamps, states, strict=True)])
    arm = robot(tmp_path, units={"t": "ns", "theta": "deg"}, sources={"joints": "/js"})
    log = Log.read(tmp_path / "bag", Robot.load(arm))
    np.testing.assert_allclose(log.theta, head[["theta_axis2", "theta_axis3"]], atol=1e-12)
    np.testing.assert_allclose(log.t, head.t - head.t[0], atol=1e-9)
    out = tmp_path / "log.parquet"
    done = CliRunner().invoke(cli.main, ["convert", str(tmp_path / "bag"), "--robot", str(arm), "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert pd.read_parquet(out).t.iloc[1] == pytest.approx(1e9 * log.t[1])
    close(Log.read(out, Robot.load(arm)), log, ("t", "theta"))


def test_merged_files_are_in_the_same_units(tmp_path):
    table = other_units(WHOLE)
    arm = Robot.load(robot(tmp_path, units=UNITS))
    acceleration = [column for column in table if column.startswith("tool_acc")]
    log = Log.merge([table.drop(columns=acceleration), table[["t", *acceleration]]], arm)
    close(log, Log.from_table(WHOLE, PLAIN))
    log.write(tmp_path / "merged.parquet")
    close(Log.read(tmp_path / "merged.parquet", arm), log)
    np.testing.assert_allclose(pd.read_parquet(tmp_path / "merged.parquet").t, table.t, rtol=1e-13)


@given(st.sampled_from(sorted(TABLE["angle"])), st.sampled_from(sorted(TABLE["torque"])), st.booleans())
@settings(max_examples=25, deadline=None)
def test_written_as_recorded(tmp_path_factory, angle, torque, motor_side):
    """What is written is what was read, and reads back as the same, on either side of the gear."""
    folder = tmp_path_factory.mktemp("units")
    joints = [{"name": n, "stiffness": 1e5, "motor_inertia": 50, "gear_ratio": 120} for n in ("axis2", "axis3")]
    side = {"motor_side": motor_side}
    arm = Robot.from_urdf(FOLDER / "robot.urdf", joints, columns=side, units={"theta": angle, "tau": torque})
    columns = ["t", "theta_axis2", "theta_axis3", "tau_axis2", "tau_axis3"]
    log = Log.from_table(WHOLE[columns].head(50), arm, check=False)
    log.write(folder / "log.parquet")
    written = pd.read_parquet(folder / "log.parquet")
    np.testing.assert_allclose(written[columns], WHOLE[columns].head(50), rtol=1e-14)
    close(Log.read(folder / "log.parquet", arm, check=False), log, ("t", "theta", "tau"))
    ratio = 120 if motor_side else 1
    np.testing.assert_allclose(log.theta * ratio, WHOLE[columns[1:3]].head(50) * TABLE["angle"][angle], rtol=1e-14)


def test_current_is_a_torque(tmp_path):
    """Where a torque is recorded it is taken; the constant is on the side of the gear that the log is on."""
    constants = {"axis2": 40.0, "axis3": 25.0}
    path = robot(tmp_path, units={"current": "mA"}, columns={"current_axis3": "i3"})
    text = path.read_text()
    for joint, value in constants.items():
        text = text.replace(f"name: {joint}\n", f"name: {joint}\n  torque_constant: {value}\n")
    path.write_text(text)
    arm = Robot.load(path)
    assert arm.torque_constant == (40.0, 25.0)
    table = WHOLE.drop(columns=["tau_axis3"]).assign(i3=1e3 * WHOLE.tau_axis3 / 25, current_axis2=7.0)
    log = Log.from_table(table, arm)
    np.testing.assert_allclose(log.tau, WHOLE[["tau_axis2", "tau_axis3"]], rtol=1e-13)
    assert log.columns("tau") == ("tau_axis2", "i3")
    assert log.conversions == ("i3: taken for motor torque, 25 N m/A", "i3: mA to A, times 0.001")
    log.write(tmp_path / "log.parquet")
    np.testing.assert_allclose(pd.read_parquet(tmp_path / "log.parquet").i3, table.i3, rtol=1e-13)
    merged = Log.merge([table.drop(columns="i3"), table[["t", "i3"]]], arm)
    np.testing.assert_allclose(merged.tau, log.tau, rtol=1e-13)
    bare = WHOLE.drop(columns=["tau_axis3"]).assign(current_axis3=1.0)
    with pytest.raises(LogError, match=r"'tau_axis3' is missing .*'current_axis3' .*torque_constant"):
        Log.from_table(bare, PLAIN).require("tau")


def test_checks_run_on_what_was_converted(tmp_path):
    arm = Robot.load(robot(tmp_path, units=UNITS))
    assert inspect(Log.from_table(other_units(WHOLE), arm), arm) == ()
    # What is said to be in degrees and is in radians does not fit the accelerometers.
    wrong = other_units(WHOLE).assign(theta_axis2=WHOLE.theta_axis2, theta_axis3=WHOLE.theta_axis3)
    assert "refused" in {found.verdict for found in inspect(Log.from_table(wrong, arm, check=False), arm)}
    sentinel = other_units(WHOLE)
    sentinel.loc[100, "theta_axis2"] = -9999.0
    with pytest.raises(LogError, match=r"'theta_axis2' is -9999, which is no reading, at row 100"):
        Log.from_table(sentinel, arm)
    short = other_units(WHOLE).assign(t=lambda table: (table.t + 2e7).astype(np.float32))
    with pytest.raises(LogError, match="repeats"):
        Log.from_table(short, arm)
    coarse = other_units(WHOLE).assign(t=lambda table: (1.3 * table.t + 1.5e6).astype(np.float32).astype(float))
    found = inspect(Log.from_table(coarse, arm, check=False), arm)
    assert "float32" in [one.kind for one in found if one.column == "t"]


def test_a_motor_shaft_turns_even_where_the_link_slides():
    urdf = """<robot name="gantry"><link name="base"/><link name="x"><inertial><mass value="3"/>
      <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link><link name="arm"><inertial>
      <mass value="3"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
      <joint name="slide" type="prismatic"><parent link="base"/><child link="x"/><axis xyz="1 0 0"/>
      <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
      <joint name="turn" type="continuous"><parent link="x"/><child link="arm"/><axis xyz="0 0 1"/></joint></robot>"""
    joints = [{"name": n, "stiffness": 1e5, "motor_inertia": 5, "gear_ratio": 300} for n in ("slide", "turn")]

    def units(told, **columns):
        arm = Robot.from_urdf(urdf, joints, units=told, columns=columns)
        return {column: unit.si for column, unit in arm.column_units.items()}

    assert units({"theta": "deg"}) == {"theta_turn": "rad"}
    assert units({"theta": "deg", "theta_slide": "mm"}) == {"theta_turn": "rad", "theta_slide": "m"}
    assert units({"theta": "deg"}, motor_side=True) == {"theta_turn": "rad", "theta_slide": "rad"}
    assert units({"q": "mm", "tau": 2.5}) == {"q_slide": "m", "tau_slide": "N", "tau_turn": "N m"}
    with pytest.raises(ConfigError, match=r"units\.theta_slide: expected a unit of length \(m.*got 'deg', of angle"):
        units({"theta_slide": "deg"})
    with pytest.raises(ConfigError, match=r"units\.theta_turn: expected a unit of angle"):
        units({"theta_turn": "mm"}, motor_side=True)


@pytest.mark.parametrize(
    ("units", "message"),
    [
        ({"theta": "grad"}, r"robot.yaml:\d+: units\.theta: unknown unit 'grad'; there is s, ms, us, .*deg.*rpm"),
        ({"theta": "g"}, r"units\.theta: expected a unit of angle or length \(rad, .*\), got 'g', of acceleration"),
        ({"t": "deg"}, r"units\.t: expected a unit of time \(s, ms, us, ns, min\), got 'deg'"),
        ({"thetta": "deg"}, r"units\.thetta: expected a kind of channel, t, theta, .*, or a column of the log"),
        ({"theta": 0}, r"units\.theta: unknown unit 0"),
        ({"theta": "true"}, r"units\.theta: unknown unit True"),
        ({"theta": [1]}, r"units\.theta: unknown unit \[1\]"),
        ({"rate": "deg/s"}, None),  # of a sensor that the robot lacks
        ({"theta": "°", "tau": "N·m", "acceleration": "m/s^2", "t": "µs", "dtheta": "rad/s"}, None),
    ],
)
def test_units_that_are_none(tmp_path, units, message):
    path = robot(tmp_path, units=units)
    if message is None:
        Robot.load(path)
    else:
        with pytest.raises(ConfigError, match=message):
            Robot.load(path)


def test_said_on_the_command_line(tmp_path):
    arm = str(robot(tmp_path, units=UNITS))
    log, out = str(tmp_path / "log.parquet"), str(tmp_path / "out.parquet")
    other_units(WHOLE).to_parquet(log)
    for arguments in (["check", arm, log], ["estimate", arm, log, "--out", out]):
        done = CliRunner().invoke(cli.main, arguments)
        assert done.exit_code == 0, done.output
        assert "converted: theta_axis2: deg to rad, times 0.0174533" in done.output
    plain = tmp_path / "plain.parquet"
    done = CliRunner().invoke(
        cli.main, ["estimate", str(FOLDER / "robot.yaml"), str(FOLDER / "log.parquet"), "--out", str(plain)]
    )
    q = [f"q_{joint}" for joint in PLAIN.names]
    np.testing.assert_allclose(pd.read_parquet(out)[q], pd.read_parquet(plain)[q], atol=1e-9)


def test_simulated_logs_are_in_the_robots_units(tmp_path):
    arm = Robot.load(robot(tmp_path, units=UNITS))
    runs = [simulate(each, lambda t, state: np.zeros(2), 0.1, 1000.0) for each in (arm, PLAIN)]
    close(runs[0].log, runs[1].log)
    runs[0].write(tmp_path / "run")
    written = pd.read_parquet(tmp_path / "run/log.parquet")
    np.testing.assert_allclose(written.t, 1e3 * runs[1].log.t)


def test_a_commanded_path_is_converted(tmp_path):
    arm = Robot.load(robot(tmp_path, units={"t": "ms", "qref": "deg"}, columns={"t": "time"}))
    table = pd.DataFrame({"time": [0.0, 1.0, 2.0], "qref_axis2": [0.0, 90.0, 180.0], "qref_axis3": [1.0, 2.0, 3.0]})
    table.to_csv(tmp_path / "path.csv", index=False)
    motion = read_motion(tmp_path / "path.csv", arm)
    np.testing.assert_allclose(motion.t, [0, 1e-3, 2e-3])
    np.testing.assert_allclose(motion.q[:, 0], [0, np.pi / 2, np.pi])
