"""What the sensors see: against the map of `linkside.sensors`, and the singular postures known in closed form."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkside import Log, Robot, demo, sensors
from linkside.figures import save
from linkside.observability import CheckReport, Observability, check
from linkside.observability.analysis import LOG_ROWS
from linkside.observability.result import describe

from .robots import ARM, DATA, spring

RECORDINGS = [demo.FOLDER, DATA / "arm2_square"]
SENSOR = {"name": "acc", "link": "fore", "xyz": [0, 0, 0.4], "noise_std": 0.1}


def load(folder):
    return Robot.load(folder / "robot.yaml")


def arm(**settings):
    return Robot.from_urdf(ARM, [spring("shoulder"), spring("elbow")], **settings)


@pytest.fixture(scope="module")
def report() -> CheckReport:
    robot = Robot.load(demo.ROBOT)
    return check(robot, Log.read(demo.LOG, robot))


@pytest.mark.parametrize("folder", RECORDINGS, ids=lambda folder: folder.name)
def test_many_postures_are_seen_as_each_one_is(folder):
    robot = load(folder)
    q = np.random.default_rng(0).uniform(-3, 3, (20, robot.n))
    observability = Observability.of(robot, q)
    for row, one in enumerate(sensors.acceleration_map(robot, posture) for posture in q):
        np.testing.assert_allclose(observability.values[row], one.singular_values, rtol=1e-9)
        np.testing.assert_allclose(observability.joints[row], one.acceleration_std, rtol=1e-9)
        np.testing.assert_allclose(observability.condition[row], one.condition, rtol=1e-9)
        np.testing.assert_allclose(abs(observability.directions[row, -1] @ one.worst_direction), 1, rtol=1e-9)


@pytest.mark.parametrize("axes", ["x", "xz", "xy"])
def test_what_no_axis_sees_is_seen_as_the_map_of_one_posture_says(axes):
    robot = arm(accelerometers=[SENSOR | {"link": "upper", "axes": axes}])
    observability, one = Observability.of(robot, np.zeros((1, 2))), sensors.acceleration_map(robot, [0, 0])
    np.testing.assert_allclose(observability.values[0], one.singular_values, atol=1e-12)
    np.testing.assert_array_equal(observability.joints[0], one.acceleration_std)
    assert observability.condition[0] == one.condition == np.inf


def test_both_singular_families_of_a_six_axis_arm_are_found(report):
    """De Luca, Schröder, Thümmel 2007, Fig. 2: the sensor above axis 1, and in the plane of axes 2 and 3."""
    assert [posture.words for posture in report.singular] == ["a1 alone", "a2 against a3"]
    above, stretched = (frames(report.robot, posture.q) for posture in report.singular)
    assert abs(reach(above)) < 1e-5 < 0.1 < abs(reach(stretched))
    assert abs(out_of_plane(stretched)) < 1e-5 < 0.01 < abs(out_of_plane(above))


def frames(robot, q):
    """Origins of axes 1 to 3 and of the sensor, and the direction of axis 2."""
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.to_pinocchio(q))
    (sensor,) = robot.accelerometers
    link = data.oMf[robot.model.getFrameId(sensor.link)]
    origins = [data.oMi[robot.model.getJointId(name)].translation for name in ("a1", "a2", "a3")]
    axis = data.oMi[robot.model.getJointId("a2")].rotation[:, 1]
    return *origins, link.act(np.array(sensor.xyz)), axis


def reach(where):
    """Distance of the sensor from axis 1, in the direction in which the arm reaches."""
    first, _, _, sensor, axis = where
    return (sensor - first) @ np.cross(axis, [0, 0, 1])


def out_of_plane(where):
    """Distance of the sensor from the plane of the parallel axes 2 and 3."""
    _, second, third, sensor, axis = where
    normal = np.cross(axis, third - second)
    return (sensor - third) @ normal / np.linalg.norm(normal)


def test_the_refined_posture_is_no_better_than_any_drawn(report):
    assert min(posture.worst for posture in report.postures) >= report.observability.worst.max()


def test_joints_that_do_not_matter_are_known(report):
    names = [report.robot.names[joint] for joint in report.influential]
    assert names == ["a3", "a2", "a4"]
    assert report.to_text().count("any") == 3 * len(report.singular)


def test_the_log_is_looked_at_row_by_row(report):
    log = Log.read(demo.LOG, report.robot)
    assert report.path is not None
    np.testing.assert_array_equal(report.path.t, log.t)
    np.testing.assert_allclose(report.path.worst, Observability.of(report.robot, log.theta).worst, rtol=1e-12)
    np.testing.assert_array_equal(report.home, np.median(log.theta, axis=0))
    streamed = check(report.robot, Log.stream(demo.LOG, report.robot, rows=300))
    np.testing.assert_array_equal(streamed.path.joints, report.path.joints)
    assert streamed.to_text() == report.to_text()


def test_rows_without_motor_positions_are_left_out_and_long_logs_thinned(monkeypatch):
    robot = Robot.load(demo.ROBOT)
    log = Log.read(demo.LOG, robot)
    columns = {f"theta_{name}": log.theta[:, joint].copy() for joint, name in enumerate(robot.names)}
    columns["theta_a2"][10:20] = np.nan
    monkeypatch.setattr("linkside.observability.analysis.LOG_ROWS", 500)
    report = check(robot, Log.from_table({"t": log.t} | columns, robot))
    assert 300 < len(report.path.t) <= 500 < LOG_ROWS
    assert np.isfinite(report.path.worst).all()


def test_the_same_report_each_time():
    robot = load(DATA / "arm2_square")
    assert check(robot).to_text() == check(robot).to_text()


def test_limits_of_the_urdf_bound_the_workspace():
    narrow = ARM.replace('lower="-3" upper="3"', 'lower="0.5" upper="1"', 1)
    endless = narrow.replace('name="elbow" type="revolute"', 'name="elbow" type="continuous"')
    robot = Robot.from_urdf(endless, [spring("elbow"), spring("shoulder")], accelerometers=[SENSOR])
    np.testing.assert_allclose(check(robot).limits, [[-np.pi, 0.5], [np.pi, 1]])


def test_a_prismatic_joint_is_told_in_metres():
    sliding = ARM.replace('name="elbow" type="revolute"', 'name="elbow" type="prismatic"')
    robot = Robot.from_urdf(sliding, [spring("shoulder"), spring("elbow")], accelerometers=[SENSOR])
    assert "elbow [m]" in check(robot).to_text()


def test_a_posture_free_of_singularities_is_still_the_worst():
    """Two sensors, one a link: their accelerations tell the joints apart whatever the posture."""
    robot = arm(accelerometers=[SENSOR, SENSOR | {"name": "low", "link": "upper"}])
    report = check(robot)
    assert report.singular == ()
    assert len(report.postures) == 1
    assert report.postures[0].worst == pytest.approx(report.observability.worst.max(), rel=1e-3)
    assert "No singular posture was found" in report.to_text()


@pytest.mark.parametrize(
    ("accelerometers", "words"),
    [
        ([], "The robot has no accelerometer"),
        ([SENSOR | {"axes": "x"}], "Too few axes: 1 cannot distinguish 2 link accelerations"),
        ([SENSOR | {"link": "upper"}], "in no posture do they distinguish all link accelerations"),
    ],
)
def test_a_robot_that_cannot_see_is_told_so(tmp_path, accelerometers, words):
    report = check(arm(accelerometers=accelerometers))
    assert not report.observable
    assert words in report.to_text()
    save(report.figure(), tmp_path / "words.png")


def test_a_joint_that_is_never_seen_is_named():
    text = check(arm(accelerometers=[SENSOR | {"link": "upper"}])).to_text()
    (row,) = (line for line in text.splitlines() if line.startswith("│ elbow"))
    assert "never observed" in row
    (row,) = (line for line in text.splitlines() if line.startswith("│ shoulder"))
    assert "observed in every posture" in row


def test_a_robot_without_elastic_joints_needs_no_accelerometer(tmp_path):
    rigid = [{"name": "shoulder", "elastic": False}, {"name": "elbow", "elastic": False}]
    report = check(Robot.from_urdf(ARM, rigid, accelerometers=[SENSOR]))
    assert "No joint is elastic" in report.to_text()
    save(report.figure(), tmp_path / "words.svg")


def test_a_robot_of_one_joint_has_a_curve(tmp_path):
    robot = Robot.from_urdf(ARM, [spring("elbow")], accelerometers=[SENSOR])
    report = check(robot)
    assert report.influential.size == 0
    assert report.postures[0].words == "elbow alone"
    save(report.figure(), tmp_path / "curve.pdf")


@pytest.mark.parametrize("folder", RECORDINGS, ids=lambda folder: folder.name)
def test_figures_draw(tmp_path, folder):
    robot = load(folder)
    for log in (None, Log.stream(folder / "log.parquet", robot)):
        save(check(robot, log).figure(), tmp_path / "check.png")
        assert (tmp_path / "check.png").stat().st_size > 20_000


@pytest.mark.parametrize(
    ("direction", "words"),
    [
        ([1, 0.1, 0], "a alone"),
        ([0, -0.5, 0.8], "b against c"),
        ([0.5, 0, 0.8], "a and c together"),
        ([0.5, -0.6, 0.6], "a and c against b"),
        ([-0.5, -0.6, 0.6], "a and b against c"),
    ],
)
def test_directions_in_words(direction, words):
    assert describe(("a", "b", "c"), np.array(direction)) == words
    assert describe(("a", "b", "c"), -np.array(direction)) == words


@given(st.lists(st.floats(-3, 3), min_size=2, max_size=2))
@settings(max_examples=30, deadline=None)
def test_deviations_are_those_of_the_covariance(q):
    robot = arm(accelerometers=[SENSOR])
    observability = Observability.of(robot, np.array([q]))
    if observability.values[0, -1] > 1e-3:
        matrix = robot.acceleration_map(q, [0, 0])[0] / 0.1
        np.testing.assert_allclose(observability.joints[0] ** 2, np.diag(np.linalg.inv(matrix.T @ matrix)), rtol=1e-5)
