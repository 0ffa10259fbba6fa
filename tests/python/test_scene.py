"""Robots in motion for Rerun and MCAP: poses are Pinocchio's, signals are the estimate's, nothing half written."""

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from rerun.chunk import RrdReader

from linkside import Estimate, EstimatorError, ExtendedKalmanFilter, Log, Robot, cli
from linkside.errors import OutputError
from linkside.recording.estimate import Status
from linkside.robot.kinematics import body_poses
from linkside.scene import write_scene
from linkside.scene.shapes import looks, sticks

from . import gallery

FOLDER = Path(__file__).parents[1] / "data/arm2_square"
LOG, TRUTH = FOLDER / "log.parquet", FOLDER / "truth.parquet"
ARM = Robot.load(FOLDER / "robot.yaml")


@pytest.fixture(scope="module")
def estimated(tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "estimate.parquet"
    estimate = ExtendedKalmanFilter(ARM).run(Log.read(LOG, ARM))
    estimate.status[700:] |= np.uint8(Status.GATED)
    estimate.write(path)
    return path


@pytest.mark.parametrize("name", gallery.BUILT)
def test_poses_are_pinocchios(name):
    robot = gallery.robot(name)
    q = np.random.default_rng(0).uniform(-2, 2, (7, robot.n))
    poses = body_poses(robot, q)
    assert set(poses) == set(robot.names)
    data = robot.model.createData()
    for row, state in enumerate(robot.to_pinocchio(q)):
        pin.forwardKinematics(robot.model, data, state)
        for joint, pose in poses.items():
            want = data.oMi[robot.model.getJointId(joint)]
            np.testing.assert_allclose(pose.rotation[row], want.rotation, atol=1e-12)
            np.testing.assert_allclose(pose.translation[row], want.translation, atol=1e-12)
            quaternion = pin.Quaternion(want.rotation).coeffs()
            assert abs(quaternion @ pose.quaternion[row]) == pytest.approx(1, abs=1e-12)


def test_sticks_reach_the_tool():
    """The last body's stick ends where the robot says that its tool is."""
    q = np.array([[0.4, -0.7]])
    pose = body_poses(ARM, q)["axis3"]
    (end,) = sticks(ARM)["axis3"]
    np.testing.assert_allclose(pose.translation[0] + pose.rotation[0] @ end, ARM.tool_position(q[0]), atol=1e-12)


def columns(path):
    """Every chunk of a recording: rows of its columns, by entity."""
    found = {}
    for chunk in RrdReader(path).stream():
        table = chunk.to_record_batch().to_pydict()
        found.setdefault(chunk.entity_path, []).append((chunk.is_static, table))
    return found


def of(found, entity, component):
    """Times [s] and values of a component, in the order of time."""
    times, values = [], []
    for static, table in found[entity]:
        for name, cells in table.items():
            if name.endswith(component) and not static:
                times += [
                    time.total_seconds() if hasattr(time, "total_seconds") else time / 1e9 for time in table["time"]
                ]
                values += cells
    order = np.argsort(times)
    return np.array(times)[order], np.array(values, float)[order].squeeze()


def test_a_rerun_recording_shows_the_estimate(tmp_path, estimated):
    out = tmp_path / "motion.rrd"
    write_scene(ARM, LOG, estimated, out, urdf=FOLDER / "robot.urdf", rate=200)
    found, estimate = columns(out), Estimate.read(estimated)
    rows = estimate[::10]
    for root, q in (("links", rows.q), ("motors", rows.theta)):
        for joint, pose in body_poses(ARM, q).items():
            t, places = of(found, f"/robot/{root}/{joint}", "translation")
            np.testing.assert_allclose(t, rows.t, atol=1e-6)
            np.testing.assert_allclose(places, pose.translation, atol=1e-6)
            _, turns = of(found, f"/robot/{root}/{joint}", "quaternion")
            np.testing.assert_allclose(np.abs((turns * pose.quaternion).sum(axis=1)), 1, atol=1e-6)
    _, places = of(found, "/tool/of_links", "positions")
    np.testing.assert_allclose(places, rows.tool_position, atol=1e-6)
    _, sizes = of(found, "/tool/two_sigma", "half_sizes")
    np.testing.assert_allclose(sizes, 2 * np.maximum(rows.tool_std, 1e-6), rtol=1e-5)
    for index, joint in enumerate(ARM.names):
        _, torsion = of(found, f"/torsion/{joint}", "scalars")
        np.testing.assert_allclose(torsion, (rows.q - rows.theta)[:, index], atol=1e-12)
    _, status = of(found, "/status", "scalars")
    np.testing.assert_array_equal(status, rows.status)
    _, nis = of(found, "/nis", "scalars")
    np.testing.assert_allclose(nis, rows.nis)
    assert {"/residual/theta_axis2", "/residual/tool_acc_x", "/status_in_words", "/tool/path_of_links"} <= set(found)
    words = [
        cell
        for _, table in found["/status_in_words"]
        for name, cells in table.items()
        if "text" in name
        for cell in cells
    ]
    assert words == [["good"], ["gated"]]


def test_an_mcap_file_has_the_estimate(tmp_path, estimated):
    out = tmp_path / "motion.mcap"
    write_scene(ARM, LOG, estimated, out, rate=100)
    rows = Estimate.read(estimated)[::20]
    messages = {}
    with out.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema.encoding == "jsonschema"
            properties = json.loads(schema.data).get("properties")
            content = json.loads(message.data)
            assert properties is None or set(content) <= set(properties), "a field that the schema does not have"
            messages.setdefault(channel.topic, []).append((message.log_time, content))
    assert set(messages) == {"/links", "/motors", "/tool", "/residuals", "/status", "/tf"}
    for found in messages.values():
        assert [time for time, _ in found] == np.round(1e9 * rows.t).astype(int).tolist()
    links = [content for _, content in messages["/links"]]
    for index, joint in enumerate(ARM.names):
        assert [one["q"][joint] for one in links] == rows.q[:, index].tolist()
        assert [one["q_std"][joint] for one in links] == rows.q_std[:, index].tolist()
        pose = body_poses(ARM, rows.q)[joint]
        frames = [{f["child_frame_id"]: f for f in content["transforms"]} for _, content in messages["/tf"]]
        placed = [list(frame[f"link {joint}"]["translation"].values()) for frame in frames]
        np.testing.assert_allclose(placed, pose.translation, atol=1e-12)
    assert [content["words"] for _, content in messages["/status"]].count("gated") == sum(rows.status != 0)
    tools = [list(content["position"].values()) for _, content in messages["/tool"]]
    np.testing.assert_array_equal(tools, rows.tool_position)


def test_a_truth_without_motors_or_deviations(tmp_path):
    """NaN is left out of both files."""
    table = pd.read_parquet(TRUTH)
    table.drop(columns=[c for c in table if c.startswith(("theta", "dtheta", "tool_std"))]).to_parquet(
        tmp_path / "t.parquet"
    )
    for suffix in (".rrd", ".mcap"):
        write_scene(ARM, LOG, tmp_path / "t.parquet", tmp_path / f"x{suffix}", rate=20)
    found = columns(tmp_path / "x.rrd")
    assert "/tool/of_links" in found
    assert not any("motors" in entity for entity in found if entity.startswith("/tool/"))


def test_shapes_of_a_urdf(tmp_path):
    shutil.copy(FOLDER / "robot.urdf", tmp_path)
    links = [frame.name for frame in ARM.model.frames if frame.type == pin.FrameType.BODY and frame.parentJoint > 0]
    shape = """<visual><origin xyz="0.1 0 0" rpy="0 0 1"/><geometry>{}</geometry></visual>"""
    shapes = [
        '<box size="1 2 3"/>',
        '<cylinder radius="0.1" length="2"/>',
        '<sphere radius="0.2"/>',
        '<sphere radius="x"/>',
    ]
    shapes += ['<mesh filename="package://arm/m.stl" scale="1 1 2"/>', '<mesh filename="gone.stl"/>']
    text = (tmp_path / "robot.urdf").read_text()
    head, tail = text.split(f'<link name="{links[-1]}">', 1)
    more = "".join(map(shape.format, shapes))
    (tmp_path / "robot.urdf").write_text(f'{head}<link name="{links[-1]}">{more}{tail}')
    (tmp_path / "arm").mkdir()
    (tmp_path / "arm/m.stl").write_bytes(b"solid m\nendsolid m\n")
    found = looks(ARM, tmp_path / "robot.urdf")
    assert [(one.kind, one.size) for one in found.shapes] == [
        ("box", (1, 2, 3)),
        ("cylinder", (0.1, 2)),
        ("sphere", (0.2,)),
        ("mesh", (1, 1, 2)),
    ]
    assert found.missing == ["gone.stl"]
    assert {one.body for one in found.shapes} == {ARM.names[-1]}
    frame = ARM.model.frames[ARM.model.getFrameId(links[-1])]
    want = frame.placement * pin.SE3(pin.rpy.rpyToMatrix(0, 0, 1), np.array([0.1, 0, 0]))
    placement = found.shapes[0].placement
    assert pin.SE3(placement.rotation, placement.translation).isApprox(want)
    write_scene(ARM, LOG, TRUTH, tmp_path / "x.rrd", urdf=tmp_path / "robot.urdf", rate=5)
    entities = columns(tmp_path / "x.rrd")
    for root in ("links", "motors"):
        drawn = {entity.rpartition("/")[2] for entity in entities if entity.startswith(f"/robot/{root}/axis3/")}
        assert {"box", "cylinder", "sphere", "mesh"} <= drawn


def test_on_the_command_line(tmp_path, estimated, monkeypatch):
    def run(*arguments):
        return CliRunner().invoke(cli.main, ["view", str(FOLDER / "robot.yaml"), *map(str, arguments)])

    out = tmp_path / "x.rrd"
    done = run(LOG, estimated, "--out", out, "--rate", 50)
    assert done.exit_code == 0, done.output
    assert out.exists()
    for words, arguments in (
        ("its times are not those of", (LOG, TRUTH.with_name("short.parquet"), "--out", tmp_path / "y.rrd")),
        ("a file that ends in .rrd or .mcap", (LOG, estimated, "--out", tmp_path / "y.txt")),
        ("rate", (LOG, estimated, "--out", tmp_path / "y.rrd", "--rate", 0)),
    ):
        paths = [tmp_path / "short.parquet" if str(a).endswith("short.parquet") else a for a in arguments]
        Estimate.read(TRUTH)[:100].write(tmp_path / "short.parquet")
        done = run(*paths)
        assert done.exit_code == 2
        assert words in done.output
    for module, suffix in (("rerun", "rrd"), ("mcap.writer", "mcap")):
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, module, None)
            with pytest.raises(EstimatorError, match=r"pip install 'linkside\["):
                write_scene(ARM, LOG, estimated, tmp_path / f"y.{suffix}")
    with pytest.raises(OutputError):
        write_scene(ARM, LOG, estimated, tmp_path / "nowhere/y.rrd")
    assert not [path for path in tmp_path.iterdir() if path.stem == "y"], "something half written"
