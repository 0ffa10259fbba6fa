"""Robots drawn from their tolerances: how far estimates are off, in the standard deviations that they state.

A robot.yaml is made up, a robot is drawn from its tolerances, and what that robot's sensors read goes to estimators
that know the robot.yaml alone. Prints the table of docs/trust.md; `--robots` says how long it may take.
"""

import argparse
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from linkside import ElasticJointFilter, ExtendedKalmanFilter, Log, RauchTungStriebelSmoother, Robot
from linkside.control.controllers import JointPD
from linkside.recording.estimate import Status
from linkside.simulation import Sensor, simulate

Array = npt.NDArray[np.float64]

METHODS = {"ekf": ExtendedKalmanFilter, "smoother": RauchTungStriebelSmoother, "elastic": ElasticJointFilter}
PUBLIC = {
    "ur_description/urdf/ur10_robot.urdf": 6,
    "ur_description/urdf/ur5_robot.urdf": 6,
    "panda_description/urdf/panda.urdf": 6,
    "kinova_description/robots/kinova.urdf": 6,
    "xarm_description/urdf/xarm7.urdf": 6,
    "z1_description/urdf/z1.urdf": 6,
}
"""Arms of the package example-robot-data, and how many of their joints move."""

RATE, SECONDS = 500.0, 3.0
ZERO = 3e-4
"""Tolerance of an encoder's zero, where one is declared [rad]."""


@dataclass(frozen=True)
class Specimen:
    """What is known of a robot, the robot, what its sensors read, where links were (rows, n), and its URDF."""

    name: str
    robot: Robot
    true: Robot
    log: Log
    q: Array
    urdf: str


@dataclass(frozen=True)
class Verdict:
    """How one estimate of a specimen fares.

    Attributes
    ----------
    ratio
        Median of error over standard deviation, of joints that the drawing moves.
    off, silent
        Shares of rows in which some joint is off by more than three standard deviations, of all and of good ones.
    nees
        Mean of the normalised estimation error squared of the links, a joint.
    good
        Share of rows whose status is good.
    """

    ratio: float
    off: float
    silent: float
    nees: float
    good: float


def main() -> None:
    """Print a line for each robot, then the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="number of the first, which is its seed")
    options = parser.parse_args()
    rows: dict[str, list[Verdict]] = {name: [] for name in METHODS}
    for seed in range(options.first, options.first + options.robots):
        specimen = drawn(seed)
        verdicts = judged(specimen)
        for name, verdict in verdicts.items():
            rows[name].append(verdict)
        said = "; ".join(
            f"{n} {v.ratio:.2f} {v.off:.1%} {v.silent:.1%} {v.nees:.2f} {v.good:.0%}" for n, v in verdicts.items()
        )
        print(f"{seed:4} {specimen.name}: {said}", flush=True)
    for name, verdicts in rows.items():
        print(f"{name}: {summary(verdicts)}")


def summary(verdicts: list[Verdict]) -> str:
    """Of many robots: medians and their range, rows off and good, squares of normalised errors."""
    ratio, silent = np.array([v.ratio for v in verdicts]), np.array([v.silent for v in verdicts])
    nees, off = np.array([v.nees for v in verdicts]), np.mean([v.off for v in verdicts])
    return (
        f"median error / q_std {np.median(ratio):.2f} ({ratio.min():.2f} to {ratio.max():.2f}), "
        f"off {off:.2%}, and good {silent.mean():.2%} of the rows ({(silent > 0.02).sum()} robots above 2 %), "
        f"NEES a joint {nees.mean():.2f}, median {np.median(nees):.2f}; "
        f"good {np.mean([v.good for v in verdicts]):.0%}"
    )


def judged(specimen: Specimen, methods: Mapping[str, Any] = METHODS) -> dict[str, Verdict]:
    """Estimate with each method, and compare with the truth."""
    return {name: _verdict(specimen, method) for name, method in methods.items()}


def _verdict(specimen: Specimen, method: Any) -> Verdict:
    estimate = method(specimen.robot).run(specimen.log, covariance=True)
    n = specimen.robot.n
    error = estimate.q - specimen.q
    ratio = np.abs(error) / estimate.q_std
    good = estimate.status == Status.GOOD
    covariance = estimate.covariance[:, :n, :n]
    nees = np.einsum("ti,ti->t", error, np.linalg.solve(covariance, error[:, :, None])[:, :, 0]) / n
    return Verdict(
        ratio=float(np.median(ratio)),
        off=float((ratio > 3).any(axis=1).mean()),
        silent=float(((ratio > 3).any(axis=1) & good).mean()),
        nees=float(nees.mean()),
        good=float(good.mean()),
    )


def drawn(seed: int) -> Specimen:
    """The robot of a number: half of them with accelerometers, every third a public arm, smooth and rough motions."""
    rng = np.random.default_rng(seed)
    rough, seen, public = bool(seed & 1), bool(seed & 2), seed % 3 == 2
    urdf, links, names = public_arm(str(rng.choice(public_files()))) if public else _chain(rng, int(rng.integers(1, 7)))
    robot = dressed(urdf, links, names, rng, sensors=seen, zero=ZERO if seed % 5 == 0 else 0.0)
    true, torque = _drawn_from(robot, urdf, rng)
    q, log = _recorded(robot, true, torque, rng, rough=rough)
    kind = f"{Path(urdf).stem if public else 'chain'}, {robot.n} joints"
    return Specimen(
        f"{kind}, {'rough' if rough else 'smooth'}, {'with' if seen else 'no'} accelerometers",
        robot,
        true,
        log,
        q,
        urdf,
    )


def public_files() -> list[str]:
    """Public arms."""
    return sorted(PUBLIC)


def public_arm(file: str) -> tuple[str, list[str], list[str]]:
    """A public arm: its URDF, its links and its joints."""
    import pinocchio as pin

    folder = Path(distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data/robots"))  # type: ignore[arg-type]
    model = pin.buildModelFromUrdf(str(folder / file))
    names = [str(name) for name in model.names[1 : PUBLIC[file] + 1]]
    links = [
        next(f.name for f in model.frames if f.parentJoint == i + 1 and f.type == pin.FrameType.BODY)
        for i in range(len(names))
    ]
    return str(folder / file), links, names


def _chain(rng: np.random.Generator, joints: int) -> tuple[str, list[str], list[str]]:
    """Links in a row, as heavy as those of robots are: a URDF, its links and its joints."""
    heavy = 30.0 * 0.55 ** np.arange(joints) * rng.uniform(0.6, 1.6, joints)
    lengths = rng.uniform(0.15, 0.6, joints)
    parts = ['<robot name="chain"><link name="l0"/>']
    for i, (mass, length) in enumerate(zip(heavy, lengths, strict=True)):
        across, along = mass * length**2 / 12 + 1e-3, mass * 1e-3 + 1e-4
        axis = "0 0 1" if i == 0 and rng.random() < 0.5 else ("0 1 0", "0 1 0", "1 0 0")[int(rng.integers(3))]
        parts.append(
            f'<link name="l{i + 1}"><inertial><origin xyz="0 0 {0.5 * length}"/><mass value="{mass}"/>'
            f'<inertia ixx="{across}" ixy="0" ixz="0" iyy="{across}" iyz="0" izz="{along}"/></inertial></link>'
            f'<joint name="j{i + 1}" type="revolute"><parent link="l{i}"/><child link="l{i + 1}"/>'
            f'<origin xyz="0.05 0.02 {lengths[i - 1] if i else 0.3}"/><axis xyz="{axis}"/>'
            '<limit lower="-6" upper="6" effort="1" velocity="1"/></joint>'
        )
    names = [f"j{i + 1}" for i in range(joints)]
    return "".join([*parts, "</robot>"]), [f"l{i + 1}" for i in range(joints)], names


def dressed(
    urdf: str, links: list[str], names: list[str], rng: np.random.Generator, *, sensors: bool, zero: float
) -> Robot:
    """What a URDF does not say: drives that ring at 6 to 20 Hz, with dampers or without, and sensors."""
    n = len(names)
    plain = Robot.from_urdf(urdf, [{"name": name, "stiffness": 1e4, "motor_inertia": 1.0} for name in names])
    inertia = np.diag(plain.mass_matrix(rng.uniform(-0.5, 0.5, n)))
    stiffness = inertia * (2 * np.pi * rng.uniform(6, 20, n)) ** 2
    motor = inertia * rng.uniform(0.5, 2, n)
    damped = rng.random() < 0.7
    drives = [
        {
            "name": name,
            "stiffness": float(k),
            "damping": float(k * rng.uniform(2e-4, 1e-3)) if damped else 0.0,
            "motor_inertia": float(b),
            "motor_friction": {"viscous": float(b), "coulomb": float(0.3 * b)},
            "link_friction": [0.0, 1.0, 1.0, 0.0, 1.0, float(0.3 * m)] if damped else None,
        }
        for name, k, b, m in zip(names, stiffness, motor, inertia, strict=True)
    ]
    for drive in drives:
        if drive["link_friction"] is None:
            del drive["link_friction"]
    places = sorted({n - 1, n // 2}) if sensors else []
    accelerometers = [
        {
            "name": f"acc{i}",
            "link": links[i],
            "xyz": rng.uniform(-0.1, 0.1, 3).tolist(),
            "rpy": rng.uniform(-1, 1, 3).tolist(),
            "noise_std": 0.05,
        }
        for i in places
    ]
    settings: dict[str, Any] = {
        "accelerometers": accelerometers,
        "encoder": {"resolution": float(10 ** rng.uniform(-6, -4.5))},
        "torque": {"noise_std": float(0.02 * motor.max())},
    }
    if zero:
        settings["tolerances"] = {"encoder_zero": zero}
    return Robot.from_urdf(urdf, drives, **settings)


def _drawn_from(robot: Robot, urdf: str, rng: np.random.Generator) -> tuple[Robot, Array]:
    """A robot drawn from the tolerances of another, and the shares of its torques that are read (n,)."""
    told = robot.config.model_dump(exclude_unset=True)
    wide = robot.config.tolerances

    def share(std: float, size: int | None = None) -> Any:
        return np.exp(std * rng.standard_normal(size))

    for joint in told["joints"]:
        joint["stiffness"] *= float(share(wide.stiffness))
        joint["damping"] *= float(share(wide.damping))
        joint["motor_inertia"] *= float(share(wide.motor_inertia))
        joint["mass_scale"] = float(share(wide.mass_scale))
        friction = float(share(wide.motor_friction))
        joint["motor_friction"] = {name: value * friction for name, value in joint["motor_friction"].items()}
        if "link_friction" in joint:
            link = float(share(wide.link_friction))
            joint["link_friction"] = [
                x * (link if i in (0, 3, 5) else 1.0) for i, x in enumerate(joint["link_friction"])
            ]
    for sensor in told["accelerometers"]:
        sensor["xyz"] = (np.array(sensor["xyz"]) + wide.translation * rng.standard_normal(3)).tolist()
        sensor["rpy"] = (np.array(sensor["rpy"]) + wide.rotation * rng.standard_normal(3)).tolist()
    settings = {key: told[key] for key in ("accelerometers", "encoder", "torque")}
    return Robot.from_urdf(urdf, told["joints"], **settings), 1 / share(wide.torque_constant, robot.n)


def _recorded(robot: Robot, true: Robot, torque: Array, rng: np.random.Generator, *, rough: bool) -> tuple[Array, Log]:
    """A motion under motor control: its true link positions, and what sensors read of it."""
    n, start = robot.n, rng.uniform(-0.5, 0.5, robot.n)
    times, theta = _wanted(rng, n, rough=rough)
    # Where the springs hold gravity the motors stand, and are to stay.
    theta = theta + true.gravity_torque(start) / np.array([d.stiffness for d in true.drives]) + start
    inertia = np.diag(true.mass_matrix(start)) + np.array([d.motor_inertia for d in true.drives])
    control = JointPD(kp=400 * inertia, kd=28 * inertia, times=times, theta=list(theta), tau=true.gravity_torque(start))
    speed = {"dtheta": Sensor(noise=1e-3)}
    run = simulate(true, control, SECONDS, RATE, substeps=8, q=start, seed=int(rng.integers(1 << 30)), sensors=speed)
    wide = robot.config.tolerances
    zero = wide.encoder_zero * rng.standard_normal(n) + wide.lost_motion * rng.standard_normal(n)
    log = replace(run.log, theta=run.log.theta + zero, tau=run.log.tau * torque)
    if log.acceleration is not None:
        scale = np.exp(wide.scale * rng.standard_normal(log.acceleration.shape[1]))
        log = replace(log, acceleration=log.acceleration * scale)
    return run.truth["q"], log


def _wanted(rng: np.random.Generator, n: int, *, rough: bool) -> tuple[Array, Array]:
    """Knots of the motors' motion (k,), (k, n): to one posture after the other at once, or a sum of slow waves."""
    if rough:  # on the way for 0.15 s of each 0.4 s
        times = np.arange(0.2, SECONDS, 0.01)
        postures = np.cumsum(0.15 * rng.standard_normal((int(SECONDS / 0.4) + 1, n)), axis=0)
        postures -= postures[0]
        stage, u = np.divmod(times - times[0], 0.4)
        u = np.clip(u / 0.15, 0, 1)[:, None]
        share = u**2 * (3 - 2 * u)
        theta = postures[stage.astype(int)] * (1 - share) + postures[stage.astype(int) + 1] * share
    else:
        times = np.arange(0.2, SECONDS, 0.01)
        u = times - times[0]
        waves = [
            rng.uniform(0, 0.3, n) * (1 - np.cos(2 * np.pi * rng.uniform(0.2, 1.0, n) * u[:, None])) for _ in range(3)
        ]
        begun = np.clip(u / 0.5, 0, 1)[:, None]
        theta = np.sum(waves, axis=0) * begun**3 * (10 - 15 * begun + 6 * begun**2)
    theta[0] = 0.0
    return times, theta


def specimens(count: int, first: int = 0) -> Iterator[Specimen]:
    """So many, one after the other."""
    return (drawn(seed) for seed in range(first, first + count))


if __name__ == "__main__":
    main()
