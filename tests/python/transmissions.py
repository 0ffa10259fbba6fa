"""A second simulator, of robots with imperfect gears: Pinocchio's dynamics, SciPy's integrators, laws as printed."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp

from linkside import Log, Robot


@dataclass
class Gear:
    """One joint's drive: stiffness, damping, motor inertia.

    Harmonics of ε(θ) as (amplitude, cycles a turn, phase), friction elements as (law, stiffness, limit).
    """

    stiffness: float
    damping: float
    inertia: float
    waves: list[tuple[float, float, float]] = field(default_factory=list)
    elements: list[tuple[str, float, float]] = field(default_factory=list)

    def output(self, theta):
        """θ + ε, 1 + ε′ and ε″."""
        parts = [(a, n, n * theta + p) for a, n, p in self.waves]
        return (
            theta + sum(a * np.sin(x) for a, _, x in parts),
            1 + sum(a * n * np.cos(x) for a, n, x in parts),
            -sum(a * n * n * np.sin(x) for a, n, x in parts),
        )


def force_rate(law, stiffness, limit, force, speed):
    """Ḟ of a friction element, as printed."""
    if law == "dahl":  # Dahl 1968
        return stiffness * (speed - abs(speed) * force / limit)
    if law == "bouc-wen":  # Wen 1976, exponent 1, β = γ = ½, of z = F/limit
        z, rate = force / limit, stiffness * speed / limit
        return limit * (rate - 0.5 * abs(rate) * z - 0.5 * rate * abs(z))
    slips = force * np.sign(speed) >= limit  # Iwan 1966
    return 0.0 if slips else stiffness * speed


@dataclass
class Motion:
    """A recording without faults, one row a sample."""

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    theta: np.ndarray
    dtheta: np.ndarray
    tau: np.ndarray
    tool: np.ndarray
    force: np.ndarray  # what accelerometers read

    def log(self, robot: Robot, encoder: float, noise: float, seed: int = 0) -> Log:
        """What sensors make of it: encoders of steps, accelerometers with noise, torques as they are."""
        force = self.force + noise * np.random.default_rng(seed).standard_normal(self.force.shape)
        theta = np.round(self.theta / encoder) * encoder
        columns = {"t": self.t}
        for j, name in enumerate(robot.names):
            columns |= {f"theta_{name}": theta[:, j], f"tau_{name}": self.tau[:, j]}
        for k, sensor in enumerate(robot.accelerometers):
            columns |= {f"{sensor.name}_{axis}": force[:, 3 * k + i] for i, axis in enumerate("xyz")}
        return Log.from_table(columns, robot)


def move(
    robot: Robot,
    gears: list[Gear],
    reference: Callable[[float], tuple[np.ndarray, np.ndarray]],
    duration: float,
    rate: float = 1000.0,
    gains: tuple[float, float] = (3e3, 150.0),
    lift: Callable[[np.ndarray], np.ndarray] = np.zeros_like,
    shares: np.ndarray | None = None,
) -> Motion:
    """The robot's links behind other gears, motors led along a reference by PD control without steps.

    It begins at rest where springs hold gravity and friction elements are relaxed. ``lift``: torques on links by
    position. ``shares``: how far each motor, in columns, turns each gear; θ and τ are then the motors'.
    """
    shares = np.eye(len(gears)) if shares is None else shares
    model, n = robot.model, len(gears)
    data = model.createData()
    elements = [(j, *element) for j, gear in enumerate(gears) for element in gear.elements]
    constants = np.array([[g.stiffness, g.damping, g.inertia] for g in gears])

    def control(t, theta, dtheta):
        goal, speed = reference(t)
        return hold + gains[0] * (goal - theta) + gains[1] * (speed - dtheta)

    def accelerations(t, x):
        q, dq, theta, dtheta = x[: 4 * n].reshape(4, n)
        angle, ratio, _ = np.transpose([g.output(a) for g, a in zip(gears, shares @ theta, strict=True)])
        slip = ratio * (shares @ dtheta) - dq
        load = constants[:, 0] * (angle - q) + constants[:, 1] * slip
        for (j, *_), force in zip(elements, x[4 * n :], strict=True):
            load[j] += force
        ddtheta = (control(t, theta, dtheta) - shares.T @ (ratio * load)) / constants[:, 2]
        return pin.aba(model, data, q, dq, load + lift(q)), ddtheta, slip

    def slope(t, x):
        ddq, ddtheta, slip = accelerations(t, x)
        rates = [force_rate(*law, force, slip[j]) for (j, *law), force in zip(elements, x[4 * n :], strict=True)]
        return np.concatenate([x[n : 2 * n], ddq, x[3 * n : 4 * n], ddtheta, rates])

    theta = reference(0.0)[0]
    angle, ratio, _ = np.transpose([g.output(a) for g, a in zip(gears, shares @ theta, strict=True)])
    q = angle.copy()
    for _ in range(60):
        q = angle - (pin.computeGeneralizedGravity(model, data, q) - lift(q)) / constants[:, 0]
    hold = shares.T @ (ratio * (pin.computeGeneralizedGravity(model, data, q) - lift(q)))
    t = np.arange(round(duration * rate)) / rate
    start = np.concatenate([q, np.zeros(n), theta, np.zeros(n + len(elements))])
    x = solve_ivp(slope, (0, t[-1]), start, "DOP853", t, rtol=1e-8, atol=1e-10, max_step=2 / rate).y.T
    told = [
        (*accelerations(at, row), control(at, *row[: 4 * n].reshape(4, n)[2:])) for at, row in zip(t, x, strict=True)
    ]
    q, dq, theta, dtheta = x[:, : 4 * n].reshape(-1, 4, n).swapaxes(0, 1)
    ddq = np.array([row[0] for row in told])
    seen = [_sense(robot, data, *row) for row in zip(q, dq, ddq, strict=True)]
    tau = np.array([row[3] for row in told])
    return Motion(t, q, dq, ddq, theta, dtheta, tau, *(np.array(part) for part in zip(*seen, strict=True)))


def _sense(robot, data, q, dq, ddq):
    """The tool's position and what accelerometers read."""
    model = robot.model
    pin.forwardKinematics(model, data, q, dq, ddq)
    pin.updateFramePlacements(model, data)
    force = []
    for sensor in robot.accelerometers:
        frame, pose = _frame(model, sensor)
        motion = (
            pose.actInv(pin.getFrameVelocity(model, data, frame)),
            pose.actInv(pin.getFrameAcceleration(model, data, frame)),
        )
        classical = motion[1].linear + np.cross(motion[0].angular, motion[0].linear)
        axes = data.oMf[frame].rotation @ pose.rotation
        force.append(classical - axes.T @ model.gravity.linear)
    frame, pose = _frame(model, robot.config.tool)
    return (data.oMf[frame] * pose).translation, np.concatenate(force)


def _frame(model, mount):
    return model.getFrameId(mount.link), pin.SE3(pin.rpy.rpyToMatrix(*mount.rpy), np.array(mount.xyz))


def tool_error(estimate, motion: Motion, skip: int = 0) -> float:
    """Root mean square of the tool's error, constant offset out [mm]."""
    error = (estimate.tool_position - motion.tool)[skip:]
    return 1e3 * float(np.sqrt(np.mean(np.sum((error - error.mean(0)) ** 2, axis=1))))
