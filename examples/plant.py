"""A robot with elastic joints to control: Pinocchio's forward dynamics, integrated finely between samples."""

import numpy as np
import pinocchio as pin

import linkside


def specimen(robot, stiffness=0.95, damping=1.05, motor_inertia=1.05, mass=1.05):
    """Make the robot as it truly is, other than as it is known by these factors."""
    factors = {"stiffness": stiffness, "damping": damping, "motor_inertia": motor_inertia}
    joints = [
        joint.model_copy(update={key: f * getattr(joint, key) for key, f in factors.items() if getattr(joint, key)})
        for joint in robot.drives
    ]
    model = pin.Model(robot.model)
    for index, inertia in enumerate(robot.model.inertias):
        model.inertias[index] = pin.Inertia(mass * inertia.mass, inertia.lever, mass * inertia.inertia)
    return linkside.Robot(robot.config.model_copy(update={"joints": tuple(joints)}), model)


class Plant:
    """Links by the articulated-body algorithm, motors and springs beside it; Runge and Kutta's method at 4 kHz or more.

    State (q, θ, q̇, θ̇), each in log order.
    """

    def __init__(self, robot, desired, seed=0, noisy=True):
        if robot.coupling.any() or (robot.velocity_index != np.arange(robot.n)).any():
            raise ValueError("this plant has neither inertial coupling nor another order of joints")
        self.robot, self.model = robot, pin.Model(robot.model)
        get = {name: np.array([getattr(d, name) or 0.0 for d in robot.drives]) for name in ("stiffness", "damping")}
        self.stiffness, self.damping = get["stiffness"], get["damping"]
        self.inertia = np.array([d.motor_inertia or 0.0 for d in robot.drives])
        self.viscous, self.dry = (
            np.array([getattr(d.motor_friction, name) for d in robot.drives]) for name in ("viscous", "coulomb")
        )
        self.model.armature = np.where(robot.elastic, 0.0, self.inertia)
        self.data = self.model.createData()
        self.rng, self.noisy = np.random.default_rng(seed), noisy
        start, rest = desired.q[0], np.zeros(robot.n)
        stiffness = np.where(robot.elastic, self.stiffness, np.inf)
        self.state = np.concatenate([start, start + robot.gravity_torque(start) / stiffness, rest, rest])
        self.torque = robot.gravity_torque(start)

    @property
    def q(self):
        """Where the links are."""
        return self.state[: self.robot.n]

    def accelerations(self, state, torque):
        """Accelerations of links and motors."""
        q, theta, dq, dtheta = state.reshape(4, -1)
        friction = self.viscous * dtheta + self.dry * dtheta / np.sqrt(dtheta**2 + 4e-6)
        elastic = self.robot.elastic
        spring = np.where(elastic, self.stiffness * (theta - q) + self.damping * (dtheta - dq), torque - friction)
        ddq = pin.aba(self.model, self.data, q, dq, spring)
        ddtheta = np.where(elastic, (torque - friction - spring) / np.where(elastic, self.inertia, 1.0), ddq)
        return ddq, ddtheta

    def read(self):
        """What encoders and accelerometers say."""
        q, theta, dq, _ = self.state.reshape(4, -1)
        ddq = self.accelerations(self.state, self.torque)[0]
        acceleration = self.robot.specific_force(q, dq, ddq)
        if not self.noisy:
            return theta, acceleration
        std = [sensor.noise_std for sensor in self.robot.accelerometers for _ in sensor.axes]
        resolution = self.robot.config.encoder.resolution
        return resolution * np.round(theta / resolution), acceleration + std * self.rng.standard_normal(len(std))

    def advance(self, torque, period):
        """Hold a torque for a period."""
        self.torque, steps = torque, int(np.ceil(period / 2.5e-4 - 1e-9))
        for _ in range(steps):
            self.state = self._runge_kutta(period / steps)

    def _runge_kutta(self, h):
        slopes, x = [], self.state
        for share in (0.0, 0.5, 0.5, 1.0):
            at = x + share * h * slopes[-1] if slopes else x
            slopes.append(np.concatenate([at[len(at) // 2 :], *self.accelerations(at, self.torque)]))
        a, b, c, d = slopes
        return x + h / 6 * (a + 2 * b + 2 * c + d)


def run(plant, controller, samples, period):
    """Close the loop; give link positions, velocities, motor positions and velocities, torques, readings."""
    rows = []
    for _ in range(samples):
        theta, acceleration = plant.read()
        torque = controller.step(theta=theta, acceleration=acceleration)
        rows.append((plant.state.copy(), torque, theta, acceleration))
        plant.advance(torque, period)
    return tuple(np.array(column) for column in zip(*rows, strict=True))
