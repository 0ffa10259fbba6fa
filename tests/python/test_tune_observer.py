"""Tuning an observer: what a recording with known states tells, the front, the file, refusals."""

import sys

import numpy as np
import pytest

import linkside
from linkside import AccelerationObserver, ConfigError, Estimate, EstimatorError, Log, LogError, Robot, simulate
from linkside.cli import main
from linkside.control import inverse_dynamics
from linkside.control.feedback import StateFeedback, pole_placement
from linkside.control.trajectories import rest_to_rest
from linkside.observers.tuning_file import ObserverTuning
from linkside.tuning.observer_front import OBJECTIVES, tune_observer

from .robots import DATA

LONG = DATA / "kr15_long"
ROBOT = Robot.load(LONG / "robot.yaml")
LOG = Log.read(LONG / "log.parquet", ROBOT)
TRUTH = Estimate.read(LONG / "truth.parquet")
DRIVES = ("poles", "stiffness", "damping", "motor_inertia")


@pytest.fixture(scope="module")
def front():
    return tune_observer(ROBOT, LOG, TRUTH, DRIVES, evaluations=500)


def torsion_error(observer, log, truth):
    estimate = observer.run(log)
    error = (estimate.theta - estimate.q) - (truth.theta - truth.q)
    return np.sqrt(np.mean(error[:, :3] ** 2))


def test_torsion_errs_less_and_the_true_stiffness_is_found(front):
    best = front.best
    assert torsion_error(best.observer(ROBOT), LOG, TRUTH) < 0.3 * torsion_error(
        AccelerationObserver(ROBOT), LOG, TRUTH
    )
    assert best.stiffness["a1"] == pytest.approx(0.95 * 240e3, rel=0.02)
    assert set(best.poles) == {"a1", "a2", "a3"}


@pytest.fixture(scope="module")
def fresh():
    """Another motion of the recording's specimen: springs 5 % softer, damping 20 % up. A log and its truth."""
    start = LOG.theta[0]
    motion = rest_to_rest([start, start + np.radians([-20, 12, -15, 0, 0, 0])], 0.5, 5e-4, degree=7).held(0.1, 0.2)
    desired = inverse_dynamics(ROBOT, motion)
    controller = StateFeedback(ROBOT, desired, pole_placement(ROBOT, start))
    true = ROBOT.scaled(stiffness=0.95, damping=1.2)
    run = simulate(true, controller, motion.t[-1], 2000, q=start, feedback=controller.observer, substeps=2)
    states = {name: run.truth[name] for name in ("t", "q", "theta", "dq", "dtheta")}
    return run.log, Estimate(names=ROBOT.names, status=np.zeros(len(motion), np.uint8), **states)


def test_torsion_errs_less_on_another_motion_too(front, fresh):
    before = torsion_error(AccelerationObserver(ROBOT), *fresh)
    assert torsion_error(front.best.observer(ROBOT), *fresh) < 0.7 * before


def test_no_point_of_the_front_is_worse_in_everything(front):
    for i, one in enumerate(front.ratios):
        others = np.delete(front.ratios, i, axis=0)
        assert not ((others <= one).all(axis=1) & (others < one).any(axis=1)).any()
    assert (np.diff(front.ratios[:, -1]) >= 0).all()


def test_ratios_are_those_of_the_observer_itself(front):
    point = front.points[0]
    estimate, start = point.observer(ROBOT).run(LOG), AccelerationObserver(ROBOT).run(LOG)
    for column, name in ((0, "q"), (1, "dq")):
        error, before = (
            ((getattr(e, name) - getattr(TRUTH, name))[:, :3] ** 2).mean(axis=0) for e in (estimate, start)
        )
        assert front.ratios[0, column] == pytest.approx(np.sqrt(np.mean(error / before)), rel=1e-6)


def test_noise_is_that_of_noisy_readings():
    """Against the observer on a robot at rest, whose readings are noise alone."""
    log, rows = LOG[:1], 6000
    rng = np.random.default_rng(0)
    clean = np.tile(log.acceleration[:1], (rows, 1))
    resolution, std = ROBOT.config.encoder.resolution, ROBOT.accelerometers[0].noise_std
    columns = {"t": np.arange(rows) * 5e-4}
    columns |= {
        f"theta_{name}": log.theta[0, j] + resolution * rng.uniform(-0.5, 0.5, rows) * ROBOT.elastic[j]
        for j, name in enumerate(ROBOT.names)
    }
    columns |= {f"tau_{name}": np.full(rows, log.tau[0, j]) for j, name in enumerate(ROBOT.names)}
    noisy = clean + std * rng.standard_normal(clean.shape)
    columns |= {name: noisy[:, j] for j, name in enumerate(ROBOT.acceleration_channels)}
    estimate = AccelerationObserver(ROBOT).run(Log.from_table(columns, ROBOT))
    found = np.sqrt(np.mean(np.var(estimate.dq[2000:, :3], axis=0)))
    stated = tune_observer(ROBOT, LOG, TRUTH, evaluations=1).at_start[3]
    assert found == pytest.approx(stated, rel=0.25)


def test_smoothed_states_serve_where_none_are_measured():
    front = tune_observer(ROBOT, LOG[:1500], evaluations=60)
    assert front.ratios.sum(axis=1).min() < 4
    assert set(front.best.model_dump(exclude_defaults=True)) == {"poles"}
    assert "smoothed" not in front.to_text()
    stiff = tune_observer(ROBOT, LOG[:1500], free=("stiffness", "damping"), evaluations=20)
    assert "stiffness and damping from smoothed states" in stiff.to_text()


def test_results_are_the_same_every_time_and_progress_never_goes_back():
    seen = []
    one = tune_observer(ROBOT, LOG[:800], TRUTH, evaluations=60, progress=lambda *state: seen.append(state))
    two = tune_observer(ROBOT, LOG[:800], TRUTH, evaluations=60)
    assert one.points == two.points
    counts, best = zip(*seen, strict=True)
    assert counts == tuple(range(1, one.evaluations + 1))
    assert list(best) == sorted(best, reverse=True)


def test_several_recordings_and_joints_that_rest():
    demo = Robot.load(linkside.demo.ROBOT)
    short = Log.read(linkside.demo.LOG, demo)
    truths = [TRUTH, Estimate.read(linkside.demo.TRUTH)]
    front = tune_observer(ROBOT, [LOG[:1000], short], truths, ("stiffness",), evaluations=60)
    moving = [
        joint
        for joint, moves in zip(("a1", "a2", "a3"), np.ptp(LOG[:1000].theta, axis=0) > 1e-3, strict=False)
        if moves
    ]
    assert list(front.best.stiffness) == moving
    assert front.best.poles == {"a1": 250.0, "a2": 250.0, "a3": 250.0}


def test_figure_and_words(front):
    assert len(front.figure().axes) == 3
    text = front.to_text()
    assert all(name in text for name in (*OBJECTIVES, "stiffness_a1", "poles_a3"))


def test_file_and_command_line(tmp_path, capsys):
    out, figure, estimate = (str(tmp_path / name) for name in ("tuning.yaml", "front.png", "estimate.parquet"))
    robot, log, truth = (str(LONG / name) for name in ("robot.yaml", "log.parquet", "truth.parquet"))
    free = ["--free", "poles,stiffness", "--states", truth]
    with pytest.raises(SystemExit, match="0"):
        main(
            ["tune", robot, log, "--with", "observer", *free, "--out", out, "--figure", figure, "--evaluations", "150"]
        )
    assert "stiffness_a1" in capsys.readouterr().out
    with pytest.raises(SystemExit, match="0"):
        main(["estimate", robot, log, "--tuning", out, "--out", estimate])
    tuning = ObserverTuning.read(out)
    assert np.array_equal(Estimate.read(estimate).q, tuning.observer(ROBOT).run(LOG).q)
    with pytest.raises(SystemExit, match="2"):
        main(["tune", robot, log, "--states", truth, "--out", out])
    assert "--states is not for --with ekf" in capsys.readouterr().err


def test_a_tuning_file_that_cannot_be_used(tmp_path):
    (tmp_path / "one.yaml").write_text("poles: {a1: 250}\nnoise: 3\n")
    with pytest.raises(ConfigError, match=r"one\.yaml:2"):
        ObserverTuning.read(tmp_path / "one.yaml")
    with pytest.raises(ConfigError, match="stiffness: no joint 'b1'; there are a1"):
        ObserverTuning(stiffness={"b1": 3.0}).observer(ROBOT)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"free": ("gain",)}, "'gain' is not one of poles, stiffness"),
        ({"free": ()}, "expected some of"),
        ({"bounds": {"mass": (1, 2)}}, "'mass' is not one of"),
        ({"bounds": {"poles": (2, 1)}}, "expected two rising factors"),
        ({"bounds": {"poles": (1, 40)}}, r"joint 'a1' has a pole of 10000 rad/s, too fast for a period"),
        ({"states": [TRUTH, TRUTH]}, "2 given, for 1 recordings"),
        ({"logs": []}, "no log"),
    ],
)
def test_settings_that_cannot_be_used_are_refused(options, words):
    settings = {"logs": LOG[:800], "states": TRUTH, **options}
    with pytest.raises(EstimatorError, match=words):
        tune_observer(ROBOT, **settings)


def test_recordings_without_motion_or_states_are_refused():
    with pytest.raises(LogError, match=r"no elastic joint's motor moves .*: record a motion"):
        tune_observer(ROBOT, LOG[:40], TRUTH)
    with pytest.raises(LogError, match="no row at some of its times"):
        tune_observer(ROBOT, LOG, TRUTH[:100])


def test_pymoo_missing_is_said(monkeypatch):
    for name in [name for name in sys.modules if name.startswith("pymoo")]:
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setitem(sys.modules, "pymoo.algorithms.moo.nsga2", None)
    with pytest.raises(EstimatorError, match=r"pip install 'linkside\[tune\]'"):
        tune_observer(ROBOT, LOG[:800], TRUTH, evaluations=3)
