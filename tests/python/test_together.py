"""Calibration of one robot from many logs, held to robots whose parameters are known."""

import pickle
import shutil
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from ruamel.yaml import YAML
from scipy import stats
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from linkside import EstimatorError, Log, Robot, demo, simulate
from linkside.calibration import calibrate_together
from linkside.calibration.between import variances
from linkside.calibration.parameters import beside, choose
from linkside.calibration.rounds import LogEvidence, Task, evaluate
from linkside.calibration.together import FREE
from linkside.control.controllers import JointPD

RATE = 1000.0


KNOWN = {"mass_scale": 1e-3, "translation": 1e-4, "rotation": 1e-3, "scale": 1e-3, "time_constant": 2e-5, "delay": 2e-5}
"""Tolerances of a robot whose masses and sensors are as robot.yaml says."""


def drawn(config, rng):
    """Masses, and the accelerometer's mounting, scale, filter and delay, off by the tolerances of robot.yaml."""
    heaviest = "a1"  # what all other masses are relative to
    for joint in config["joints"]:
        joint["mass_scale"] = 1.0 if joint["name"] == heaviest else float(np.exp(rng.normal(0, 0.1)))
    sensor = config["accelerometers"][0]
    mounting = Rotation.from_euler("xyz", sensor["rpy"])
    turned = mounting * Rotation.from_rotvec(rng.normal(0, 0.03, 3))
    sensor["xyz"] = (np.array(sensor["xyz"]) + rng.normal(0, 0.01, 3)).tolist()
    sensor["rpy"] = turned.as_euler("xyz").tolist()
    sensor["scale"] = np.exp(rng.normal(0, 0.03, 3)).tolist()
    sensor["delay"] = float(abs(rng.normal(0, 1e-3)))
    sensor["corner_frequency"] = float(1 / (2 * np.pi * abs(rng.normal(0, 1e-3))))


def variant(folder, name, *, mass, factor=1.0, bias=(0.0, 0.0, 0.0), off=None):
    """The demonstration's robot with a load, with other springs, and with biases of its accelerometer.

    ``off`` seeds how masses and sensor are off; None where they are as robot.yaml says, and known to be.
    """
    yaml = YAML()
    config = yaml.load((demo.FOLDER / "robot.yaml").read_text())
    config["rate_hz"] = RATE
    if off is None:
        config["tolerances"] = dict(KNOWN)
    elif name != "robot":
        drawn(config, np.random.default_rng(off))
    for joint in config["joints"]:
        if "stiffness" in joint:
            joint["stiffness"] = float(joint["stiffness"] * factor)
    config["payload"] = {"mass": float(mass), "xyz": [0.0, 0.0, 0.15]}
    config["accelerometers"][0]["bias"] = [float(b) for b in bias]
    yaml.dump(config, folder / f"{name}.yaml")
    return Robot.load(folder / f"{name}.yaml")


def record(robot, path, seed, duration=0.6):
    """A log of a motion of its own."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(duration * RATE) + 1) / RATE
    frequency, size = rng.uniform(0.8, 3.0, robot.n), rng.uniform(0.05, 0.2, robot.n)
    q0 = rng.uniform(-0.3, 0.3, robot.n) + np.array([0.0, -1.2, 1.2, 0.3, 0.3, 0.3])
    begin = np.clip(t / 0.2, 0, 1)[:, None] ** 2
    q = q0 + begin * size * np.sin(2 * np.pi * np.outer(t, frequency))
    inertia = np.diag(robot.mass_matrix(q0)) + [drive.motor_inertia or 0.0 for drive in robot.drives]
    law = JointPD(900 * inertia, 42 * inertia, t, q, tau=robot.gravity_torque(q0))
    simulate(robot, law, duration, RATE, q=q0, substeps=2, seed=seed).log.write(path)
    return path


class Truth:
    """Logs of one robot with known springs, loads and biases."""

    def __init__(self, folder, count, groups, drift=0.0, seed=0, off=None):
        shutil.copy(demo.FOLDER / "robot.urdf", folder)
        rng = np.random.default_rng(seed)
        self.robot = variant(folder, "robot", mass=5.0, off=off)
        self.factor = float(np.exp(rng.normal(0, 0.15)))
        self.masses = rng.uniform(3.0, 7.0, groups)
        self.biases = rng.normal(0, 0.1, (count, 3))
        self.times = np.arange(count) / max(count - 1, 1) - 0.5
        self.groups = [f"load {i % groups}" for i in range(count)]
        self.logs = []
        for i in range(count):
            factor = self.factor * np.exp(drift * self.times[i])
            load, bias = self.masses[i % groups], self.biases[i]
            made = variant(folder, "own", mass=load, factor=factor, bias=bias, off=off)
            self.logs.append(record(made, folder / f"log{i:03}.parquet", 100 * seed + i))

    def off(self, found):
        """Errors in standard errors: of stiffness, of loads, of biases."""
        springs = [d.name for d in self.robot.drives if d.elastic]
        known = {d.name: self.factor * d.stiffness for d in self.robot.drives if d.elastic}
        stiffness = [(e.value - known[n]) / e.std for n in springs if (e := found.robot[f"stiffness_{n}"])]
        loads = [
            (e.value - mass) / e.std
            for i, mass in enumerate(self.masses)
            if (e := found.groups[f"load {i}"]["payload_mass"])
        ]
        biases = [
            (e.value - bias) / e.std
            for own, row in zip(found.logs, self.biases, strict=True)
            for e, bias in zip(own.values(), row, strict=True)
        ]
        return np.array(stiffness), np.array(loads), np.array(biases)


@pytest.fixture(scope="module")
def few(tmp_path_factory):
    truth = Truth(tmp_path_factory.mktemp("few"), 3, 2)
    return truth, calibrate_together(truth.robot, truth.logs, truth.groups)


def test_springs_loads_and_biases_are_found_within_their_standard_errors(few):
    truth, found = few
    for off in truth.off(found):
        assert np.abs(off).max() < 4
    for name in ("a1", "a2", "a3"):
        own = found.robot[f"stiffness_{name}"]
        assert own.std < 0.02 * own.value
        assert own.std < 0.2 * own.prior_std
    assert all(found.groups[label]["payload_mass"].std < 0.2 for label in set(truth.groups))


def test_wherever_logs_are_evaluated_the_bits_are_the_same(few):
    truth, found = few
    logs = [Log.read(path, truth.robot) for path in truth.logs]
    with ThreadPoolExecutor(2) as pool:
        again = calibrate_together(truth.robot, logs, truth.groups, run=pool.map)
    assert again.robot == found.robot
    assert again.groups == found.groups
    assert again.logs == found.logs


def test_a_task_and_its_evidence_can_be_sent_and_are_small(few):
    truth, _ = few
    free = choose(truth.robot, FREE, False, {})
    task = pickle.loads(pickle.dumps(Task(str(truth.logs[0]), np.zeros(len(free)), np.inf, 1.0)))
    found = evaluate(pickle.loads(pickle.dumps(truth.robot)), free, task)
    assert len(pickle.dumps(found)) < 20 * len(free) ** 2 + 2000
    assert found.information == pytest.approx(found.information.T)


def test_the_variance_between_logs_is_the_most_probable_one():
    """Of one number with equal noise, restricted maximum likelihood has a closed form; else it is sought."""
    rng = np.random.default_rng(0)
    for noise in (np.full(12, 0.3), rng.uniform(0.1, 1.0, 12)):
        values = rng.normal(2.0, np.sqrt(0.5 + noise**2))

        def unlikely(variance, values=values, noise=noise):
            weights = 1 / (variance + noise**2)
            mean = weights @ values / weights.sum()
            return weights @ (values - mean) ** 2 - np.log(weights).sum() + np.log(weights.sum())

        information = 1 / noise**2
        found, freedom = variances(
            (information * values)[:, None],
            information[:, None, None],
            information[:, None, None],
            np.array([information @ values]),
            np.array([[information.sum()]]),
        )
        sought = minimize_scalar(unlikely, bounds=(0.0, 5.0), method="bounded", options={"xatol": 1e-9}).x
        assert found[0] == pytest.approx(sought, rel=1e-4)
        if np.ptp(noise) == 0:
            assert found[0] == pytest.approx(values.var(ddof=1) - noise[0] ** 2, rel=1e-4)
            assert 8 < freedom[0] < 11


class Quadratic:
    """Logs whose likelihoods are quadratic: they differ more than their noise, and what is held is off."""

    FREE = ("stiffness", "damping", "bias")

    def __init__(self, robot, count, seed):
        rng = np.random.default_rng(seed)
        self.free = choose(robot, self.FREE, False, {})
        p, held = len(self.free), len(beside(robot, self.free))
        self.truth = rng.normal(0, 0.5, p)
        off, mimicked = rng.normal(size=held), rng.normal(0, 0.05 / np.sqrt(held), (p, held))
        self.information, self.top = [], []
        for _ in range(count):
            free = rng.normal(0, 5, (60, p))
            slopes = np.concatenate([free, free @ mimicked + rng.normal(0, 0.02, (60, held))], axis=1)
            own = np.where([one.kind == "bias" for one in self.free], rng.normal(0, 0.5, p), self.truth)
            effect = rng.normal(0, 0.05, p)
            errors = slopes @ np.concatenate([own + effect, off]) + rng.normal(size=60)
            self.information.append(slopes.T @ slopes)
            self.top.append(slopes.T @ errors)

    def __call__(self, _, tasks):
        for task in tasks:
            n, i = len(task.z), int(task.log)
            information, top = self.information[i][:n, :n], self.top[i][:n]
            value = float(top @ task.z - 0.5 * task.z @ information @ task.z)
            yield LogEvidence(value, top - information @ task.z, information, information, 1.0)

    def z(self, found):
        """Estimates in tolerances."""
        by_name = {p.name: p for p in self.free}
        return np.array([by_name[name].z(own.value) for name, own in found.items()])


def test_standard_errors_shrink_where_errors_are_independent_and_hold_everywhere():
    """From 5 logs to 50, by √10; what is held keeps its part. Over 30 fleets, 95 % intervals hold the truth."""
    robot = Robot.load(demo.ROBOT)
    single, common, inside = {}, {}, {}
    for count in (5, 50):
        errors, stds, parts = [], [], []
        for seed in range(30):
            logs = Quadratic(robot, count, seed)
            names = [str(i) for i in range(count)]
            found = calibrate_together(robot, names, free=Quadratic.FREE, run=logs).robot
            std = np.array([own.std / own.prior_std for own in found.values()])
            parts.append([own.common / own.prior_std for own in found.values()])
            errors.append((logs.z(found) - logs.truth[: len(std)]) / std)
            stds.append(std)
        common[count] = np.median(parts)
        single[count] = np.median(np.sqrt(np.square(stds) - np.square(parts)))
        inside[count] = np.mean(np.abs(errors) < 1.96)
    students = stats.t.ppf(0.975, 4) / stats.t.ppf(0.975, 49)  # of few logs the scatter is known less well
    assert single[5] / single[50] == pytest.approx(np.sqrt(10) * students, rel=0.15)
    assert common[50] == pytest.approx(common[5], rel=0.15)
    assert all(0.90 < share < 0.99 for share in inside.values()), inside


def test_what_no_log_shows_keeps_its_tolerance():
    def silent(_, tasks):
        p = len(tasks[0].z)
        return [LogEvidence(0.0, np.zeros(p), np.zeros((p, p)), np.zeros((p, p)), 1.0) for _ in tasks]

    found = calibrate_together(Robot.load(demo.ROBOT), ["log"] * 50, free=("stiffness", "bias"), run=silent)
    for own in (*found.robot.values(), *found.logs[0].values()):
        assert own.std == pytest.approx(own.prior_std)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"groups": ["a"]}, "groups has 1 labels for 3 logs"),
        ({"free": ["delay"]}, "is found by calibrate"),
        ({"drift": ["stiffness"]}, "drift needs times"),
        ({"drift": ["stiffness"], "times": [1.0, 1.0, 1.0]}, "different times"),
        ({"drift": ["bias"], "times": [0, 1, 2]}, "'bias' is no free kind that all logs share"),
        ({"free": ["stifness"]}, "stifness"),
    ],
)
def test_mistakes_are_named(few, options, words):
    truth, _ = few
    with pytest.raises(EstimatorError, match=words):
        calibrate_together(truth.robot, truth.logs, **options)


@pytest.mark.slow
def test_fifty_logs_with_five_loads(tmp_path):
    """Standard errors have the coverage that they say, and what more logs say makes them no larger."""
    truth = Truth(tmp_path, 50, 5, seed=1)
    found = calibrate_together(truth.robot, truth.logs, truth.groups)
    tenth = calibrate_together(truth.robot, truth.logs[:5], truth.groups[:5])
    assert all(own.std < tenth.robot[name].std for name, own in found.robot.items())
    stiffness, loads, biases = truth.off(found)
    assert np.sqrt(np.mean(np.concatenate([stiffness, loads]) ** 2)) < 1.6  # χ² of 8: 0.2 %
    assert np.mean(np.abs(biases) < 2) > 0.93


@pytest.mark.slow
def test_springs_and_loads_of_robots_that_are_off_by_their_tolerances(tmp_path):
    """95 % intervals hold at least nine of ten, though masses and sensors are not what robot.yaml says."""
    inside = []
    for seed in range(8):
        folder = tmp_path / f"{seed}"
        folder.mkdir()
        truth = Truth(folder, 5, 5, seed=seed, off=seed)
        found = calibrate_together(truth.robot, truth.logs, truth.groups)
        stiffness, loads, _ = truth.off(found)
        inside += (np.abs(np.concatenate([stiffness, loads])) < 1.96).tolist()
    assert np.mean(inside) > 0.9


@pytest.mark.slow
def test_drift_of_stiffness(tmp_path):
    """Springs that soften by 6 % over the logs are found to, and springs that do not are not."""
    for drift in (-0.06, 0.0):
        folder = tmp_path / f"{drift}"
        folder.mkdir()
        truth = Truth(folder, 8, 2, drift=drift, seed=2)
        found = calibrate_together(truth.robot, truth.logs, truth.groups, times=10 * truth.times, drift=["stiffness"])
        for own in found.drift.values():
            assert own.value == pytest.approx(drift / 10, abs=3.5 * own.std)
            assert own.std < 0.02 / 10
