"""What single tolerances do to standard deviations, against closed forms and against robots that truly differ."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from linkside import (
    ElasticJointFilter,
    ElasticJointSmoother,
    ExtendedKalmanFilter,
    Log,
    MotorJerkFilter,
    ParticleFilter,
    RauchTungStriebelSmoother,
    Robot,
)
from linkside.control.controllers import JointPD
from linkside.robot.considered import with_expected_damping
from linkside.simulation import simulate

from .robots import ARM, spring

ESTIMATORS = [ExtendedKalmanFilter, RauchTungStriebelSmoother, ElasticJointFilter, ElasticJointSmoother]
JOINTS = [spring("shoulder"), spring("elbow")]
ENCODER = {"resolution": 1e-6}
ZERO = 2e-4
UNTOLD = dict.fromkeys(("stiffness", "damping", "mass_scale", "motor_inertia", "torque_constant", "lost_motion"), 1e-9)


def robot(joints: Any = JOINTS, **tolerances: float) -> Robot:
    """An arm without a sensor on its links: nothing is told of its parameters."""
    return Robot.from_urdf(
        ARM, joints, encoder=ENCODER, torque={"noise_std": 0.01}, tolerances={**UNTOLD, **tolerances}
    )


def moving(true: Robot, seconds: float = 0.6, move: float = 0.3) -> Any:
    """Motors that rest, go on within 0.2 s and rest again; the links ring."""
    start = np.array([0.9, 0.6])
    held = true.gravity_torque(start)
    times = np.arange(0.1, 0.31, 0.01)
    u = (times - 0.1) / 0.2
    path = start + held / [d.stiffness for d in true.drives] + move * (3 * u**2 - 2 * u**3)[:, None]
    inertia = np.diag(true.mass_matrix(start)) + [d.motor_inertia for d in true.drives]
    control = JointPD(kp=2e3 * inertia, kd=60 * inertia, times=times, theta=list(path), tau=held)
    return simulate(true, control, seconds, 1000.0, substeps=4, q=start)


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_an_encoder_zero_counts_as_far_as_it_moves_the_estimate(estimator: Any) -> None:
    """Linear to the last percent: how far a shift of all motor positions moves the links, over the shift."""
    log = moving(robot()).log
    shifted = replace(log, theta=log.theta + ZERO)
    moved = estimator(robot()).run(shifted).q - estimator(robot()).run(log).q
    with_zero, without = (estimator(robot(encoder_zero=wide)).run(shifted).q_std for wide in (ZERO, 0.0))
    counted = np.sqrt(with_zero**2 - without**2)
    np.testing.assert_allclose(counted, np.abs(moved), rtol=0.02)
    np.testing.assert_allclose(counted, ZERO, rtol=0.1)  # from the first row on


def test_without_a_declared_zero_positions_are_relative_to_the_encoders() -> None:
    from linkside.robot.considered import considered

    assert not any(one.kind == "encoder_zero" for one in considered(robot()))
    assert [one.std for one in considered(robot(encoder_zero=ZERO)) if one.kind == "encoder_zero"] == [ZERO, ZERO]


@pytest.mark.parametrize(("key", "share"), [("stiffness", -0.6), ("stiffness", 0.6), ("mass_scale", 0.3)])
def test_three_deviations_reach_as_far_as_three_tolerances(key: str, share: float) -> None:
    """At rest the torsion is the weight over the stiffness: e^0.6 − 1 of it on the soft side, and not 0.6."""
    nominal = robot(**{key: abs(share) / 3})
    elbow = {**JOINTS[1], key: JOINTS[1].get(key, 1.0) * np.exp(share)}
    true = robot([JOINTS[0], elbow])
    q = np.array([0.9, 0.6])
    theta = q + true.gravity_torque(q) / [d.stiffness for d in true.drives]
    rows = {"t": 1e-3 * np.arange(60)} | {f"theta_{n}": np.full(60, theta[i]) for i, n in enumerate(nominal.names)}
    estimate = ExtendedKalmanFilter(nominal).run(Log.from_table(rows, nominal))
    ratio = (np.abs(estimate.q - q) / estimate.q_std)[:, 1]
    assert ratio.max() < 3.05
    assert (ratio.min() > 2.8) == (share != 0.6)  # the far side, which it is made for


@pytest.mark.parametrize("softer", [0.8, 0.9, 1.5])
@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_a_vibration_of_another_frequency_is_covered_at_all_its_phases(estimator: Any, softer: float) -> None:
    """A link that rings on long after the motion, undamped and unseen, on a spring that is not that of robot.yaml."""
    joints = [spring("shoulder", stiffness=3e3, damping=0.0), spring("elbow", stiffness=1e3, damping=0.0)]
    nominal = robot(joints, stiffness=0.2)
    true = robot([{**joints[0], "stiffness": softer * joints[0]["stiffness"]}, joints[1]])
    run = moving(true, seconds=4.0)
    estimate = estimator(nominal).run(run.log)
    error = np.abs(estimate.q - run.truth["q"])
    assert ((error > 3 * estimate.q_std).any(axis=1)).mean() < 0.02
    swing = np.abs(run.truth["theta"] - run.truth["q"])[2000:].max(axis=0)
    assert (estimate.q_std[2000:].max(axis=0) < 2.5 * swing).all()  # the vibration's size, however long it lasts


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_lost_motion_stays_in_the_standard_deviation_whatever_readings_say(estimator: Any) -> None:
    """It changes with the motion, so that no reading of before tells it; a link encoder sees the link itself."""
    lost = 2e-4
    sensors = [{"name": "acc", "link": "hand", "noise_std": 0.01}]
    tiny = {**UNTOLD, **dict.fromkeys(("rotation", "translation", "scale"), 1e-9), "lost_motion": lost}

    def arm(**more: Any) -> Robot:
        return Robot.from_urdf(ARM, JOINTS, encoder=ENCODER, torque={"noise_std": 0.01}, tolerances=tiny, **more)

    seen = arm(accelerometers=sensors)
    np.testing.assert_allclose(estimator(seen).run(moving(seen).log).q_std[-100:], lost, rtol=0.1)
    encoded = arm(link_encoder={"resolution": 1e-6})
    run = moving(encoded)
    log = replace(run.log, q=run.truth["q"])
    assert np.all(
        estimator(encoded).run(log).q_std[-100:] < (0.1 if "Elastic" not in estimator.__name__ else 1.0) * lost
    )


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_play_that_is_not_declared_is_inside_the_standard_deviations(estimator: Any) -> None:
    """The link lies at one end of the gap or at the other, and where gravity turns it goes through."""
    gap, tiny = 1.8e-4, {"stiffness": 0.05, "mass_scale": 0.02}

    def arm(wide: float, **more: Any) -> Robot:
        joints = [{**joint, "stiffness": 5e4, **more} for joint in JOINTS]
        return Robot.from_urdf(ARM, joints, encoder=ENCODER, tolerances={**tiny, "lost_motion": wide})

    run = moving(arm(0.0, backlash={"half_gap": gap}), seconds=1.0)
    for wide, honest in ((1e-4, True), (0.0, False)):
        estimate = estimator(arm(wide)).run(run.log)
        off = np.any(np.abs(estimate.q - run.truth["q"]) > 3 * estimate.q_std, axis=1)
        assert (np.mean(off) < 0.02) == honest, np.mean(off)


def undamped(softer: float = 1.0, **keys: Any) -> list[dict[str, Any]]:
    """Two springs of which robot.yaml states no damping, or a robot that differs from it."""
    return [
        spring(name, stiffness=softer * k, **{"damping": 0.0, **keys})
        for name, k in (("shoulder", 3e3), ("elbow", 1e3))
    ]


@pytest.fixture(scope="module")
def ringing() -> list[Any]:
    """Robots with springs from the tolerance, undamped or not, long after a motion."""
    drawn = [(softer, damping) for softer in np.exp(0.2 * np.arange(-2, 3)) for damping in (0.0, 3.0)]
    return [moving(robot(undamped(softer, damping=damping)), seconds=4.0) for softer, damping in drawn]


@pytest.mark.parametrize(
    "estimator", [ExtendedKalmanFilter, RauchTungStriebelSmoother, MotorJerkFilter, ParticleFilter]
)
def test_a_vibration_of_unknown_phase_dies_in_the_estimate_as_the_mean_over_all_springs_does(
    estimator: Any, ringing: list[Any]
) -> None:
    """Over all these robots it is less far off than one that rings on."""
    nominal = robot(undamped(), stiffness=0.2, damping=1.0)
    squares = {True: [], False: []}
    for run in ringing:
        for tolerances, sums in squares.items():
            estimate = estimator(nominal, tolerances=tolerances).run(run.log)
            sums.append(np.var((estimate.q - run.truth["q"])[2000:], axis=0).sum())  # but for what the weight does
    assert np.mean(squares[True]) < 0.6 * np.mean(squares[False])


def test_the_expected_damping_falls_to_1_in_e_with_the_mean_over_all_springs() -> None:
    sigma, rng = 0.05, np.random.default_rng(1)
    damped = with_expected_damping(robot(undamped(), stiffness=sigma))
    mass = np.diag(damped.mass_matrix(np.zeros(2)))
    for drive, inertia in zip(damped.drives, mass, strict=True):
        omega = np.sqrt(drive.stiffness / inertia)
        rate = drive.damping / (2 * inertia)
        phases = omega * np.exp(sigma / 2 * rng.normal(size=100_000)) / rate
        mean = np.abs(np.mean(np.exp(1j * phases)))  # the envelope at the time at which the damped one is at 1/e
        assert mean == pytest.approx(np.exp(-1), abs=0.01)


@pytest.mark.parametrize("stated", [{"damping": 1e-3}, {"sensors": True}])
def test_no_damping_is_expected_where_it_is_stated_or_a_sensor_sees_the_vibration(stated: dict[str, Any]) -> None:
    seen = {"accelerometers": [{"name": "acc", "link": "hand", "noise_std": 0.01}]} if stated.pop("sensors", 0) else {}
    known = Robot.from_urdf(ARM, undamped(**stated), encoder=ENCODER, **seen)
    assert with_expected_damping(known) is known
