"""Planned motions keep their limits; their standard errors are those that they state, smaller than of plain motions."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import scipy.optimize
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from linkside import EstimatorError, Log, Robot, cli, simulate
from linkside.calibration import calibrate
from linkside.control.controllers import JointPD
from linkside.control.trajectories import rest_to_rest
from linkside.excitation import Limits, MotorMotion, excite, expected_errors
from linkside.excitation.series import FourierSeries

from .robots import ARM, DATA, EXAMPLES

VELOCITY, TORQUE = {"axis2": 2.0, "axis3": 3.0}, {"axis2": 6000.0, "axis3": 2500.0}
SPRINGS = ("stiffness_axis2", "stiffness_axis3")
RATE = 500.0


@pytest.fixture(scope="module")
def robot():
    return Robot.load(DATA / "arm2_square/robot.yaml")


@pytest.fixture(scope="module")
def limits(robot):
    return Limits.of(robot, velocity=VELOCITY, torque=TORQUE)


@pytest.fixture(scope="module")
def planned(robot, limits):
    return excite(robot, limits=limits, duration=4.0, rate=RATE, evaluations=40)


def linkside(*arguments):
    return CliRunner().invoke(cli.main, list(map(str, arguments)))


def recorded(true, motion, seed):
    """What the sensors of a robot read whose motors follow a motion."""
    hold = true.gravity_torque(motion.theta[0])
    inertia = [d.motor_inertia for d in true.drives] + np.diag(true.mass_matrix(motion.theta[:1])[0])
    control = JointPD(6400 * inertia, 112 * inertia, motion.t, motion.theta, hold)
    start = motion.theta[0] - hold / [d.stiffness for d in true.drives]
    moved = {"q": start, "theta": motion.theta[0], "substeps": 4, "seed": seed}
    return simulate(true, control, motion.t[-1], 1 / motion.period, **moved).log


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), duration=st.floats(2, 20), bandwidth=st.floats(3, 9))
def test_a_series_is_at_rest_at_its_ends_and_within_its_bounds(seed, duration, bandwidth):
    series = FourierSeries(duration, bandwidth)
    x = np.random.default_rng(seed).standard_normal((series.size, 2))
    ends, speed = series(np.array([0.0, duration]), x), series.bounds(x)
    assert np.abs(ends[0]).max() <= 1e-9 * speed[0].max()
    assert np.abs(ends[1]).max() <= 1e-9 * speed[1].max()
    assert np.abs(ends[2]).max() <= 1e-9 * speed[2].max()
    t = np.random.default_rng(seed).uniform(0, duration, 1000)
    assert np.all(np.abs(series(t, x)).max(axis=1) <= speed)
    step = 1e-5
    ahead, behind = series(t + step, x), series(t - step, x)
    assert (ahead[0] - behind[0]) / (2 * step) == pytest.approx(series(t, x)[1], abs=1e-5 * speed[1].max())
    assert (ahead[1] - behind[1]) / (2 * step) == pytest.approx(series(t, x)[2], abs=1e-5 * speed[2].max())


def test_a_series_bound_is_close():
    """By SciPy's search for the largest value."""
    series = FourierSeries(4.0, 5.0)
    x = np.random.default_rng(1).standard_normal((series.size, 1))
    t = np.linspace(0, 4, 5000)
    for order, bound in enumerate(series.bounds(x)[:, 0]):
        near = t[np.abs(series(t, x)[order, :, 0]).argmax()]
        found = scipy.optimize.minimize_scalar(
            lambda s, k=order: -abs(series(np.array([s]), x)[k, 0, 0]), bounds=(near - 0.01, near + 0.01)
        )
        assert -found.fun <= bound <= -1.006 * found.fun


def test_limits_are_kept(robot, limits, planned):
    motion = planned.motion
    low, high = limits.position
    assert np.all((motion.theta >= low) & (motion.theta <= high))
    assert np.abs(motion.theta - motion.theta[0]).max() <= 0.5
    assert np.all(np.abs(motion.dtheta).max(axis=0) <= limits.velocity)
    assert np.all(np.abs(planned.torque).max(axis=0) <= limits.torque)
    for rows in (slice(0, 100), slice(-100, None)):
        assert np.abs(motion.dtheta[rows]).max() < 1e-9
    assert np.gradient(motion.theta, motion.period, axis=0)[1:-1] == pytest.approx(motion.dtheta[1:-1], abs=2e-3)


def test_torques_are_those_of_a_simulation(robot, planned):
    """By the simulator, which integrates both equations of motion; there its controller adds a little."""
    log = recorded(robot, planned.motion, 0)
    assert np.abs(log.theta - planned.motion.theta).max() < 0.01
    peaks = np.abs(log.tau).max(axis=0), np.abs(planned.torque).max(axis=0)
    assert peaks[0] == pytest.approx(peaks[1], rel=0.1)


def test_accelerations_and_ranges_that_are_given_are_kept(robot):
    limits = Limits.of(
        robot, ranges={"axis2": (-0.2, 0.1)}, velocity=VELOCITY, acceleration={"axis2": 3.0, "axis3": 5.0}
    )
    posture = {"axis2": -0.05, "axis3": 1.0}
    plan = excite(robot, limits=limits, duration=4.0, rate=RATE, evaluations=2, posture=posture, reach=0.3)
    assert plan.motion.theta[0] == pytest.approx([-0.05, 1.0])
    assert np.abs(plan.motion.theta - plan.motion.theta[0]).max(axis=0) == pytest.approx([0.15, 0.3], rel=0.9)
    assert np.all(np.abs(plan.motion.theta - plan.motion.theta[0]).max(axis=0) <= [0.15, 0.3])
    assert np.all(np.abs(plan.motion.ddtheta).max(axis=0) <= [3.0, 5.0])


def test_torque_is_used_up_to_its_limit(robot):
    limits = Limits.of(robot, velocity=VELOCITY, torque={"axis2": 1500.0, "axis3": 900.0})
    plan = excite(robot, limits=limits, duration=4.0, rate=RATE, evaluations=2)
    assert 0.8 < (np.abs(plan.torque).max(axis=0) / limits.torque).max() <= 1


def test_one_by_one_moves_one_joint_at_a_time(robot, limits):
    plan = excite(robot, limits=limits, duration=4.0, rate=RATE, evaluations=4, one_by_one=True)
    moves = np.abs(plan.motion.dtheta) > 1e-6
    assert not moves.all(axis=1).any()
    assert np.all(moves.sum(axis=0) > 0.4 * 4.0 * RATE)


def plain(robot, limits, seconds, rate):
    """From rest to rest and back, twice, all joints at once, as fast as the same limits allow."""
    goal = 0.5 * np.ones(robot.n)
    path = rest_to_rest([0 * goal, goal, 0 * goal, goal, 0 * goal], seconds / 4, 1 / rate)
    motion = MotorMotion(path.t, path.q, path.dq, path.ddq)
    share = min(1.0, float((limits.velocity / np.abs(motion.dtheta).max(axis=0)).min()))
    return replace(motion, theta=share * motion.theta, dtheta=share * motion.dtheta, ddtheta=share * motion.ddtheta)


def as_log(robot, motion, path):
    """A motion as a file has it."""
    columns = {"t": motion.t} | {f"theta_{name}": x for name, x in zip(robot.names, motion.theta.T, strict=True)}
    return Log.from_table(columns, robot, str(path), check=False)


def test_it_tells_more_than_a_plain_motion(robot, limits, planned):
    log = as_log(robot, plain(robot, limits, 4.0, RATE), "plain")
    other = expected_errors(robot, log)
    for name in SPRINGS:
        assert planned.after.error(name) < other.error(name) / 3
    assert set(other.identifiable) < set(planned.after.identifiable)


def test_what_is_foretold_is_what_a_calibration_finds(robot, planned):
    """Of a robot whose springs and dampings are not as robot.yaml says."""
    factors = {"axis2": (0.88, 1.3), "axis3": (1.15, 0.7)}
    joints = [
        d.model_copy(update={"stiffness": d.stiffness * factors[d.name][0], "damping": d.damping * factors[d.name][1]})
        for d in robot.drives
    ]
    true = Robot(robot.config.model_copy(update={"joints": tuple(joints)}), robot.tree)
    found = calibrate(robot, recorded(true, planned.motion, 1))
    assert found.accepted
    told = [e for e in found.estimates if e.parameter.name in planned.after.identifiable]
    assert len(told) >= 14
    assert {"translation_tool_acc_y", "scale_tool_acc_y"} <= found.refused.keys() & planned.after.reasons.keys()
    ratio = [e.std / planned.after.error(e.parameter.name) for e in told]
    assert 0.5 < np.median(ratio) < 1.5
    truth = {f"stiffness_{d.name}": d.stiffness for d in true.drives} | {
        f"damping_{d.name}": d.damping for d in true.drives
    }
    off = [
        (e.value - truth.get(e.parameter.name, e.parameter.start)) / planned.after.error(e.parameter.name)
        for e in told
        if e.parameter.kind not in ("payload_mass", "cubic_stiffness", "time_constant", "delay")
    ]
    assert np.abs(off).max() < 3.5
    assert 0.3 < np.sqrt(np.mean(np.square(off))) < 1.6


def test_a_second_motion_tells_what_a_recording_cannot(robot, limits, planned):
    """A recording in which one joint stood still tells nothing of its spring; the next one does."""
    motion = planned.motion
    theta = motion.theta.copy()
    theta[:, 1] = theta[0, 1]
    log = as_log(robot, replace(motion, theta=theta), "still")
    before = expected_errors(robot, log)
    assert "its joint does not move" in before.reasons["stiffness_axis3"]
    plan = excite(robot, log, limits=limits, duration=4.0, rate=RATE, evaluations=2)
    assert plan.before.reasons.keys() == before.reasons.keys()
    assert "stiffness_axis3" in plan.after.identifiable
    assert plan.after.error("stiffness_axis2") < before.error("stiffness_axis2")


def test_the_same_seed_gives_the_same_motion(robot, limits, planned):
    again = excite(robot, limits=limits, duration=4.0, rate=RATE, evaluations=40)
    assert np.array_equal(again.motion.theta, planned.motion.theta)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The arm with limits in its URDF, its logs in degrees and of the motors' shafts."""
    monkeypatch.chdir(tmp_path)
    urdf = (
        (DATA / "arm2_square/robot.urdf").read_text().replace('effort="1e5" velocity="20"', 'effort="6e3" velocity="2"')
    )
    (tmp_path / "robot.urdf").write_text(urdf)
    text = (DATA / "arm2_square/robot.yaml").read_text()
    text = text.replace("rate_hz: 2000.0", "rate_hz: 500")
    (tmp_path / "robot.yaml").write_text(text + "\ncolumns: {motor_side: true}\nunits: {theta: deg}\n")
    return tmp_path


def test_the_command_writes_a_log_of_the_motion_and_its_figure(folder):
    options = ("--duration", 3, "--evaluations", 2)
    done = linkside("excite", "robot.yaml", "--out", "motion.csv", "--figure", "motion.svg", *options)
    assert done.exit_code == 0, done.stderr
    assert "stiffness_axis2" in done.stdout
    assert "translation_tool_acc_y" in done.stdout
    assert "not identifiable" in done.stdout
    robot = Robot.load("robot.yaml")
    log = Log.read("motion.csv", robot)
    same = excite(robot, duration=3.0, evaluations=2)
    assert log.theta == pytest.approx(same.motion.theta, abs=1e-12)
    assert log.ddqref == pytest.approx(same.motion.ddtheta, abs=1e-9)
    assert (folder / "motion.svg").stat().st_size < 2e6
    told = linkside("excite", "robot.yaml", "motion.csv")
    assert told.exit_code == 0, told.stderr
    assert f"{len(expected_errors(robot, log).identifiable)} of 22 parameters are identifiable" in told.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "--out is missing"),
        (("--out", "m.json"), "ends in .parquet or .csv"),
        (("--out", "m.csv", "--velocity", "axis9=1"), "velocity: no joint 'axis9'; did you mean"),
        (("--out", "m.csv", "--torque", "axis2=0"), "torque of 'axis2': expected a limit greater than 0"),
        (("--out", "m.csv", "--range", "axis2=1:0"), "1 to 0 leave no position"),
        (("--out", "m.csv", "--range", "axis2=1"), "expected JOINT=LOW:HIGH"),
        (("--out", "m.csv", "--posture", "axis2=9"), "9 is not between its limits"),
        (("--out", "m.csv", "--torque", "axis2=20", "--posture", "axis2=0.1"), "cannot hold the robot in the posture"),
        (("--out", "m.csv", "--duration", "0.1"), "fewer than 6 periods"),
        (("--out", "m.csv", "--bandwidth", "400"), "bandwidth is 400 Hz"),
        (("--out", "m.csv", "--free", "colour"), "no parameter of this robot"),
    ],
)
def test_what_cannot_be_planned_is_refused(folder, arguments, words):
    done = linkside("excite", "robot.yaml", *arguments)
    assert done.exit_code == 2
    assert words in " ".join(done.stderr.split())
    assert not (folder / "m.csv").exists()


def test_a_robot_without_sensors_or_limits_is_refused(robot):
    with pytest.raises(EstimatorError, match="joints axis2, axis3: the URDF has no limit of effort"):
        excite(robot)
    joints = [{"name": name, "stiffness": 1e4, "motor_inertia": 1.0} for name in ("shoulder", "elbow")]
    with pytest.raises(EstimatorError, match="no sensor behind the springs"):
        excite(Robot.from_urdf(ARM, joints))


def starter_robot(folder, file, links):
    from linkside.robot.starter import starter

    text = starter(EXAMPLES / file, folder / "robot.yaml")
    sensors = "\n".join(f"- {{name: acc{i}, link: {link}, xyz: [0.05, 0.04, 0.1]}}" for i, link in enumerate(links))
    (folder / "robot.yaml").write_text(text.replace("accelerometers: []", f"accelerometers:\n{sensors}"))
    return Robot.load(folder / "robot.yaml")


def test_limits_are_those_that_pinocchio_reads(tmp_path):
    file = "ur_description/urdf/ur10_robot.urdf"
    robot, model = starter_robot(tmp_path, file, ["wrist_3_link"]), pin.buildModelFromUrdf(str(EXAMPLES / file))
    for of in (robot, Robot.from_pinocchio(model, robot.config.joints, accelerometers=robot.accelerometers)):
        limits = Limits.of(of)
        assert limits.velocity == pytest.approx(model.velocityLimit)
        assert limits.torque == pytest.approx(model.effortLimit)
    assert robot.model.velocityLimit == pytest.approx(model.velocityLimit)
    assert robot.model.effortLimit == pytest.approx(model.effortLimit)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "links"),
    [
        ("ur_description/urdf/ur10_robot.urdf", ("forearm_link", "wrist_3_link")),
        ("panda_description/urdf/panda.urdf", ("panda_link4", "panda_link7")),
        ("kinova_description/robots/kinova.urdf", ("j2s6s200_link_3", "j2s6s200_link_6")),
    ],
)
def test_public_arms_are_told_more_than_by_a_plain_motion(tmp_path, file, links):
    robot = starter_robot(tmp_path, file, links)
    limits = Limits.of(robot)
    plan = excite(robot, limits=limits, evaluations=60)
    used = np.abs(plan.torque).max(axis=0) / limits.torque
    assert used.max() <= 1
    assert np.all(np.abs(plan.motion.dtheta).max(axis=0) <= limits.velocity)
    motion = plain(robot, limits, 10.0, 1000.0)
    other = expected_errors(robot, as_log(robot, replace(motion, theta=motion.theta + plan.motion.theta[0]), "plain"))
    springs = [i for i, p in enumerate(plan.after.parameters) if p.kind == "stiffness"]
    ratio = plan.after.std[springs] / other.std[springs]
    assert np.exp(np.log(ratio).mean()) < 0.5
    assert len(plan.after.identifiable) > len(other.identifiable)
