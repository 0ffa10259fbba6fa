"""The three examples of Cristofaro and De Luca's paper on a reduced-order velocity observer, on their two-link arm.

1. A bounded velocity, a constant gain, and the observer of Nicosia and Tomei with the same gain beside it.
2. A velocity beyond the bound: the gain's level follows the estimate.
3. A position controller that is fed the estimated velocity.

Gravity is compensated exactly in all three, so the arm has none here.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt

from linkside import NicosiaTomeiObserver, ReducedOrderObserver, Robot
from linkside.velocity.gain_design import design_gain

Array = npt.NDArray[np.float64]
Torque = Callable[[float, Array, Array], Array]

PERIOD = 1e-3
FRICTION = np.array([0.1, 0.3])  # N m s/rad
START = np.array([-2 * np.pi / 3, np.pi / 10, -0.5, 1.0])
TARGET = np.array([np.pi / 4, -np.pi / 3])

LINK = """<link name="{name}"><inertial><origin xyz="{half} 0 0"/><mass value="{mass}"/>
  <inertia ixx="1e-9" ixy="0" ixz="0" iyy="{inertia}" iyz="0" izz="{inertia}"/></inertial></link>"""
ARM = f"""<robot name="rods"><link name="base"/>
  {LINK.format(name="upper", half=0.5, mass=10, inertia=10 / 12)}
  {LINK.format(name="fore", half=0.75, mass=20, inertia=3.75)}
  <joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="fore"/><origin xyz="1 0 0"/>
    <axis xyz="0 0 1"/></joint></robot>"""


def arm() -> Robot:
    """Thin rods of 10 and 20 kg, 1 and 1.5 m long."""
    joints = [
        {"name": name, "elastic": False, "link_friction": [0, 0, 0, 0, 0, float(viscous)]}
        for name, viscous in zip(("shoulder", "elbow"), FRICTION, strict=True)
    ]
    return Robot.from_urdf(ARM, joints, gravity=[0, 0, 0])


def slope(x: Array, torque: Array) -> Array:
    """Motion of the true arm, in closed form."""
    v, cosine, sine = x[2:], np.cos(x[1]), 15 * np.sin(x[1])
    mass = np.array([[115 / 3 + 30 * cosine, 15 + 15 * cosine], [15 + 15 * cosine, 15.0]])
    coriolis = np.array([-sine * v[1] * (2 * v[0] + v[1]), sine * v[0] ** 2])
    return np.concatenate([v, np.linalg.solve(mass, torque - coriolis - FRICTION * v)])


def advance(x: Array, torque: Callable[[float, Array], Array], t: float) -> Array:
    """One period by Runge and Kutta's method."""
    k1 = slope(x, torque(t, x))
    k2 = slope(x + PERIOD / 2 * k1, torque(t + PERIOD / 2, x + PERIOD / 2 * k1))
    k3 = slope(x + PERIOD / 2 * k2, torque(t + PERIOD / 2, x + PERIOD / 2 * k2))
    k4 = slope(x + PERIOD * k3, torque(t + PERIOD, x + PERIOD * k3))
    return x + PERIOD / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def simulate(observer: ReducedOrderObserver, torque: Torque, seconds: float = 20) -> tuple[Array, Array, Array, Array]:
    """Times, states of the arm, estimated velocities, and levels of the gain."""
    count = round(seconds / PERIOD) + 1
    t, x, found, level = PERIOD * np.arange(count), np.empty((count, 4)), np.zeros((count, 2)), np.empty(count)
    x[0] = START
    estimate = ahead = np.zeros(2)
    for i in range(count):

        def applied(
            at: float, x: Array, start: float = t[i] - PERIOD, dq: Array = estimate, ddq: Array = ahead
        ) -> Array:
            """What the controller asks for, by the estimate of the sample before, carried on."""
            return torque(at, x, dq + (at - start) * ddq)

        state = observer.step(q=x[i, :2], tau=applied(t[i] + PERIOD / 2, x[i]))  # held: that of the period's middle
        found[i], level[i], estimate, ahead = state.dq, state.level, state.dq, state.ddq
        if i + 1 < count:
            x[i + 1] = advance(x[i], applied, t[i])
    return t, x, found, level


def settling(t: Array, error: Array, threshold: float) -> float:
    """When an error stays below a threshold [s]."""
    above = np.flatnonzero(error > threshold)
    return float(t[min(above[-1] + 1, len(t) - 1)]) if len(above) else 0.0


def report(what: str, t: Array, x: Array, found: Array) -> Array:
    """Say when the error settles."""
    error = np.linalg.norm(x[:, 2:] - found, axis=1)
    five, one, end = (settling(t, error, limit) for limit in (0.05 * error[0], 0.01 * error[0], 1e-3))
    print(f"{what:32} 5 % {five:6.3f} s   1 % {one:6.3f} s   1e-3 rad/s {end:6.3f} s")
    return error


def main() -> None:
    """Run all three and draw them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--out", type=Path, default=Path("figures"), help="directory for figures")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    robot = arm()
    design = design_gain(robot, speed=1.5, margin=1.0)
    print(f"k0 = {design.gain:.4f} 1/s; by separate bounds {design.conservative:.2f}; region {design.region:.4f} rad/s")
    example_1(robot, design.gain, out / "bounded.png")
    hybrid = design.hybrid(bound=1.5, levels=6)
    observer = ReducedOrderObserver(robot, hybrid, period=PERIOD, start="rest")
    t, x, found, level = simulate(observer, lambda t, x, dq: np.array([np.sin(t), 1 + np.sin(2 * t)]))
    report("example 2", t, x, found)
    tell_jumps(t, level)
    print(f"q(20) = {np.round(x[-1, :2], 4)}")
    draw(out / "beyond.png", t, x, found, level)
    observer = ReducedOrderObserver(robot, hybrid, period=PERIOD, start="rest")
    stiffness, damping = np.array([40.0, 20.0]), np.array([60.0, 30.0])
    t, x, found, level = simulate(observer, lambda t, x, dq: stiffness * (TARGET - x[:2]) - damping * dq)
    report("example 3", t, x, found)
    tell_jumps(t, level)
    print(f"q(2) = {np.round(x[2000, :2], 5)}, q(5) = {np.round(x[5000, :2], 5)}")
    draw(out / "regulation.png", t, x, found, level)


def example_1(robot: Robot, gain: float, path: Path) -> None:
    """Constant gains."""
    observers: dict[str, ReducedOrderObserver] = {
        "reduced order": ReducedOrderObserver(robot, gain, period=PERIOD, start="rest")
    }
    for spring in (10.0, 100.0, 500.0, 2000.0):
        observers[f"Nicosia-Tomei, K_P = {spring:g}"] = NicosiaTomeiObserver(
            robot, gain, spring, period=PERIOD, start="rest"
        )
    figure, axes = plt.subplots()
    for name, observer in observers.items():
        t, x, found, _ = simulate(observer, lambda t, x, dq: np.array([np.cos(t / 2), -np.cos(t)]))
        axes.semilogy(t, report(name, t, x, found) + 1e-12, label=name)
    print(f"q(10) = {np.round(x[10000, :2], 5)}, q(20) = {np.round(x[-1, :2], 5)}")
    axes.set(xlabel="t [s]", ylabel="error [rad/s]", xlim=(0, 5), ylim=(1e-5, 2))
    axes.legend()
    figure.savefig(path)


def tell_jumps(t: Array, level: Array) -> None:
    """When the level changes, and to what."""
    jumps = np.flatnonzero(np.diff(level)) + 1
    print("jumps: " + ", ".join(f"{t[i]:.3f} s to {level[i]:g}" for i in jumps))


def draw(path: Path, t: Array, x: Array, found: Array, level: Array) -> None:
    """Velocities and their estimates, and the level."""
    figure, (upper, lower) = plt.subplots(2, sharex=True, height_ratios=(3, 1))
    upper.plot(t, x[:, 2:], label=["joint 1", "joint 2"])
    upper.plot(t, found, "--", label=["estimate 1", "estimate 2"])
    upper.set(ylabel="velocity [rad/s]")
    upper.legend()
    lower.step(t, level, where="post")
    lower.set(xlabel="t [s]", ylabel="level r")
    figure.savefig(path)


if __name__ == "__main__":
    main()
