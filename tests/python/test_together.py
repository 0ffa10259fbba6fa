"""Calibration of one robot from many logs, held to robots whose parameters are known."""

import pickle
import shutil
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from ruamel.yaml import YAML

from linkside import EstimatorError, Log, Robot, demo, simulate
from linkside.calibration import calibrate_together
from linkside.calibration.parameters import choose
from linkside.calibration.rounds import LogEvidence, Task, evaluate
from linkside.calibration.together import FREE
from linkside.control.controllers import JointPD

RATE = 1000.0


def variant(folder, name, *, mass, factor=1.0, bias=(0.0, 0.0, 0.0)):
    """The demonstration's robot with a load, with other springs, and with biases of its accelerometer."""
    yaml = YAML()
    config = yaml.load((demo.FOLDER / "robot.yaml").read_text())
    config["rate_hz"] = RATE
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

    def __init__(self, folder, count, groups, drift=0.0, seed=0):
        shutil.copy(demo.FOLDER / "robot.urdf", folder)
        rng = np.random.default_rng(seed)
        self.robot = variant(folder, "robot", mass=5.0)
        self.factor = float(np.exp(rng.normal(0, 0.15)))
        self.masses = rng.uniform(3.0, 7.0, groups)
        self.biases = rng.normal(0, 0.1, (count, 3))
        self.times = np.arange(count) / max(count - 1, 1) - 0.5
        self.groups = [f"load {i % groups}" for i in range(count)]
        self.logs = []
        for i in range(count):
            factor = self.factor * np.exp(drift * self.times[i])
            made = variant(folder, "own", mass=self.masses[i % groups], factor=factor, bias=self.biases[i])
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
