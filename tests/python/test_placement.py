"""Placement of accelerometers: the paper's arm in closed form, every set looked at, refusals, the command line."""

from itertools import combinations

import numpy as np
import pinocchio as pin
import pytest
from ruamel.yaml import YAML

import linkside
from linkside import ConfigError, EstimatorError, Log, Robot
from linkside.cli import main
from linkside.observability import Observability, Placement, candidates, place, read_candidates

from .robots import ARM, DATA, spring

LONG = DATA / "kr15_long"
ROBOT = Robot.load(LONG / "robot.yaml")
LOGS = [
    Log.read(LONG / "log.parquet", ROBOT),
    Log.read(linkside.demo.LOG, Robot.load(linkside.demo.ROBOT)),
]


@pytest.fixture(scope="module")
def placed():
    return place(ROBOT, candidates(ROBOT, ["link2", "link3", "link4"]), LOGS)


def mounted(robot, sensors):
    return Robot(robot.config.model_copy(update={"accelerometers": tuple(sensors)}), robot.tree)


def test_a_better_place_than_the_recordings_sensor_is_found(placed):
    q = np.concatenate([log.theta for log in LOGS])
    own, chosen = Observability.of(ROBOT, q).condition.max(), Observability.of(placed.robot, q).condition.max()
    assert chosen < 0.5 * own
    assert placed.score == pytest.approx(chosen, rel=0.02)  # postures are thinned out
    assert placed.before == pytest.approx(own, rel=0.02)


def test_both_singular_postures_of_the_paper_are_marked(placed):
    """De Luca, Schröder, Thümmel 2007, Fig. 2: sensor in the plane of axes 2 and 3, and sensor on axis 1."""
    postures = placed.report.singular
    assert len(postures) == 2
    on_axis, in_plane = postures
    shoulder, elbow, sensor, axis = geometry(placed, on_axis.q)
    assert abs(np.cross([0, 0, 1], axis) @ sensor) < 1e-5  # axis 1 is the base frame's z
    shoulder, elbow, sensor, axis = geometry(placed, in_plane.q)
    assert abs(np.cross(axis, elbow - shoulder) @ (sensor - shoulder)) < 1e-5
    marks = placed.figure().axes[0].get_legend().get_texts()
    assert {text.get_text() for text in marks} >= {f"singular: {p.words}" for p in postures}
    assert "singular for a1 alone" in placed.to_text()


def geometry(placed, q):
    """Points on axes 2 and 3, the sensor, and the direction of both axes, in the base frame."""
    model, data = ROBOT.model, ROBOT.model.createData()
    pin.computeJointJacobians(model, data, ROBOT.to_pinocchio(q))
    sensor = placed.chosen[0]
    frame = model.frames[model.getFrameId(sensor.link, pin.FrameType.BODY)]
    place = data.oMi[frame.parentJoint] * frame.placement
    shoulder, elbow = (data.oMi[model.getJointId(name)] for name in ("a2", "a3"))
    axis = data.J[3:, ROBOT.velocity_index[1]]
    return shoulder.translation, elbow.translation, place.act(np.array(sensor.xyz)), axis


def test_every_set_is_looked_at_where_they_are_few():
    sensors = candidates(ROBOT, ["link3", "link4"], steps=2, reach=0.2)
    q = LOGS[0].theta[::200].copy()
    found = place(ROBOT, sensors, q, count=2)
    scores = {
        chosen: Observability.of(mounted(ROBOT, [sensors[i] for i in chosen]), q).condition.max()
        for chosen in combinations(range(len(sensors)), 2)
    }
    best = min(scores, key=scores.__getitem__)
    assert found.score == pytest.approx(scores[best], rel=1e-6)
    assert found.alone[best[0]] == pytest.approx(
        Observability.of(mounted(ROBOT, [sensors[best[0]]]), q).condition.max()
    )


def test_exchange_is_nearly_as_good_as_every_set(monkeypatch):
    sensors = candidates(ROBOT, ["link2", "link3", "link4"], steps=2, axes=("x", "y", "z"))[::2]
    every = place(ROBOT, sensors, LOGS[0], count=3)
    monkeypatch.setattr("linkside.observability.placement_search.EVERY_SET", 10)
    exchanged = place(ROBOT, sensors, LOGS[0], count=3)
    monkeypatch.setattr("linkside.observability.placement_search.EVERY_SET", 10**6)
    assert place(ROBOT, sensors, LOGS[0], count=3).score <= min(every.score, exchanged.score) * (1 + 1e-9)
    assert exchanged.score < 1.3 * place(ROBOT, sensors, LOGS[0], count=3).score


def test_expected_variance_is_that_of_least_squares():
    sensors = candidates(ROBOT, ["link4"], steps=2)
    q = LOGS[0].theta[::400].copy()
    found = place(ROBOT, sensors, q, criterion="covariance")
    matrix = found.robot.acceleration_map(q, 0 * q)[0][:, :, ROBOT.elastic] / found.chosen[0].noise_std
    variances = [np.trace(np.linalg.inv(m.T @ m)) for m in matrix]
    assert found.score == pytest.approx(np.sqrt(np.mean(variances)))


def test_single_axes_and_orientations_are_chosen_among():
    turned = candidates(ROBOT, ["link3"], steps=2, axes=("x", "y", "z"), rpy=[(0, 0, 0), (0, 0.8, 0)])
    found = place(ROBOT, turned, LOGS[0])
    assert len(found.chosen) == 3
    assert np.isfinite(found.score)
    straight = place(ROBOT, [s for s in turned if s.rpy == (0, 0, 0)], LOGS[0])
    assert found.score <= 1.3 * straight.score


def test_the_smallest_set_that_is_good_enough():
    sensors = candidates(ROBOT, ["link3", "link4"], steps=2, reach=0.2)
    one = place(ROBOT, sensors, LOGS[0])
    assert len(place(ROBOT, sensors, LOGS[0], limit=1.01 * one.score).chosen) == 1
    two = place(ROBOT, sensors, LOGS[0], limit=0.95 * one.score)
    assert len(two.chosen) == 2
    with pytest.raises(EstimatorError, match=r"no set of up to 2 .* of 1 or less; the best of 2 has"):
        place(ROBOT, sensors, LOGS[0], limit=1.0, count=2)


def test_the_workspace_counts_where_no_posture_is_given():
    found = place(ROBOT, candidates(ROBOT, ["link3"], steps=2))
    assert found.q.shape == (256, 6)
    assert np.isfinite(found.score)


@pytest.mark.parametrize(
    ("sensors", "words"),
    [
        (candidates(ROBOT, ["link1"]), r"no candidate sees joint 'a2'.* \(link2, link3, .*off its axis"),
        (candidates(ROBOT, ["link4"], axes=("x",), steps=1), "all candidates together do not tell"),
        ([], "no candidate; name links"),
        ([{"name": "s", "link": "base_link", "noise_std": 0.05}], "no joint moves a link 'base_link'"),
    ],
)
def test_candidates_that_cannot_do_are_refused(sensors, words):
    with pytest.raises(EstimatorError, match=words):
        place(ROBOT, sensors, LOGS)


def test_a_joint_seen_by_nobody_because_all_are_on_its_axis():
    arm = Robot.from_urdf(ARM, [spring("shoulder"), spring("elbow")])
    on_axes = [{"name": "s", "link": link, "noise_std": 0.1} for link in ("upper", "fore")]
    with pytest.raises(EstimatorError, match=r"joint 'elbow'; add one on a link that it carries \(fore, hand\)"):
        place(arm, on_axes)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"count": 0}, "count is 0, expected 1 to 8"),
        ({"count": 9}, "count is 9"),
        ({"criterion": "trace"}, "expected one of condition, covariance"),
        ({"postures": np.zeros((3, 2))}, r"expected finite positions \(T, 6\), got shape \(3, 2\)"),
        ({"postures": np.full((3, 6), np.nan)}, "expected finite"),
    ],
)
def test_settings_that_cannot_be_used_are_refused(options, words):
    with pytest.raises(EstimatorError, match=words):
        place(ROBOT, candidates(ROBOT, ["link3"], steps=2), **options)


def test_what_is_written_can_be_read(placed, tmp_path):
    assert isinstance(placed, Placement)
    placed.write(tmp_path / "sensors.yaml")
    assert read_candidates(tmp_path / "sensors.yaml") == placed.chosen
    (tmp_path / "bad.yaml").write_text("accelerometers:\n- {name: a, link: b, nose_std: 1}\n")
    with pytest.raises(ConfigError, match=r"bad\.yaml:2"):
        read_candidates(tmp_path / "bad.yaml")


def test_command_line(tmp_path, capsys):
    out, figure = tmp_path / "sensors.yaml", tmp_path / "place.png"
    grid = ["--link", "link3", "--link", "link4", "--steps", "2"]
    files = ["--out", str(out), "--figure", str(figure)]
    with pytest.raises(SystemExit, match="0"):
        main(["place", str(LONG / "robot.yaml"), str(LONG / "log.parquet"), *grid, *files])
    text = capsys.readouterr().out
    assert "worst condition number" in text
    assert figure.stat().st_size > 10_000
    assert len(YAML().load(out.read_text())["accelerometers"]) == 1
    with pytest.raises(SystemExit, match="2"):
        main(["place", str(LONG / "robot.yaml"), "--link", "link1"])
    assert "no candidate sees joint 'a2'" in capsys.readouterr().err


def test_spares_may_fail_whichever_they_are():
    offered = candidates(ROBOT, ["link2", "link3"], reach=0.2, steps=2)
    q = np.concatenate([log.theta for log in LOGS])[::200]
    found = place(ROBOT, offered, q, spares=1)
    assert len(found.chosen) == 2
    losses = [Observability.of(mounted(ROBOT, [left]), q).condition.max() for left in found.chosen]
    assert found.left == pytest.approx(max(losses), rel=1e-9)
    assert found.score == pytest.approx(Observability.of(found.robot, q).condition.max(), rel=1e-9)
    # Every pair, looked at: none is better when the one that it needs more has failed.
    alone = [Observability.of(mounted(ROBOT, [sensor]), q).condition.max() for sensor in offered]
    assert found.left == pytest.approx(min(max(pair) for pair in combinations(alone, 2)), rel=1e-9)
    assert f"after the worst loss of 1 of 2 sensors: {found.left:.3g}" in found.to_text()


def test_spares_count_within_a_limit_and_are_fewer_than_sensors():
    offered = candidates(ROBOT, ["link2", "link3"], reach=0.2, steps=2)
    q = LOGS[0].theta[::200]
    without, spare = (place(ROBOT, offered, q, limit=8.0, spares=spares) for spares in (0, 1))
    assert len(spare.chosen) > len(without.chosen)
    assert spare.left <= 8.0
    with pytest.raises(EstimatorError, match="count is 1, expected 2, one more than spares, to 16"):
        place(ROBOT, offered, q, count=1, spares=1)
    with pytest.raises(EstimatorError, match="spares is 16, expected 0 to 15"):
        place(ROBOT, offered, q, spares=16)
