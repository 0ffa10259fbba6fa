"""Calibration against recordings of known robots, closed forms, and chance; what cannot be calibrated is refused."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
from click.testing import CliRunner

from linkside import Estimate, ExtendedKalmanFilter, Log, Noise, RauchTungStriebelSmoother, Robot, _core, cli
from linkside.calibration import calibrate, resume
from linkside.calibration.parameters import choose
from linkside.calibration.prepared import recordings
from linkside.calibration.problem import Problem, bare
from linkside.calibration.response import ResponseProblem
from linkside.calibration.search import Step
from linkside.calibration.signals import derivative, signals
from linkside.calibration.uncertainty import Alone, Uncertainty, compare, long_run
from linkside.errors import ConfigError, EstimatorError, LogError
from linkside.robot.considered import considered
from linkside.robot.correlations import matrix

DATA = Path(__file__).parents[1] / "data"
MISMATCH = DATA / "arm2_square_mismatch"
FREE = ["stiffness", "damping", "sensor_noise"]


def load(folder, **changes):
    robot = Robot.load(folder / "robot.yaml")
    if changes:
        robot = Robot(robot.config.model_copy(update=changes), robot.tree)
    return robot, Log.read(folder / "log.parquet", robot)


@pytest.fixture(scope="module")
def calibrated():
    robot, log = load(MISMATCH)
    return calibrate(robot, log)


def tool_error(method, path):
    robot = Robot.load(path)
    estimate = method(robot).run(Log.read(MISMATCH / "log.parquet", robot))
    error = estimate.tool_position - Estimate.read(MISMATCH / "truth.parquet").tool_position
    return 1e3 * np.sqrt(np.mean(np.sum((error - error.mean(axis=0)) ** 2, axis=1)))


def test_the_likelihood_is_that_of_the_filter():
    robot, log = load(DATA / "arm2_square")
    log = log[:600]
    filtered = ExtendedKalmanFilter(robot, start="rest", tolerances=False)
    noise = filtered.noise.for_log(log, robot).arrays(robot, ("motor", "acceleration"))
    settings = {"noise": noise, "biased": [True] * 5, "fixed": [], "huber": np.inf}
    ours = _core.Likelihood(robot.core, signals(robot, log), **settings).log_likelihood([], [])
    assert ours == pytest.approx(filtered.run(log).log_likelihood.sum(), rel=1e-9)


def test_a_wrong_robot_is_put_right_from_its_recording_alone(calibrated, tmp_path):
    calibrated.write(MISMATCH / "robot.yaml", tmp_path / "robot.yaml")
    assert tool_error(ExtendedKalmanFilter, tmp_path / "robot.yaml") < 0.06
    assert tool_error(RauchTungStriebelSmoother, tmp_path / "robot.yaml") < 0.03
    # Motions of a link show stiffness over inertia: links are 5 % heavier than the model has them.
    assert calibrated["stiffness_axis2"].value == pytest.approx(0.92 / 1.05 * 4.5e5, rel=0.01)
    assert calibrated["damping_axis2"].value == pytest.approx(1.4 / 1.05 * 500, rel=0.05)
    assert calibrated["cubic_stiffness_axis2"].value == pytest.approx(5000 / 1.05 * 4.5e5, rel=0.02)
    assert calibrated["payload_mass"].value == pytest.approx(4 / 1.05, abs=3 * calibrated["payload_mass"].std)
    assert calibrated.after.log_likelihood > calibrated.before.log_likelihood + 1e3


def misjudged(robot, factor):
    joints = tuple(j.model_copy(update={"stiffness": factor * j.stiffness}) for j in robot.drives)
    return Robot(robot.config.model_copy(update={"joints": joints}), robot.tree)


def test_motor_torques_alone_tell_springs_and_motors():
    true, log = load(DATA / "arm2_square", accelerometers=())
    found = calibrate(misjudged(true, 1.4), log[:2000], ["stiffness", "damping", "motor_inertia", "viscous", "coulomb"])
    assert found.accepted
    truth = {p.name: p.start for p in choose(true, None, True, {})}
    for e in found.estimates:
        assert abs(e.value - truth[e.parameter.name]) < 3 * e.std
    assert found["stiffness_axis2"].std < 0.05 * 4.5e5


@pytest.mark.parametrize("factor", [0.6, 1.4])
def test_a_nominal_stiffness_far_off_comes_right(factor):
    robot, log = load(DATA / "arm2_square")
    found = calibrate(misjudged(robot, factor), log, FREE)
    assert found["stiffness_axis2"].value == pytest.approx(4.5e5, rel=0.01)
    assert found["stiffness_axis3"].value == pytest.approx(3e5, rel=0.02)


ARM = """<robot name="one"><link name="base"/><link name="arm"><inertial><origin xyz="0.4 0 0"/><mass value="5"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.2"/></inertial></link><joint name="j" type="revolute">
<parent link="base"/><child link="arm"/><axis xyz="0 0 1"/><limit effort="1" velocity="1"/></joint></robot>"""
INERTIA = 0.2 + 5 * 0.4**2


def one_joint(stiffness, encoder, mass=1.0):
    return Robot.from_urdf(
        ARM.replace('value="5"', f'value="{5 / mass}"').replace('"0.2"', f'"{0.2 / mass}"'),
        [{"name": "j", "stiffness": stiffness, "damping": 0.0, "motor_inertia": 1.0}],
        encoder={"resolution": encoder},
        accelerometers=[{"name": "a", "link": "arm", "xyz": [0.5, 0, 0], "axes": "xy", "noise_std": 0.05}],
    )


def smooth(stiffness, nominal, encoder=1e-6, mass=1.0, seed=0):
    """Rest to rest along 35 s⁴ − 84 s⁵ + 70 s⁶ − 20 s⁷, which leaves no vibration, there and back; no damping."""
    rng, period, length = np.random.default_rng(seed), 1e-3, 0.6
    t = period * np.arange(3 * round(length / period))
    s = np.clip(np.abs((t / length + 1.5) % 3 - 1.5) - 0.25, 0, 1)
    there = np.polynomial.Polynomial([0, 0, 0, 0, 35, -84, 70, -20])
    sign = np.where((t / length) % 3 < 1.5, 1, -1)
    q, dq, ddq = (0.8 * there.deriv(k)(s) * (sign / length) ** k for k in range(3))
    robot = one_joint(nominal, encoder, mass)
    noise = rng.normal(0, 0.05, (2, len(t)))
    theta = np.round((q + INERTIA * ddq / stiffness) / encoder) * encoder
    columns = {"t": t, "theta_j": theta, "a_x": noise[0] - 0.5 * dq**2, "a_y": noise[1] + 0.5 * ddq}
    return robot, Log.from_table(columns, robot)


def test_an_arm_that_rings_for_ever_has_no_damping():
    """Along 0.2 (1 − cos 9t), by the solution in closed form; a damping of 1e-6 of the stiffness would show."""
    rng, t, w, own = np.random.default_rng(0), 1e-3 * np.arange(2000), 9.0, np.sqrt(6000 / INERTIA)
    swing = np.cos(w * t) - np.cos(own * t)
    dq = 0.2 * w * own**2 / (own**2 - w**2) * (np.sin(w * t) - w / own * np.sin(own * t))
    ddq = 0.2 * (w * own) ** 2 / (own**2 - w**2) * swing
    noise = rng.normal(0, 0.05, (2, len(t)))
    robot = one_joint(5000.0, 1e-6)
    columns = {"t": t, "theta_j": np.round(0.2e6 * (1 - np.cos(w * t))) / 1e6}
    columns |= {"a_x": noise[0] - 0.5 * dq**2, "a_y": noise[1] + 0.5 * ddq}
    found = calibrate(robot, Log.from_table(columns, robot), ["stiffness", "damping"])
    assert found.accepted
    assert abs(found["stiffness_j"].value - 6000) < 3 * found["stiffness_j"].std
    assert found["damping_j"].value < 1e-6 * 6000


@pytest.mark.parametrize("encoder", [1e-6, 1e-5, 1e-4])
@pytest.mark.parametrize("factor", [0.8, 1.0, 3.0])
def test_a_smooth_motion_tells_the_spring_too(factor, encoder):
    robot, log = smooth(6000.0, factor * 6000.0, encoder)
    found = calibrate(robot, log, ["stiffness", "sensor_noise"])["stiffness_j"]
    assert abs(found.value - 6000) < 4 * found.std
    assert found.std < 0.05 * 6000


def test_masses_that_are_wrong_show_in_the_stiffness():
    robot, log = smooth(6000.0, 6000.0, mass=1.05)
    found = calibrate(robot, log, ["stiffness", "sensor_noise"])["stiffness_j"]
    assert found.value / 6000 == pytest.approx(1 / 1.05, abs=0.02)


def test_motors_positions_by_themselves_tell_nothing():
    """However smooth the motion: what is maximised is the density of the other sensors' readings, given theirs."""
    robot, log = smooth(6000.0, 6000.0)
    silent = replace(log, acceleration=np.full_like(log.acceleration, np.nan))
    problem = Problem(robot, [silent], Noise(), choose(robot, ["stiffness"], False, {}))
    for z in (-3.0, 0.0, 8.0):
        assert problem.log_likelihood(np.array([z])) == pytest.approx(0, abs=1e-6)


def test_the_robot_file_keeps_its_comments_and_order(calibrated, tmp_path):
    text = (MISMATCH / "robot.yaml").read_text()
    text = text.replace("damping: 500.0", "damping: 500.0  # from the maker").replace("joints:", "# axes\njoints:")
    (tmp_path / "robot.yaml").write_text(text)
    shutil.copy(MISMATCH / "robot.urdf", tmp_path)
    (tmp_path / "new").mkdir()
    calibrated.write(tmp_path / "robot.yaml", tmp_path / "new/robot.yaml")
    found = (tmp_path / "new/robot.yaml").read_text()
    assert "# axes\njoints:" in found
    assert "# from the maker; ± " in found
    keys = [line.split(":")[0].strip() for line in text.splitlines() if line[:1].isalpha()]
    assert [k for k in (line.split(":")[0] for line in found.splitlines() if line[:1].isalpha()) if k in keys] == keys
    assert Robot.load(tmp_path / "new/robot.yaml").drives[0].stiffness == pytest.approx(
        calibrated["stiffness_axis2"].value, rel=1e-3
    )


def test_standard_errors_are_what_the_filters_reckon_with(calibrated, tmp_path):
    """From the outcome through the file to the standard deviations of an estimate."""
    shutil.copy(MISMATCH / "robot.urdf", tmp_path)
    calibrated.write(MISMATCH / "robot.yaml", tmp_path / "robot.yaml")
    robot = Robot.load(tmp_path / "robot.yaml")
    reckoned = {one.name: one.std for one in considered(robot)}
    names = ("stiffness_axis2", "cubic_stiffness_axis2", "damping_axis2", "stiffness_axis3", "damping_axis3")
    # A stiffness and a damping are uncertain by shares, hardening by its unit, beside what the whole spring is off by.
    hardening = calibrated["cubic_stiffness_axis2"].value
    at = [[e.parameter.name for e in calibrated.estimates].index(name) for name in names]
    unit = np.diag([calibrated.estimates[i].parameter.tolerance for i in at])
    unit[1, 0] = -hardening * unit[0, 0]
    expected = unit @ calibrated.uncertainty.covariance[np.ix_(at, at)] @ unit.T
    std = np.array([reckoned[name] for name in names])
    written = matrix(robot.config.tolerances.correlations, names) * np.outer(std, std)
    assert np.abs(scipy.linalg.eigvalsh(written, expected) - 1).max() < 0.12
    assert np.abs(matrix(robot.config.tolerances.correlations, names) - np.eye(len(names))).max() > 0.2
    log = Log.read(MISMATCH / "log.parquet", robot)[:400]
    guessed = robot.config.model_copy(update={"tolerances": Robot.load(MISMATCH / "robot.yaml").config.tolerances})
    wide, narrow = (ExtendedKalmanFilter(r).run(log).q_std[0] for r in (Robot(guessed, robot.tree), robot))
    assert np.all(narrow < 0.5 * wide)


def test_the_report_is_one_file(calibrated, tmp_path):
    calibrated.write_report(tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert page.count("<svg") == 4
    assert 'id="verdict"' in page
    assert all(e.parameter.name in page for e in calibrated.estimates)
    assert 'src="http' not in page
    text = calibrated.to_text()
    assert "stiffness_axis2" in text
    assert "log-likelihood" in text
    assert text.count("at its bound") == sum(e.at_bound for e in calibrated.estimates)
    assert "linkside excite robot.yaml log.parquet --out motion.parquet" in page


def test_a_profile_is_of_two_estimates(calibrated):
    with pytest.raises(EstimatorError, match="was not estimated; did you mean 'stiffness_axis"):
        calibrated.profile("stiffness_axis", "payload_mass")
    with pytest.raises(EstimatorError, match="twice"):
        calibrated.profile("payload_mass", "payload_mass")


def test_outliers_do_little():
    robot, log = load(DATA / "arm2_square")
    spoilt = log.theta[:1200].copy()
    spoilt[np.arange(50, 1200, 97), 0] += 0.02
    columns = {"t": log.t[:1200], "theta_axis2": spoilt[:, 0], "theta_axis3": log.theta[:1200, 1]}
    columns |= dict(zip(robot.acceleration_channels, log.acceleration[:1200].T, strict=True))
    columns |= {"dtheta_axis2": log.dtheta[:1200, 0], "dtheta_axis3": log.dtheta[:1200, 1]}
    with_them = calibrate(robot, Log.from_table(columns, robot), ["stiffness"])
    without = calibrate(robot, log[:1200], ["stiffness"])
    assert with_them["stiffness_axis2"].value == pytest.approx(without["stiffness_axis2"].value, rel=0.02)


def test_a_joint_that_does_not_move_is_left_as_it_is():
    robot, log = load(DATA / "arm2_square")
    columns = {"t": log.t[:800], "theta_axis2": log.theta[:800, 0], "theta_axis3": np.full(800, log.theta[0, 1])}
    columns |= dict(zip(robot.acceleration_channels, log.acceleration[:800].T, strict=True))
    found = calibrate(robot, Log.from_table(columns, robot), ["stiffness_axis3", "stiffness_axis2"])
    assert found.refused["stiffness_axis3"] == "its joint does not move"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"free": ["stifness"]}, "'stifness' is no parameter of this robot; did you mean 'stiffness'"),
        ({"free": ["coulomb"], "torque": False}, "shows in motor torque only"),
        ({"bounds": {"stiffness_axis2": (5e5, 4e5)}}, "leave no value"),
        ({"bounds": {"stiffness_axis2": (1e5, 2e5)}}, "leave out 450000"),
        ({"bounds": {"stiffness_axis9": (1, 2)}}, "'stiffness_axis9' is not free"),
        ({"logs": []}, "there is no log"),
    ],
)
def test_settings_that_make_no_sense_are_refused(arguments, message):
    robot, log = load(MISMATCH)
    with pytest.raises(EstimatorError, match=message):
        calibrate(robot, **{"logs": log[:100]} | arguments)


def table(robot, log, rows=400, **changes):
    columns = {"t": log.t[:rows]}
    columns |= {f"theta_{name}": log.theta[:rows, i] for i, name in enumerate(robot.names)}
    columns |= dict(zip(robot.acceleration_channels, log.acceleration[:rows].T, strict=True))
    return columns | changes


def test_recordings_that_tell_nothing_are_refused():
    robot, log = load(MISMATCH)
    still = table(robot, log, theta_axis2=np.full(400, 0.1), theta_axis3=np.full(400, 0.2))
    with pytest.raises(LogError, match="no elastic joint's motor moves"):
        calibrate(robot, Log.from_table(still, robot))
    clipped = table(
        robot, log, tool_acc_x=np.minimum(log.acceleration[:400, 0], np.quantile(log.acceleration[:400, 0], 0.5))
    )
    with pytest.raises(LogError, match="tool_acc_x stays at its extreme value"):
        calibrate(robot, Log.from_table(clipped, robot, check=False))
    no_torque = Log.from_table(table(robot, log), robot)
    with pytest.raises(LogError, match="'tau_axis2' is missing"):
        calibrate(robot, no_torque, torque=True)
    other, _ = load(DATA / "kr15_long")
    with pytest.raises(LogError, match="column 'theta_a1' is missing"):
        Log.from_table(table(robot, log), other)
    with pytest.raises(LogError, match="read for another robot, with the columns theta_axis2, theta_axis3; this one's"):
        calibrate(other, log)
    blind, _ = load(MISMATCH, accelerometers=())
    with pytest.raises(LogError, match="tool_acc_z; this one's for acceleration are none"):
        calibrate(blind, [log])


def test_a_robot_that_shows_nothing_is_refused():
    robot, log = load(MISMATCH, accelerometers=())
    with pytest.raises(EstimatorError, match="motor positions alone"):
        calibrate(robot, log, torque=False)
    rigid = tuple(joint.model_copy(update={"elastic": False}) for joint in robot.drives)
    robot, log = load(MISMATCH, joints=rigid)
    with pytest.raises(EstimatorError, match="no joint of the robot is elastic"):
        calibrate(robot, log)


def test_contradictory_recordings_are_told():
    robot, log = load(MISMATCH)
    problem = ResponseProblem(
        robot, recordings(robot, [log[:200], log[200:400]]), choose(robot, ["stiffness"], False, {})
    )
    sure = Uncertainty(np.array([0.01, 0.01]), np.eye(2), np.ones(2))
    near, far = np.zeros(2), np.array([0.0, 0.1])
    assert compare(problem, [Alone(near, sure), Alone(near + 0.01, sure)]) == []
    assert compare(problem, [Alone(near, sure), Alone(far, sure, frozenset({"stiffness_axis3"}))]) == []
    at_bound = np.array([0.0, problem.free[1].z(problem.free[1].high)])
    assert compare(problem, [Alone(near, sure), Alone(at_bound, sure)]) == []
    (found,) = compare(problem, [Alone(near, sure), Alone(far, sure)])
    assert found.name == "stiffness_axis3"
    assert found.distance == pytest.approx(0.1 / np.hypot(0.01, 0.01), rel=0.03)
    assert "contradict each other: stiffness_axis3 is 3e+05 by one and" in str(found)


def test_recordings_of_a_robot_that_changed_are_told_to_contradict_each_other():
    robot, log = load(DATA / "arm2_square")
    _, changed = load(MISMATCH)
    found = calibrate(robot, [log[:1500], changed[:1500]])
    (contradiction,) = found.contradictions
    assert "warning: " + str(contradiction) in found.to_text()


@pytest.mark.slow
def test_a_stiffness_that_is_5_percent_lower_is_found_to_1_percent():
    robot, log = load(DATA / "kr15_long")
    assert calibrate(robot, log)["stiffness_a1"].value == pytest.approx(0.95 * robot.drives[0].stiffness, rel=0.01)


def test_the_long_run_variance_of_correlated_scores():
    rng = np.random.default_rng(5)
    noise = rng.standard_normal((40_000, 1))
    scores = np.zeros_like(noise)
    for i in range(1, len(noise)):
        scores[i] = 0.8 * scores[i - 1] + noise[i]
    # An AR(1) process: the variance of its sum grows by 1/(1 - 0.8)² a sample.
    assert long_run(scores, 100)[0, 0] / len(scores) == pytest.approx(25, rel=0.15)


@pytest.mark.parametrize("lags", [0, 3, 40])
def test_the_long_run_variance_is_newey_and_wests(lags):
    scores = np.cumsum(np.random.default_rng(1).standard_normal((30, 2)), axis=0)
    centred = scores - scores.mean(axis=0)
    expected = centred.T @ centred
    for lag in range(1, min(lags, 29) + 1):
        part = centred[lag:].T @ centred[:-lag]
        expected = expected + (1 - lag / (lags + 1)) * (part + part.T)
    np.testing.assert_allclose(long_run(scores, lags), expected, atol=1e-10)


def test_derivatives_of_a_cubic_are_exact_and_gaps_stay_gaps():
    t = 1e-3 * np.arange(50)
    values = np.stack([t**3, np.where(t == t[20], np.nan, t**2)], axis=1)
    second = derivative(values, 1e-3, 2)
    assert np.allclose(second[:, 0], 6 * t, atol=1e-8)
    assert np.flatnonzero(np.isnan(second[:, 1])).tolist() == [20]


def test_payload_and_heavier_links_load_the_robot_and_come_off_again():
    robot = Robot.load(MISMATCH / "robot.yaml")
    path = MISMATCH / "robot.urdf"
    joints = [j.model_dump() | {"mass_scale": scale} for j, scale in zip(robot.drives, (1.1, 0.7), strict=True)]
    tool, payload = robot.tool.model_dump(), {"mass": 4.0, "xyz": [0.1, 0.0, 0.2]}
    loaded = Robot.from_urdf(path, joints, tool=tool, payload=payload)
    q = np.array([0.3, -0.4])
    plain = [
        Robot.from_urdf(path, [j.model_dump() | {"mass_scale": s} for j, s in zip(robot.drives, pair, strict=True)])
        for pair in ((1.1, 1.0), (1.0, 0.7), (1.0, 1.0))
    ]
    expected = plain[0].gravity_torque(q) + plain[1].gravity_torque(q) - plain[2].gravity_torque(q)
    at = Robot.from_urdf(path, robot.drives, tool=tool | {"xyz": np.add(tool["xyz"], [0.1, 0, 0.2]).tolist()})
    step = 1e-6
    for j in range(2):
        height = [at.tool_position(q + s * np.eye(2)[j])[2] for s in (step, -step)]
        expected[j] += 4.0 * 9.81 * (height[0] - height[1]) / (2 * step)
    assert np.allclose(loaded.gravity_torque(q), expected, rtol=1e-8)
    assert np.allclose(bare(loaded).gravity_torque(q), plain[2].gravity_torque(q), rtol=1e-12)
    with pytest.raises(ConfigError, match="expected a tool that carries it"):
        Robot.from_urdf(path, robot.drives, payload=payload)


def test_bias_and_scale_are_taken_off_a_log_and_put_back_for_calibration():
    robot, log = load(MISMATCH)
    sensor = robot.accelerometers[0].model_copy(update={"bias": (0.1, 0.0, -0.2), "scale": (1.0, 2.0, 1.0)})
    other, corrected = load(MISMATCH, accelerometers=(sensor,))
    assert np.allclose(corrected.acceleration * [1, 2, 1] + [0.1, 0, -0.2], log.acceleration)
    assert np.allclose(signals(other, corrected)["acceleration"], log.acceleration)


def command(*arguments):
    return CliRunner().invoke(cli.main, ["calibrate", *map(str, arguments)])


def test_the_command_line_resumes_an_interrupted_run(tmp_path):
    robot, log = MISMATCH / "robot.yaml", MISMATCH / "log.parquet"
    out, report = tmp_path / "new.yaml", tmp_path / "report.html"
    partial = tmp_path / "new.yaml.partial"
    settings = (robot, log, "--out", out, "--free", ",".join(FREE))
    missing = command(*settings, "--resume")
    assert missing.exit_code == 2
    assert "no interrupted calibration" in missing.output
    partial.write_text("[]")
    assert "expected the state of a calibration" in command(*settings, "--resume").output
    resume.keep(partial, Step(1, 0.0, 0.0, "", {"stiffness_axis2": -0.4, "stiffness_axis3": -0.3}))
    assert json.loads(partial.read_text())["z"]["stiffness_axis2"] == -0.4
    done = command(*settings, "--resume", "--report", report, "--held-out", DATA / "arm2_square/log.parquet")
    assert done.exit_code == 0, done.output
    assert "held out" in done.output
    assert out.exists()
    assert report.exists()
    assert not partial.exists()


def test_the_command_line_refuses_in_one_line(tmp_path):
    result = command(MISMATCH / "robot.yaml", MISMATCH / "log.parquet", "--out", tmp_path / "a.yaml", "--bound", "x=1")
    assert result.exit_code == 2
    assert "--bound x=1: expected NAME=LOW:HIGH" in result.output
