"""Calibration of random arms that MuJoCo moves: better than before, or refused."""

import runpy
from pathlib import Path

import mujoco
import numpy as np
import pytest
import scipy.signal
from ruamel.yaml import YAML

from linkside import ExtendedKalmanFilter, Log, RauchTungStriebelSmoother, Robot
from linkside.calibration import calibrate

STUDY = runpy.run_path(str(Path(__file__).parents[2] / "docs/calibrated_robots.py"))
STEP, EVERY, SECONDS = 2e-4, 5, 3.0
AXES = {"scara": ("0 0 1",), "planar": ("0 1 0",), "spatial": ("0 0 1", "0 1 0", "1 0 0")}
SMOOTH = np.polynomial.Polynomial([0, 0, 0, 0, 35, -84, 70, -20])
ROUGH = np.polynomial.Polynomial([0, 0, 3, -2])


def urdf(rng, n, kind):
    """A serial arm whose links get lighter, and the length of the last."""
    mass, lengths, parts = rng.uniform(4, 20), rng.uniform(0.2, 0.5, n), ['<link name="base"/>']
    for j, length in enumerate(lengths):
        radius = rng.uniform(0.03, 0.08)
        along, across = mass * radius**2 / 2 + 2e-3, mass * (length**2 / 12 + radius**2 / 4)
        parts.append(
            f'<link name="l{j}"><inertial><origin xyz="{length / 2} 0 0.05"/><mass value="{mass}"/>'
            f'<inertia ixx="{along}" ixy="0" ixz="0" iyy="{across}" iyz="0" izz="{across}"/></inertial></link>'
            f'<joint name="j{j}" type="revolute"><parent link="{f"l{j - 1}" if j else "base"}"/><child link="l{j}"/>'
            f'<origin xyz="{lengths[j - 1] if j else 0} 0 0"/><axis xyz="{AXES[kind][j % len(AXES[kind])]}"/>'
            '<limit lower="-6" upper="6" effort="1" velocity="1"/></joint>'
        )
        mass *= rng.uniform(0.45, 0.8)
    compiler = '<mujoco><compiler fusestatic="false" discardvisual="true"/></mujoco>'
    return f'<robot name="r">{compiler}{"".join(parts)}</robot>', lengths[-1]


def motion(rng, n, rough):
    """Motors from rest to rest three times, smoothly or with jumps of acceleration."""
    t = STEP * np.arange(round(SECONDS / STEP) + 1)
    at = rng.uniform(-0.5, 0.5, n)
    theta = np.tile(at, (len(t), 1))
    for begin in (0.2, 1.1, 2.0):
        way = rng.uniform(-0.6, 0.6, n)
        share = np.clip((t - begin) / rng.uniform(0.3, 0.6), 0, 1)
        theta += way * (ROUGH if rough else SMOOTH)(share)[:, None]
    return scipy.signal.filtfilt(*scipy.signal.butter(2, 60, fs=1 / STEP), theta, axis=0) if rough else theta


def moved(text, stiffness, damping, theta, q):
    """Links behind springs whose motors move along ``theta``, by MuJoCo: q, dq, ddq at each `EVERY`-th step."""
    rate, model = np.gradient(theta, STEP, axis=0), mujoco.MjModel.from_xml_string(text)
    model.opt.timestep, model.opt.integrator = STEP, mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(model)
    data.qpos[:] = q

    def springs(_, data):
        row = min(int(data.time / STEP), len(theta) - 2)
        share = data.time / STEP - row
        position, velocity = (x[row] * (1 - share) + x[row + 1] * share for x in (theta, rate))
        data.qfrc_passive[:] += stiffness * (position - data.qpos) + damping * (velocity - data.qvel)

    out = []
    mujoco.set_mjcb_passive(springs)
    try:
        for row in range(len(theta)):
            if row % EVERY == 0:
                mujoco.mj_forward(model, data)
                out.append([data.qpos.copy(), data.qvel.copy(), data.qacc.copy()])
            mujoco.mj_step(model, data)
    finally:
        mujoco.set_mjcb_passive(None)
    return np.array(out).transpose(1, 0, 2)


def specimen(seed, folder):
    """A true robot, robot.yaml with springs 20 % off, columns of its log, and true link positions."""
    rng = np.random.default_rng(seed)
    kind = ["scara", "planar", "spatial"][seed % 3]
    n = int(rng.integers(2, 7 if kind == "spatial" else 5))
    text, length = urdf(rng, n, kind)
    sensors = [
        {
            "name": f"acc_{link}",
            "link": link,
            "xyz": rng.uniform(-0.1, 0.1, 3).tolist(),
            "rpy": rng.uniform(-0.5, 0.5, 3).tolist(),
            "noise_std": float(rng.choice([0.02, 0.05, 0.1])),
        }
        for link in sorted({f"l{n - 1}", f"l{max(0, n // 2 - 1)}"})
    ]
    (folder / "robot.urdf").write_text(text)
    encoder = float(rng.choice([1e-6, 3e-6, 1e-5]))

    def robot(name, stiffness, damping):
        drives = zip(stiffness.tolist(), damping.tolist(), strict=True)
        joints = [
            {"name": f"j{j}", "stiffness": k, "damping": d, "motor_inertia": 1.0} for j, (k, d) in enumerate(drives)
        ]
        settings = {"urdf": "robot.urdf", "rate_hz": 1000, "joints": joints, "accelerometers": sensors}
        settings |= {"encoder": {"resolution": encoder}, "tool": {"link": f"l{n - 1}", "xyz": [float(length), 0, 0]}}
        with open(folder / name, "w") as file:
            YAML().dump(settings, file)
        return Robot.load(folder / name)

    inertia = robot("unit.yaml", np.ones(n), np.ones(n)).mass_matrix(np.zeros((1, n)))[0].diagonal()
    stiffness = inertia * (2 * np.pi * rng.uniform(9, 28, n) * np.linspace(1, 1.6, n)) ** 2
    damping = 2 * rng.uniform(0.02, 0.1, n) * np.sqrt(stiffness * inertia)
    true = robot("true.yaml", stiffness, damping)
    robot("robot.yaml", stiffness * np.exp(rng.normal(0, 0.2, n)), damping * np.exp(rng.normal(0, 0.5, n)))
    theta = motion(rng, n, rough=bool(seed % 2))
    rest = theta[0] - true.gravity_torque(theta[:1])[0] / stiffness
    q, dq, ddq = moved(text, stiffness, damping, theta, rest)
    acceleration = true.specific_force(q, dq, ddq) + rng.normal(0, 0.03, 3 * len(sensors))
    acceleration += rng.standard_normal(acceleration.shape) * np.repeat([s["noise_std"] for s in sensors], 3)
    columns = {"t": STEP * EVERY * np.arange(len(q))}
    columns |= {f"theta_j{j}": x for j, x in enumerate((np.round(theta[::EVERY] / encoder) * encoder).T)}
    return true, columns | dict(zip(true.acceleration_channels, acceleration.T, strict=True)), q


def tool_errors(path, columns, q):
    """Of EKF and smoother, without their mean [mm]."""
    robot = Robot.load(path)
    log = Log.from_table(columns, robot, check=False)
    out = []
    for method in (ExtendedKalmanFilter, RauchTungStriebelSmoother):
        error = robot.tool_position(method(robot).run(log).q) - robot.tool_position(q)
        out.append(1e3 * np.sqrt(np.mean(np.sum((error - error.mean(axis=0)) ** 2, axis=1))))
    return np.array(out)


def outcome(seed, folder):
    """Errors after over before, where it was accepted; estimates over truth, logarithms, in standard errors."""
    true, columns, q = specimen(seed, folder)
    nominal = Robot.load(folder / "robot.yaml")
    found = calibrate(nominal, Log.from_table(columns, nominal, check=False))
    if not found.accepted:
        return None, []
    found.write(folder / "robot.yaml", folder / "new.yaml")
    ratio = tool_errors(folder / "new.yaml", columns, q) / tool_errors(folder / "robot.yaml", columns, q)
    truth = {f"{kind}_{d.name}": getattr(d, kind) for d in true.drives for kind in ("stiffness", "damping")}
    told = [e for e in found.estimates if e.parameter.name in truth]
    return ratio, [np.log(e.value / truth[e.parameter.name]) / (e.std / e.value) for e in told]


def test_a_random_arm_comes_right(tmp_path):
    """By residuals alone, all three springs would be off by four standard errors: encoders' steps ring its links."""
    ratio, scores = outcome(109, tmp_path)
    assert np.all(ratio < 1 / 3)
    assert len(scores) == 6
    assert np.abs(scores).max() < 3


@pytest.mark.slow
def test_random_arms_come_right_or_are_refused(tmp_path):
    """Slow arms whose encoders' steps ring their links are the hardest."""
    ratios, scores = [], []
    for seed in range(20):
        (folder := tmp_path / str(seed)).mkdir()
        ratio, found = outcome(seed, folder)
        scores += found
        if ratio is not None:
            ratios.append(ratio)
    assert len(ratios) >= 17
    assert np.sum(np.max(ratios, axis=1) > 1.02) <= 2
    assert np.all(np.median(ratios, axis=0) < 0.1)
    assert np.mean(np.abs(scores) < 1.96) > 0.8


@pytest.mark.slow
def test_no_robot_gets_worse_whose_masses_and_mountings_are_wrong_too():
    """Masses, mountings, scales and frictions are found with the springs, as far as recordings tell."""
    ratios = np.array([STUDY["judged"](specimen)[0] for specimen in STUDY["specimens"](7, 2)])
    assert ratios.max() <= 1.02
    assert np.median(ratios.max(axis=1)) < 1 / 3
