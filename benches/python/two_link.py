"""A planar two-link arm as one would write it by hand: motor positions and an accelerometer's x and z in closed form.

Both joints turn about y, gravity points along -z, and the accelerometer sits on the second link.
Independent of linkside's kernels: from `linkside.Robot` it takes masses, lengths and settings alone.
"""

from math import cos, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from linkside import Log, Noise, Robot

Array = NDArray[np.float64]

GRAVITY = 9.81


class Arm(NamedTuple):
    """What does not change: sums of masses and lengths; vectors in the plane are (x, z)."""

    whole: float  # inertia of both links about the first joint, without the part that turns with the second [kg m²]
    outer: float  # inertia of the second link about its joint [kg m²]
    coupled: tuple[float, float]  # coefficients of cos q₂ and sin q₂ [kg m²]
    first: tuple[float, float]  # moment of mass that turns with the first link [kg m]
    second: tuple[float, float]  # moment of mass of the second link [kg m]
    link: tuple[float, float]  # from joint to joint, seen from the sensor at zero [m]
    sensor: tuple[float, float]  # from the second joint to the sensor, seen from the sensor [m]
    up: tuple[float, float]  # what the sensor reads at rest at zero [m/s²]
    stiffness: tuple[float, float]
    damping: tuple[float, float]

    @classmethod
    def of(cls, robot: Robot) -> "Arm":
        """Read masses and lengths off a robot."""
        _, one, two = robot.model.inertias
        m1, m2, i1, i2 = one.mass, two.mass, one.inertia[1, 1], two.inertia[1, 1]
        c1, c2 = (complex(link.lever[0], link.lever[2]) for link in (one, two))
        x, _, z = robot.model.jointPlacements[2].translation
        mount = robot.accelerometers[0]
        turned = np.exp(1j * mount.rpy[1])
        link, coupled = complex(x, z), complex(x, -z) * c2 * m2
        outer = i2 + m2 * abs(c2) ** 2
        plane = (
            (coupled.real, coupled.imag),
            *((v.real, v.imag) for v in (m1 * c1 + m2 * link, m2 * c2, link * turned)),
            *((v.real, v.imag) for v in (complex(mount.xyz[0], mount.xyz[2]) * turned, 1j * GRAVITY * turned)),
        )
        springs = (tuple(d.stiffness for d in robot.drives), tuple(d.damping for d in robot.drives))
        return cls(i1 + m1 * abs(c1) ** 2 + outer + m2 * abs(link) ** 2, outer, *plane, *springs)


def measure(arm: Arm, x: Array, dtheta: Array, prediction: Array, jacobian: Array) -> None:
    """Readings (4) predicted at x = (q, q̇, q̈, …), without biases, and their derivatives (4, 6) in the first six."""
    v1, v2, a1, a2 = x[2], x[3], x[4], x[5]
    c2, s2, c12, s12 = cos(x[1]), sin(x[1]), cos(x[0] + x[1]), sin(x[0] + x[1])
    c1, s1 = c12 * c2 + s12 * s2, s12 * c2 - c12 * s2
    h, slope = arm.coupled[0] * c2 + arm.coupled[1] * s2, arm.coupled[1] * c2 - arm.coupled[0] * s2
    x1, z1 = arm.first[0] * c1 + arm.first[1] * s1, arm.first[1] * c1 - arm.first[0] * s1
    x2, z2 = arm.second[0] * c12 + arm.second[1] * s12, arm.second[1] * c12 - arm.second[0] * s12
    centrifugal = 2 * v1 * v2 + v2 * v2
    m11, m12 = arm.whole + 2 * h, arm.outer + h
    tau1 = m11 * a1 + m12 * a2 + slope * centrifugal - GRAVITY * (x1 + x2)
    tau2 = m12 * a1 + arm.outer * a2 - slope * v1 * v1 - GRAVITY * x2
    k1, k2 = 1 / arm.stiffness[0], 1 / arm.stiffness[1]
    prediction[0] = x[0] + k1 * (tau1 - arm.damping[0] * (dtheta[0] - v1))
    prediction[1] = x[1] + k2 * (tau2 - arm.damping[1] * (dtheta[1] - v2))
    jacobian[0, 0] = 1 - k1 * GRAVITY * (z1 + z2)
    jacobian[0, 1] = k1 * (slope * (2 * a1 + a2) - h * centrifugal - GRAVITY * z2)
    jacobian[0, 2] = k1 * (2 * slope * v2 + arm.damping[0])
    jacobian[0, 3] = k1 * 2 * slope * (v1 + v2)
    jacobian[0, 4], jacobian[0, 5] = k1 * m11, k1 * m12
    jacobian[1, 0] = -k2 * GRAVITY * z2
    jacobian[1, 1] = 1 + k2 * (slope * a1 + h * v1 * v1 - GRAVITY * z2)
    jacobian[1, 2], jacobian[1, 3] = -k2 * 2 * slope * v1, k2 * arm.damping[1]
    jacobian[1, 4], jacobian[1, 5] = k2 * m12, k2 * arm.outer

    w, a = v1 + v2, a1 + a2
    px, pz = arm.link[0] * c2 - arm.link[1] * s2, arm.link[0] * s2 + arm.link[1] * c2
    rx, rz = arm.sensor
    gx, gz = arm.up[0] * c12 - arm.up[1] * s12, arm.up[0] * s12 + arm.up[1] * c12
    prediction[2] = pz * a1 - px * v1 * v1 + rz * a - rx * w * w + gx
    prediction[3] = -px * a1 - pz * v1 * v1 - rx * a - rz * w * w + gz
    jacobian[2, 0], jacobian[3, 0] = -gz, gx
    jacobian[2, 1] = px * a1 + pz * v1 * v1 - gz
    jacobian[3, 1] = pz * a1 - px * v1 * v1 + gx
    jacobian[2, 2], jacobian[3, 2] = -2 * (px * v1 + rx * w), -2 * (pz * v1 + rz * w)
    jacobian[2, 3], jacobian[3, 3] = -2 * rx * w, -2 * rz * w
    jacobian[2, 4], jacobian[3, 4] = pz + rz, -px - rx
    jacobian[2, 5], jacobian[3, 5] = rz, -rx


class Problem(NamedTuple):
    """What an EKF of ten states takes: the recording, where it starts, and its noise."""

    arm: Arm
    period: float
    readings: Array  # (T, 4)
    dtheta: Array  # (T, 2)
    jerk: Array  # (T, 2), commanded since the sample before
    start: Array  # (10,)
    initial: Array  # (10,), variances at the start
    process: Array  # (10, 10), covariance of what a step adds
    variance: Array  # (4,), of readings

    @classmethod
    def of(cls, robot: Robot, log: Log, noise: Noise) -> "Problem":
        """From the same settings as linkside's filter; the first sample is at rest."""
        arm, stds = Arm.of(robot), noise.arrays(robot, ("motor", "acceleration"))
        jerk = np.diff(log.ddqref, axis=0, prepend=log.ddqref[:1]) / log.period
        initial = np.concatenate([stds["initial"], stds["initial_bias"]])
        process = _process(log.period, np.square(stds["jerk"]), np.square(stds["bias_walk"]))
        readings = np.hstack([log.theta, log.acceleration])
        start = np.concatenate([_at_rest(arm, log.theta[0]), np.zeros(8)])
        squares = np.square(initial), process, np.square(stds["reading"])
        return cls(arm, log.period, readings, np.ascontiguousarray(log.dtheta), jerk, start, *squares)


def _process(t: float, jerk: Array, walk: Array) -> Array:
    """The exact integral of white jerk over a step, and of the walks of biases."""
    of_jerk = np.array([[t**5 / 20, t**4 / 8, t**3 / 6], [t**4 / 8, t**3 / 3, t**2 / 2], [t**3 / 6, t**2 / 2, t]])
    out = np.zeros((10, 10))
    out[:6, :6] = np.kron(of_jerk, np.diag(jerk))
    out[6:, 6:] = np.diag(walk * t)
    return out


def transition(period: float) -> tuple[Array, Array]:
    """F (10, 10), and what jerk (10, 2) does to the state."""
    t, joints = period, np.eye(2)
    f = np.eye(10)
    f[:2, 2:4], f[2:4, 4:6], f[:2, 4:6] = t * joints, t * joints, t * t / 2 * joints
    by_jerk = np.vstack([t**3 / 6 * joints, t * t / 2 * joints, t * joints, np.zeros((4, 2))])
    return f, by_jerk


def _at_rest(arm: Arm, theta: Array) -> Array:
    """q with K(θ − q) = g(q)."""
    x, prediction, jacobian = np.zeros(6), np.zeros(4), np.zeros((4, 6))
    x[:2] = theta
    for _ in range(100):
        measure(arm, x, np.zeros(2), prediction, jacobian)
        x[:2] += theta - prediction[:2]
    return x[:2]
