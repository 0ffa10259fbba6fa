"""ROS bags: numbers equal to those of `rosbags` to the bit, and the way from a bag to a log and an estimate."""

import json
import re
import shutil
import sqlite3
import warnings
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from linkside import Estimate, ExtendedKalmanFilter, Log, LogError, RecordingWarning, Robot, cli
from linkside.files.bags import Bag, Wanted, is_bag
from linkside.recording.sources import bag_table
from linkside.robot.sources import SourcesConfig

from . import bags

FOLDER = Path(__file__).parents[1] / "data/arm2_square"
WHOLE = pd.read_parquet(FOLDER / "log.parquet")
TRUTH = pd.read_parquet(FOLDER / "truth.parquet")
START = 1_700_000_000_123_456_789
NAMES = ("axis2", "axis3")
FORCE = [f"tool_acc_{axis}" for axis in "xyz"]
SOURCES = {"joints": "/joint_states", "imu": {"tool_acc": "/imu_tool"}}
KINDS = (
    "builtin_interfaces/msg/Time",
    "std_msgs/msg/Empty",
    "std_msgs/msg/Float64MultiArray",
    "std_msgs/msg/UInt8",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
    "geometry_msgs/msg/TwistStamped",
    "geometry_msgs/msg/WrenchStamped",
    "nav_msgs/msg/Odometry",
    "nav_msgs/msg/Path",
    "sensor_msgs/msg/BatteryState",
    "sensor_msgs/msg/CameraInfo",
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/Joy",
    "sensor_msgs/msg/LaserScan",
    "sensor_msgs/msg/MultiDOFJointState",
    "sensor_msgs/msg/NavSatFix",
    "sensor_msgs/msg/PointCloud2",
    "tf2_msgs/msg/TFMessage",
    "trajectory_msgs/msg/JointTrajectory",
    "own_msgs/msg/Everything",
)
FORMS = [(storage, mode) for storage in ("mcap", "sqlite3") for mode in ("none", "message", "file")]
FORMS.append(("mcap", "storage"))
pytestmark = pytest.mark.filterwarnings("ignore:.*robot.yaml says 2000 Hz:linkside.RecordingWarning")


def linkside(*arguments):
    return CliRunner().invoke(cli.main, list(map(str, arguments)))


def nanoseconds(t):
    return START + round(1e9 * t)


def recording():
    """The recording as messages of two sensors at rates of their own, each recorded 3 ms after its stamp or 1 ms."""
    for row in WHOLE.iloc[::2].itertuples():
        time = nanoseconds(row.t)
        signals = ([getattr(row, f"{signal}_{name}") for name in NAMES] for signal in ("theta", "dtheta", "tau"))
        yield time + 3_000_000, "/joint_states", bags.joint_state(time, NAMES, *signals)
    for row in WHOLE.iloc[1::3].itertuples():
        time = nanoseconds(row.t)
        yield time + 1_000_000, "/imu_tool", bags.imu(time, [getattr(row, name) for name in FORCE])


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return bags.write(tmp_path_factory.mktemp("bags") / "run", sorted(recording(), key=lambda m: m[0]), mode="storage")


@pytest.fixture
def robot_file(tmp_path):
    shutil.copy(FOLDER / "robot.urdf", tmp_path)
    sources = "sources: {joints: /joint_states, imu: {tool_acc: /imu_tool}}\n"
    (tmp_path / "robot.yaml").write_text((FOLDER / "robot.yaml").read_text() + sources)
    return tmp_path / "robot.yaml"


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("little", [True, False], ids=["little-endian", "big-endian"])
def test_every_number_of_a_message_is_that_of_rosbags(kind, little, tmp_path):
    random = np.random.default_rng(KINDS.index(kind))
    messages = [bags.message(kind, random) for _ in range(8)]
    topics = [(number, "/topic", message) for number, message in enumerate(messages)]
    storage, mode = FORMS[KINDS.index(kind) % len(FORMS)]
    path = bags.write(tmp_path / "bag", topics, storage, mode, little=little)
    theirs = [dict(bags.numbers(message)) for message in bags.read(path)]
    paths = sorted(set().union(*theirs))
    (series,) = Bag(path).read([Wanted("/topic", paths)])
    assert len(series.received) == len(messages)
    for field, column in zip(paths, series.columns, strict=True):
        reference = np.array([numbers.get(field, np.nan) for numbers in theirs])
        there = np.array([field in numbers for numbers in theirs])
        np.testing.assert_array_equal(column.view("u8")[there], reference.view("u8")[there], err_msg=field)
        assert np.isnan(column[~there]).all()


@pytest.mark.parametrize(("storage", "mode"), FORMS)
def test_every_form_of_a_bag_holds_the_same(storage, mode, tmp_path, bag):
    path = bags.write(tmp_path / "bag", recording(), storage, mode)
    ours, reference = (
        bag_table(Bag(p), SourcesConfig(**SOURCES), None, ()).to_arrow().to_pandas() for p in (path, bag)
    )
    assert len(ours) > 2000
    pd.testing.assert_frame_equal(ours, reference, check_exact=True)


def test_a_log_of_a_bag_is_that_of_its_tables(bag, robot_file):
    robot = Robot.load(robot_file)
    log = Log.read(bag, robot, allow_gaps=True)
    motors = [f"{signal}_{name}" for signal in ("theta", "dtheta", "tau") for name in NAMES]
    parts = [WHOLE[["t", *motors]].iloc[::2], WHOLE[["t", *FORCE]].iloc[1::3]]
    reference = Log.merge(parts, robot)
    np.testing.assert_allclose(log.t, reference.t - reference.t[0], rtol=0, atol=1.1e-9)
    for signal in ("theta", "dtheta", "tau", "acceleration"):
        np.testing.assert_array_equal(getattr(log, signal), getattr(reference, signal))
    pieces = list(Log.stream(bag, robot, 700, allow_gaps=True))
    np.testing.assert_array_equal(np.concatenate([piece.theta for piece in pieces]), log.theta)


def test_from_a_bag_to_an_estimate(bag, robot_file, tmp_path):
    """`sources` of robot.yaml alone, or `convert` before: the same estimate, as good as from the whole recording."""
    direct, log, through = tmp_path / "direct.parquet", tmp_path / "log.parquet", tmp_path / "through.parquet"
    done = linkside("estimate", robot_file, bag, "--with", "ekf", "--out", direct)
    assert done.exit_code == 0, done.stderr
    options = ("--joints", "/joint_states", "--imu", "tool_acc=/imu_tool")
    converted = linkside("convert", bag, *options, "--out", log)
    assert converted.exit_code == 0, converted.stderr
    assert "t = 0 is 2023-11-14 22:13:20.123456789 UTC" in converted.output
    assert re.search(r"theta_axis2 +1000 Hz", converted.output)
    assert re.search(r"tool_acc_x +666\.667 Hz", converted.output)
    assert pq.read_schema(log).metadata[b"linkside.origin_ns"] == str(START).encode()
    assert linkside("estimate", robot_file, log, "--with", "ekf", "--out", through).exit_code == 0
    pd.testing.assert_frame_equal(pd.read_parquet(direct), pd.read_parquet(through))
    estimate = Estimate.read(direct)
    assert estimate.error_against(FOLDER / "truth.parquet").tool_rms_mm < 0.02
    by_robot = linkside("convert", bag, "--robot", robot_file, "--out", tmp_path / "by_robot.parquet")
    assert by_robot.exit_code == 0, by_robot.stderr
    columns = pd.read_parquet(log).columns.drop(["tool_acc_wx", "tool_acc_wy", "tool_acc_wz"])
    pd.testing.assert_frame_equal(
        pd.read_parquet(tmp_path / "by_robot.parquet")[columns], pd.read_parquet(log)[columns]
    )


def test_an_estimate_is_made_anew_when_a_file_of_its_bag_changes(bag, robot_file, tmp_path):
    own = tmp_path / "bag"
    shutil.copytree(bag, own)
    command = (
        "estimate",
        robot_file,
        own,
        "--with",
        "ekf",
        "--out",
        tmp_path / "e.parquet",
        "--skip-existing",
        "--json",
    )
    states = [json.loads(linkside(*command).stdout)["up_to_date"] for _ in range(2)]
    (file,) = own.glob("*.mcap")
    with file.open("ab") as end:
        end.write(b" ")
    assert [*states, json.loads(linkside(*command).stdout)["up_to_date"]] == [False, True, False]


def test_convert_without_options_tells_what_is_there(bag):
    told = linkside("convert", bag)
    assert told.exit_code == 0
    assert re.search(r"/imu_tool .*sensor_msgs/msg/Imu .*\d+ .*--imu NAME=/imu_tool", told.output)
    assert re.search(r"/joint_states .*sensor_msgs/msg/JointState .*--joints /joint_states", told.output)


def test_a_robot_without_sources_is_told_what_to_add(bag):
    with pytest.raises(LogError, match=r"add `sources: \{joints: /joint_states, imu: \{SENSOR: /imu_tool\}\}`"):
        Log.read(bag, Robot.load(FOLDER / "robot.yaml"))


def test_arrays_of_any_message_are_taken_by_name_and_fields_by_path(tmp_path):
    force = bags.wrench(START + 5_000_000, (1, 2, 3), (4, 5, 6))
    point = bags.STORE.types["trajectory_msgs/msg/JointTrajectoryPoint"]
    state = bags.STORE.types["trajectory_msgs/msg/JointTrajectory"]
    empty, span = np.zeros(0), bags.STORE.types["builtin_interfaces/msg/Duration"](0, 0)
    goals = [point(np.array([0.1 * k, 0.2 * k]), empty, empty, empty, span) for k in range(2)]
    topics = [(START + k, "/goal", state(bags.header(START + 5_000_000 * k), ["b", "a"], goals)) for k in range(3)] + [
        (START, "/ft", force),
        (START, "/ft", bags.wrench(START + 10_000_000, (7, 8, 9), (1, 1, 1))),
    ]
    path = bags.write(tmp_path / "bag", topics)
    fields = {"second": "/goal:points[1].positions[0]", "torque_a": "/ft:wrench.torque.z"}
    by = SourcesConfig(fields=fields, wrench={"ft": "/ft"})
    table = bag_table(Bag(path), by, None, ()).to_arrow().to_pandas()
    assert table.second.tolist() == [0.1, 0.1, 0.1]
    assert table.ft_fx.dropna().tolist() == [1, 7]
    assert table.torque_a.dropna().tolist() == table.ft_tz.dropna().tolist() == [6, 1]
    with pytest.raises(LogError, match=r"'points' is an array of messages: an array of numbers is expected"):
        bag_table(Bag(path), SourcesConfig(joints={"topic": "/goal", "names": "joint_names", "q": "points"}), None, ())


def test_joints_of_several_publishers_and_orders_are_one_table(tmp_path):
    """An arm and its gripper publish on one topic; an order of names may change; some have no velocity."""
    times = [START + 1_000_000 * k for k in range(6)]
    topics = [
        (times[0], "/js", bags.joint_state(times[0], ["a", "b"], [1, 2], [10, 20])),
        (times[0], "/js", bags.joint_state(times[0], ["grip"], [0.5])),
        (times[2], "/js", bags.joint_state(times[2], ["b", "a"], [4, 3])),
        (times[4], "/js", bags.joint_state(times[4], ["grip", "a", "b"], [0.7, 5, 6], [0, 50, 60])),
        (times[3], "/js", bags.joint_state(times[3], ["grip"], [0.6])),
        (times[5], "/js", bags.joint_state(times[2], ["a"], [99.0])),  # a stamp that was there before
    ]
    path = bags.write(tmp_path / "bag", topics)
    with pytest.warns(RecordingWarning) as said:
        table = bag_table(Bag(path), SourcesConfig(joints="/js"), None, ()).to_arrow().to_pandas()
    words = " ".join(str(warning.message) for warning in said)
    assert "2 messages are older than the one before" in words
    assert "1 readings repeat a stamp" in words
    nan = np.nan
    np.testing.assert_allclose(table.t, [0, 0.002, 0.003, 0.004], atol=1e-12)
    np.testing.assert_array_equal(table.theta_a, [1, 3, nan, 5])
    np.testing.assert_array_equal(table.theta_b, [2, 4, nan, 6])
    np.testing.assert_array_equal(table.theta_grip, [0.5, nan, 0.6, 0.7])
    np.testing.assert_array_equal(table.dtheta_b, [20, nan, nan, 60])
    assert not [column for column in table if column.startswith("tau_")]  # nobody measured that
    mine = bag_table_of("theta_a", "theta_b", "t", path=path)
    assert mine.columns.tolist() == ["t", "theta_a", "theta_b"]
    assert len(mine) == 3  # the gripper alone makes no row


def bag_table_of(*columns, path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordingWarning)
        return bag_table(Bag(path), SourcesConfig(joints="/js"), columns, ()).to_arrow().to_pandas()


def test_stamps_are_those_of_headers_and_an_imu_says_what_it_lacks(tmp_path):
    late = [(START + 10**9 - k, "/imu", bags.imu(START + k * 10**6, (k, 0, 9.8), no_rate=True)) for k in range(4)]
    path = bags.write(tmp_path / "bag", late)
    table = bag_table(Bag(path), SourcesConfig(imu={"acc": "/imu"}), None, ()).to_arrow().to_pandas()
    assert table.columns.tolist() == ["t", "acc_x", "acc_y", "acc_z"]
    np.testing.assert_allclose(table.t, [0, 0.001, 0.002, 0.003], atol=1e-12)


@pytest.mark.parametrize("kind", ["std_msgs/msg/Float64", "sensor_msgs/msg/FluidPressure"])
def test_without_stamps_times_of_recording_are_taken_with_a_word(kind, tmp_path):
    types = bags.STORE.types
    value = types[kind](2.5) if kind.endswith("64") else types[kind](bags.header(0), 2.5, 0.0)
    path = bags.write(tmp_path / "bag", [(START + k * 10**6, "/value", value) for k in range(3)])
    field = "/value:data" if kind.endswith("64") else "/value:fluid_pressure"
    with pytest.warns(RecordingWarning, match="the times when they were recorded are taken"):
        table = bag_table(Bag(path), SourcesConfig(fields={"value": field}), None, ()).to_arrow().to_pandas()
    np.testing.assert_allclose(table.t, [0, 0.001, 0.002], atol=1e-12)


def write_chunks(path, count, compression, size):
    """An MCAP file of the reference library, with checksums and chunks of a size."""
    kind = "sensor_msgs/msg/JointState"
    writer = McapWriter(str(path), chunk_size=size, compression=compression)
    writer.start("ros2", "test")
    text = bags.STORE.generate_msgdef(kind, ros_version=2)[0].encode()
    schema = writer.register_schema(kind, "ros2msg", text)
    channel = writer.register_channel("/js", "cdr", schema)
    for k in range(count):
        content = bags.joint_state(START + k * 10**6, ["a"], [float(k)])
        data = bytes(bags.STORE.serialize_cdr(content, kind))
        writer.add_message(channel, START + k * 10**6, data, START + k * 10**6)
    writer.finish()


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE])
def test_a_bag_that_was_cut_off_is_read_up_to_its_last_whole_chunk(compression, tmp_path):
    path = tmp_path / "cut.mcap"
    write_chunks(path, 1000, compression, 5000)
    whole = path.read_bytes()
    assert bag_table_of("theta_a", path=path).theta_a.tolist() == list(range(1000))
    counts = []
    for share in (0.9, 0.5, 0.2):
        path.write_bytes(whole[: int(share * len(whole))])
        with pytest.warns(RecordingWarning, match="was cut off: it is read up to its last whole chunk"):
            found = bag_table(Bag(path), SourcesConfig(joints="/js"), None, ()).to_arrow().to_pandas()
        assert found.theta_a.tolist() == list(range(len(found)))
        counts.append(len(found))
    assert 1000 > counts[0] > counts[1] > counts[2] > 50


def test_a_damaged_chunk_is_left_out_with_a_word(tmp_path):
    path = tmp_path / "damaged.mcap"
    write_chunks(path, 1000, CompressionType.NONE, 20_000)
    whole = bytearray(path.read_bytes())
    whole[len(whole) // 2] ^= 1
    path.write_bytes(whole)
    with pytest.warns(RecordingWarning, match="1 damaged chunks are left out, the first at byte"):
        found = bag_table(Bag(path), SourcesConfig(joints="/js"), None, ()).to_arrow().to_pandas()
    assert 500 < len(found) < 1000


def test_an_sqlite_bag_of_ros_humble_has_no_definitions(tmp_path):
    path = bags.write(tmp_path / "bag", [(START, "/js", bags.joint_state(START, ["a"], [1.5]))], "sqlite3")
    (file,) = path.glob("*.db3")
    with sqlite3.connect(file) as database:
        database.execute("DROP TABLE message_definitions")
    database.close()
    assert bag_table_of("theta_a", path=path).theta_a.tolist() == [1.5]
    (path / "metadata.yaml").unlink()  # as after a crash of the recorder
    assert bag_table_of("theta_a", path=path).theta_a.tolist() == [1.5]
    assert bag_table_of("theta_a", path=file).theta_a.tolist() == [1.5]


def test_known_definitions_are_those_of_ros(tmp_path):
    """Of types that the reader knows by itself: the same paths lead to the same numbers with and without the text."""
    random = np.random.default_rng(4)
    kinds = ["sensor_msgs/msg/Imu", "geometry_msgs/msg/WrenchStamped", "std_msgs/msg/Float64MultiArray"]
    kinds += ["geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/AccelStamped"]
    messages = {f"/{kind}": bags.message(kind, random, (3, 4)) for kind in kinds}
    path = bags.write(tmp_path / "bag", [(0, topic, message) for topic, message in messages.items()], "sqlite3")
    wanted = [Wanted(topic, [path for path, _ in bags.numbers(message)]) for topic, message in messages.items()]
    told = Bag(path).read(wanted)
    (file,) = path.glob("*.db3")
    with sqlite3.connect(file) as database:
        database.execute("DELETE FROM message_definitions")
    database.close()
    for with_text, without in zip(told, Bag(path).read(wanted), strict=True):
        np.testing.assert_array_equal(np.array(without.columns), np.array(with_text.columns))


def test_files_of_a_split_recording_are_one(tmp_path):
    folder = tmp_path / "bag"
    folder.mkdir()
    for number in (10, 9):  # by name 10 comes first
        file = folder / f"bag_{number}.mcap"
        write_chunks(file, 100, CompressionType.ZSTD, 10_000)
    series = Bag(folder).read([Wanted("/js", ["position"], "name")])[0]
    assert len(series.received) == 200
    assert series.names == ["a"]


def refused(path, pattern, **sources):
    with pytest.raises(LogError, match=pattern) as refusal:
        bag_table(Bag(path), SourcesConfig(**(sources or SOURCES)), None, ())
    assert "\n" not in str(refusal.value)


def test_what_cannot_be_taken_is_one_line(bag, tmp_path):
    refused(bag, r"no message of topic '/joints'; there is /imu_tool \(sensor_msgs/msg/Imu\)", joints="/joints")
    refused(
        bag,
        r"'linear.x' is no field: in place of 'linear' there are header, orient",
        fields={"a": "/imu_tool:linear.x"},
    )
    refused(bag, r"is a message: one number is expected", fields={"a": "/imu_tool:linear_acceleration"})
    refused(bag, r"is a text: one number is expected", fields={"a": "/imu_tool:header.frame_id"})
    refused(bag, r"has an index beyond an array of 9 numbers", fields={"a": "/imu_tool:orientation_covariance[9]"})
    refused(bag, r"'\[x' is no path|'x' is no index|is no path", fields={"a": "/imu_tool:orientation_covariance[x"})
    refused(tmp_path / "none.mcap", "no such file")
    (tmp_path / "text.mcap").write_text("t,theta\n0,1\n")
    refused(tmp_path / "text.mcap", "this is not an MCAP file")
    (tmp_path / "one.mcap").write_bytes(b"#ROSBAG V2.0\n")
    refused(tmp_path / "one.mcap", "a bag of ROS 1")
    (tmp_path / "text.db3").write_text("t,theta\n0,1\n")
    refused(tmp_path / "text.db3", "cannot be read as SQLite")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder/metadata.yaml").write_text("a: [")
    refused(tmp_path / "folder", "this is not YAML")


def test_the_command_line_says_what_is_missing(bag, tmp_path):
    out = tmp_path / "log.parquet"
    for arguments, words in (
        (("--joints", "/joint_states"), "--out is missing"),
        (("--out", out), "nothing to take"),
        (("--imu", "/imu_tool", "--out", out), "expected NAME=VALUE"),
        (("--field", "a=/imu_tool", "--out", out), "expected TOPIC:PATH"),
        (("--joints", "/joint_states:x=position", "--out", out), "unknown key"),
        (("--joints", "/joint_states", "--out", bag), "a file that ends in .parquet or .csv"),
    ):
        done = linkside("convert", bag, *arguments)
        assert (done.exit_code, done.stderr.count("\n")) == (2, 1), done.stderr
        assert words in done.stderr
    assert not out.exists()


def test_what_is_a_bag(tmp_path, bag):
    assert is_bag(bag)
    assert is_bag("x.mcap")
    assert is_bag("x.db3.zstd")
    assert not is_bag(tmp_path)
    assert not is_bag("log.parquet")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("mutated")
    write_chunks(folder / "small.mcap", 30, CompressionType.ZSTD, 1000)
    bags.write(folder / "bag", [(START, "/js", bags.joint_state(START, ["a"], [1.5]))] * 30, "sqlite3")
    (database,) = (folder / "bag").glob("*.db3")
    return [(folder / "small.mcap").read_bytes(), database.read_bytes()], folder


@settings(max_examples=150, deadline=None)
@given(data=st.data(), kind=st.sampled_from([0, 1]))
def test_mutated_bags_are_read_or_refused(files, data, kind):
    """Bytes changed, cut, doubled: a table or one line."""
    whole, folder = files[0][kind], files[1]
    places = sorted(data.draw(st.lists(st.integers(0, len(whole)), min_size=2, max_size=6)))
    pieces = [whole[: places[0]], *(whole[a:b] for a, b in pairwise(places)), whole[places[-1] :]]
    noise = data.draw(st.lists(st.binary(max_size=9), min_size=len(pieces), max_size=len(pieces)))
    order = data.draw(st.permutations(range(len(pieces))) | st.just(range(len(pieces))))
    path = folder / ("mutated.mcap", "mutated.db3")[kind]
    path.write_bytes(b"".join(pieces[at] + noise[at] for at in order))
    with warnings.catch_warnings(), suppress(LogError):
        warnings.simplefilter("ignore", RecordingWarning)
        bag_table(Bag(path), SourcesConfig(joints="/js"), None, ())


def test_sources_of_robot_yaml_are_checked(tmp_path, robot_file):
    text = robot_file.read_text().replace("imu: {tool_acc", "imus: {tool_acc")
    robot_file.write_text(text)
    with pytest.raises(ValueError, match=r"robot.yaml:\d+: sources.imus: unknown key; did you mean 'imu'\?"):
        Robot.load(robot_file)
    assert ExtendedKalmanFilter(Robot.load(FOLDER / "robot.yaml"))
