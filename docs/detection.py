"""Measures what filters say of themselves: false flags, and faults that they find.

Prints what docs/trust.md has of these. `--samples` says how long it may take.
"""

import argparse
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import numpy.typing as npt

import linkside
from linkside import AccelerationObserver, Estimate, ExtendedKalmanFilter, Log, NumericalError, Robot
from linkside.recording.estimate import Status

Array = npt.NDArray[np.float64]

HERE = Path(__file__).parent
DATA = HERE.parent / "tests/data"
FAULTS = ("wrap", "bias", "stuck", "flipped", "gain", "dead")
LEAST = 3.0
"""A fault counts where it moves some link by so many standard deviations."""
LIMIT = 0.05
"""In which it is to be found [s of motion]."""


def main() -> None:
    """Print the tables asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tables", nargs="*", default=["flags", "faults", "observer"])
    parser.add_argument("--samples", type=int, default=1_000_000, help="without a fault")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if "flags" in options.tables:
        flags(options.samples, options.seed)
    if "faults" in options.tables:
        faults()
    if "observer" in options.tables:
        observer_faults()


def chain(rng: np.random.Generator, joints: int, *, resolution: float, noise_std: float) -> Robot:
    """A robot of links in a row, one accelerometer on the last and one half way, as heavy and stiff as robots are."""
    heavy = 30.0 * 0.55 ** np.arange(joints) * rng.uniform(0.6, 1.6, joints)
    lengths = rng.uniform(0.15, 0.6, joints)
    parts = ['<robot name="chain"><link name="l0"/>']
    for i in range(joints):
        mass, length = heavy[i], lengths[i]
        across, along = mass * length**2 / 12 + 1e-3, mass * 1e-3 + 1e-4
        parts.append(
            f'<link name="l{i + 1}"><inertial><origin xyz="0 0 {0.5 * length}"/><mass value="{mass}"/>'
            f'<inertia ixx="{across}" ixy="0" ixz="0" iyy="{across}" iyz="0" izz="{along}"/></inertial></link>'
            f'<joint name="j{i + 1}" type="revolute"><parent link="l{i}"/><child link="l{i + 1}"/>'
            f'<origin xyz="0.05 0.02 {lengths[i - 1] if i else 0.3}"/>'
            f'<axis xyz="{("0 0 1", "0 1 0", "1 0 0")[i % 3]}"/>'
            '<limit lower="-6" upper="6" effort="1" velocity="1"/></joint>'
        )
    text = "".join([*parts, "</robot>"])
    names = [f"j{i + 1}" for i in range(joints)]
    plain = Robot.from_urdf(text, [{"name": name, "stiffness": 1e4, "motor_inertia": 1.0} for name in names])
    inertia = np.diag(plain.mass_matrix(np.full(joints, 0.5)))
    stiffness = inertia * (2 * np.pi * rng.uniform(6, 20, joints)) ** 2
    drives = [
        {"name": name, "stiffness": float(k), "damping": float(k * 5e-4), "motor_inertia": float(m)}
        for name, k, m in zip(names, stiffness, inertia * rng.uniform(0.5, 2, joints), strict=True)
    ]
    places = [joints, max(1, joints // 2)] if joints > 2 else [joints]
    sensors = [
        {
            "name": f"a{link}",
            "link": f"l{link}",
            "xyz": rng.uniform(-0.2, 0.3, 3).tolist(),
            "noise_std": noise_std,
            "rpy": rng.uniform(-1, 1, 3).tolist(),
        }
        for link in places
    ]
    tool = {"link": f"l{joints}", "xyz": [0.1, 0.0, 0.2]}
    encoder = {"resolution": resolution}
    return Robot.from_urdf(text, drives, accelerometers=sensors, encoder=encoder, tool=tool, torque={"noise_std": 1.0})


def motion(rng: np.random.Generator, joints: int, t: Array, kind: str) -> tuple[Array, Array, Array]:
    """Positions, velocities and accelerations of smooth, fast or slow links, or of links that rest half of the time."""
    top, size = {"slow": (0.2, 0.3), "smooth": (1.5, 0.3), "fast": (6.0, 0.2), "rest": (1.5, 0.3)}[kind]
    q, dq, ddq = (np.zeros((len(t), joints)) for _ in range(3))
    q += rng.uniform(-1, 1, joints)
    for _ in range(4):
        w = 2 * np.pi * rng.uniform(0.2 * top, top, joints)
        a, phase = (
            size * rng.uniform(0, 1, joints) / (w / (2 * np.pi * 0.2 * top)) ** 1.5,
            rng.uniform(0, 2 * np.pi, joints),
        )
        x = w * t[:, None] + phase
        q, dq, ddq = q + a * np.sin(x), dq + a * w * np.cos(x), ddq - a * w**2 * np.sin(x)
    if kind == "rest":  # s(t) in place of t: at rest, a smooth start, on its way, a smooth stop, at rest
        return _resting(q, dq, ddq, t)
    return q, dq, ddq


def _resting(q: Array, dq: Array, ddq: Array, t: Array) -> tuple[Array, Array, Array]:
    """Between a third and two thirds of the time from the first posture to that of the end, by a smooth polynomial."""
    span = t[-1] / 3
    x = np.clip((t - span) / span, 0, 1)[:, None]
    s = x**4 * (35 - 84 * x + 70 * x**2 - 20 * x**3)
    ds = 140 * x**3 * (1 - x) ** 3 / span
    dds = 420 * x**2 * (1 - x) ** 2 * (1 - 2 * x) / span**2
    move = q[-1] - q[0]
    return q[0] + s * move, ds * move, dds * move


def recording(
    robot: Robot, rng: np.random.Generator, kind: str, rate: float, rows: int, missing: float
) -> tuple[Log, Array]:
    """What the sensors of a robot read whose joints are as robot.yaml says, and its true link positions."""
    t = np.arange(rows) / rate
    q, dq, ddq = motion(rng, robot.n, t, kind)
    torque = robot.inverse_dynamics(q, dq, ddq)
    stiffness = np.array([d.stiffness for d in robot.drives])
    lag = np.array([d.damping for d in robot.drives]) / stiffness
    theta = q + lagged(torque / stiffness, lag, 1 / rate)
    step = robot.config.encoder.resolution
    theta = np.round(theta / step) * step if step else theta
    noise = np.concatenate([np.full(len(s.axes), s.noise_std) for s in robot.accelerometers])
    acceleration = robot.specific_force(q, dq, ddq) + noise * rng.standard_normal((rows, len(noise)))
    if missing:
        theta[1:][rng.random(theta[1:].shape) < missing] = np.nan
        acceleration[1:][rng.random(acceleration[1:].shape) < missing] = np.nan
    columns = {"t": t} | {f"theta_{name}": theta[:, i] for i, name in enumerate(robot.names)}
    columns |= dict(zip(robot.acceleration_channels, acceleration.T, strict=True))
    return Log.from_table(columns, robot), q


def lagged(x: Array, lag: Array, period: float) -> Array:
    """Torsion of springs with a damper beside them, δ + lag δ̇ = x, with x straight between samples."""
    out = np.empty_like(x)
    decay = np.exp(-period / lag)
    out[0] = x[0]
    early, late = lag / period * (1 - decay) - decay, 1 - lag / period * (1 - decay)
    for k in range(1, len(x)):
        out[k] = decay * out[k - 1] + early * x[k - 1] + late * x[k]
    return out


def correct(seed: int) -> Iterator[tuple[str, Robot, Log, Array]]:
    """Robots and recordings without end that are as robot.yaml says."""
    rng = np.random.default_rng(seed)
    while True:
        joints = int(rng.choice([1, 2, 3, 6, 7]))
        resolution = float(10 ** rng.uniform(-6, -4))
        noise = float(rng.choice([0.02, 0.05, 0.2]))
        kind = str(rng.choice(["slow", "smooth", "fast", "rest"]))
        rate = float(rng.choice([100.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0]))
        missing = float(rng.choice([0.0, 0.0, 0.1]))
        robot = chain(rng, joints, resolution=resolution, noise_std=noise)
        log, q = recording(robot, rng, kind, rate, 10_000, missing)
        name = f"{joints} joints, {kind}, {rate:.0f} Hz, step {resolution:.1e}, noise {noise}, {missing:.0%} missing"
        yield name, robot, log, q


def flags(samples: int, seed: int) -> None:
    """How many samples of correct data are flagged."""
    taken = flagged = 0
    for name, robot, log, _ in correct(seed):
        estimate = ExtendedKalmanFilter(robot).run(log)
        bad = int((estimate.status & (Status.CONTRADICTED | Status.FAULTY) > 0).sum())
        taken, flagged = taken + len(log), flagged + bad
        if bad:
            print(f"{bad} samples flagged: {name}; {estimate.findings[0]}", flush=True)
        if taken >= samples:
            break
    print(f"{taken} samples of correct data, {flagged} flagged")


def spoiled(log: Log, signal: str, channel: int, fault: str, row: int) -> Log:
    """A log with a fault in one channel from a row on."""
    values = getattr(log, signal).copy()
    x = values[:, channel]
    bias = {"theta": 1e-3, "acceleration": 1.0, "tau": 0.1 * float(np.abs(x).max())}[signal]
    after = {
        "wrap": x[row:] - 2 * np.pi,
        "bias": x[row:] + bias,
        "stuck": np.full(len(x) - row, x[row - 1]),
        "flipped": -x[row:],
        "gain": 1.2 * x[row:],
        "dead": np.zeros(len(x) - row),
        "drift": x[row:] + 3 * bias * np.linspace(0, 1, len(x) - row),
    }
    values[row:, channel] = after[fault]
    return replace(log, **{signal: values})


def faults() -> None:
    """Every fault in every channel: how far it moves the estimate, whether it is named, and how soon."""
    demo = Robot.load(linkside.demo.ROBOT)
    square = Robot.load(DATA / "arm2_square/robot.yaml")
    for name, robot, log, row in (
        ("demo", demo, Log.read(linkside.demo.LOG, demo), 1500),
        ("arm2_square", square, Log.read(DATA / "arm2_square/log.parquet", square), 900),
    ):
        log = log[: row + 600]
        for tolerances, fault in product((True, False), FAULTS):
            pairs = [(s, c) for s, c in channels(log) if fault != "wrap" or s == "theta"]
            found = [one(robot, log, s, c, fault, row, tolerances) for s, c in pairs]
            due = [f for f in found if f[1] > LEAST]
            late = [f"{f[0]} {f[2]}" for f in due if f[3] is None or f[3] > LIMIT]
            delays = [f[3] for f in due if f[3] is not None]
            slowest = f"{1e3 * max(delays):.1f}" if delays else "-"
            how = "with" if tolerances else "without"
            counts = f"{len(due)} of {len(found)} count, {len(due) - len(late)} found in 50 ms"
            print(
                f"{name:12} {how:7} tolerances, {fault:8} {counts}, slowest {slowest} ms", *late, sep="; ", flush=True
            )


def observer_faults() -> None:
    """Every fault in every channel of arm2_square, for the observer: rows off, off and good without and with `std`."""
    robot = Robot.load(DATA / "arm2_square/robot.yaml")
    log, truth = Log.read(DATA / "arm2_square/log.parquet", robot), Estimate.read(DATA / "arm2_square/truth.parquet")
    row = len(log) // 3
    print("| channel | fault | rows off | off and good before | now |")
    for signal, channel in [*channels(log), *(("tau", c) for c in range(robot.n))]:
        for fault in (*FAULTS[1:], "drift"):
            bad = spoiled(log, signal, channel, fault, row)
            try:
                now, before = (AccelerationObserver(robot, std=std).run(bad) for std in (True, False))
            except NumericalError:
                print(f"| {log.columns(signal)[channel]} | {fault} | refused | | |")
                continue
            off = (np.abs(now.q - truth.q) > LEAST * now.q_std).any(axis=1)
            silent = [(off & (e.status & (Status.CONTRADICTED | Status.FAULTY) == 0)).mean() for e in (before, now)]
            shares = " | ".join(f"{100 * x:.0f} %" for x in (off.mean(), *silent))
            print(f"| {log.columns(signal)[channel]} | {fault} | {shares} |", flush=True)


def channels(log: Log) -> list[tuple[str, int]]:
    """Signal and channel of each motor position and accelerometer axis."""
    assert log.acceleration is not None
    return [("theta", c) for c in range(log.theta.shape[1])] + [
        ("acceleration", c) for c in range(log.acceleration.shape[1])
    ]


def one(
    robot: Robot, log: Log, signal: str, channel: int, fault: str, row: int, tolerances: bool
) -> tuple[str, float, str, float | None]:
    """Channel, how many standard deviations the estimate moves, what was said, and after what time if rightly [s]."""
    bad = spoiled(log, signal, channel, fault, row)
    estimate, clean = (ExtendedKalmanFilter(robot, tolerances=tolerances).run(x) for x in (bad, log))
    assert clean.q_std is not None
    moved = float(np.nanmax(np.abs(estimate.q - clean.q)[row:] / clean.q_std[row:]))
    name = log.columns(signal)[channel]
    first = estimate.findings[0] if estimate.findings else None
    said = "nothing" if first is None else f"{first.channel} {first.kind}"
    if first is None or first.channel != name:
        return name, moved, f"moved {moved:.1f}: {said}", None
    delay = float(log.t[np.flatnonzero(estimate.status & Status.FAULTY)[0]] - log.t[row])
    return name, moved, f"moved {moved:.1f}: {said} after {1e3 * delay:.1f} ms", delay


if __name__ == "__main__":
    main()
